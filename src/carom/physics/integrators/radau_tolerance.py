"""How far the iterations of a step of Gauss–Radau integration go: to rounding, or to the error of longer steps."""

from __future__ import annotations

CONVERGED = 1e-16  # of the largest acceleration, tolerated residual at a node: half a last bit
USUAL = 1.0  # refinement, from which steps are iterated to rounding
LONGER = 2.0**-1.25  # refinement, below which steps err by more than `COARSE`
FINE = 1e-10  # of the largest acceleration, between them
COARSE = 1e-9


def tolerance(refinement: float) -> float:
    """Return the residual at a node, over the largest acceleration, at which iterations end.

    Steps that are `refinement` of the usual ones err by more than that. So they take two iterations, as usual steps do,
    in place of up to eight: 0.50, 0.36 and 0.26 of the cost with steps of 2, 2.8 and 4 times the usual length, where
    rounding takes 0.8, 0.7 and 0.6.
    """
    if refinement >= USUAL:
        return CONVERGED
    return FINE if refinement > LONGER else COARSE
