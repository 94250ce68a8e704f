"""How far the iterations of a step of Gauss–Radau integration go: to rounding, or to the error of longer steps."""

from __future__ import annotations

CONVERGED = 1e-16  # of the largest acceleration, tolerated residual at a node: half a last bit
# Refinements below which a residual is tolerated. On orbits of eccentricity 0.05 to 0.9 these residuals add less to the
# error of 1000 orbits than the steps themselves, which take 2.0 to 3.0 iterations.
LONGER = ((2.0**-1.75, 1e-9), (2.0**-1.25, 1e-11), (2.0**-0.25, 1e-12))


def tolerance(refinement: float) -> float:
    """Return the residual at a node, over the largest acceleration, at which iterations end.

    Steps that are `refinement` of the usual ones err by more than that. So they take little more than the two
    iterations of usual steps, in place of up to eight. With steps of 1.4, 2, 2.8 and 4 times the usual length, 1000
    orbits of eccentricity 0.3 take 0.64, 0.59, 0.52 and 0.36 of the time of usual ones; with iterations to rounding
    they take 1.1, 1.0, 0.85 and 0.75.
    """
    return next((residual for below, residual in LONGER if refinement < below), CONVERGED)
