"""The phase of a run: free flight, collisions, or a pile that has settled."""

from __future__ import annotations

from carom.physics.diagnostics.energy import Energy
from carom.physics.parallel.jit import kernel

STEPS_REMEMBERED = 50  # over which the energy of impacts is summed
SETTLED_BELOW = 1e-3  # of the energy scale; a pile has settled if its recent impacts sum to less
STILL_BELOW = 1e-4  # of the energy scale; bodies with more kinetic energy roll, slide or fall


class Activity:
    """Follows the contacts of n bodies from step to step.

    ``phase`` is "warm-up" before the first step, then "free", "colliding" or "settled". A run has settled if most
    bodies touch, recent impacts were slight and, with ``from_rest``, the kinetic energy is small.

    Parameters
    ----------
    bodies
        How many there are.
    from_rest
        Whether there is a uniform field or something fixed, so a pile at rest has no kinetic energy. Otherwise it may
        drift and turn as a whole.
    """

    def __init__(self, bodies: int, from_rest: bool) -> None:
        self.phase = "warm-up"
        self.impact_energy = 0.0  # J, ½ μ v_n² of the impacts in the last steps
        self._bodies = bodies
        self._from_rest = from_rest
        self._contacts: int | None = None  # of the last step; None before the first one of a new or resumed run

    def reopen(self, phase: str, impact_energy: float) -> None:
        """Continue an earlier run."""
        self.phase, self.impact_energy, self._contacts = phase, impact_energy, None

    def see(self, contacts: int, impact_energy: float) -> None:
        """Add a step: the number of its contacts, and Σ ½ μ v_n² of its impacts, in J."""
        if impact_energy or self.impact_energy:
            self.impact_energy = remembered(self.impact_energy, impact_energy)
        self._contacts = contacts

    def judge(self, energy: Energy) -> None:
        """Update the phase after the last step, given the energy at its end."""
        if self._contacts is None:
            return
        if self._contacts == 0:
            self.phase = "free"
            return
        quiet = self.impact_energy <= SETTLED_BELOW * energy.scale
        still = not self._from_rest or energy.translational + energy.rotational <= STILL_BELOW * energy.scale
        self.phase = "settled" if quiet and still and 2 * self._contacts >= self._bodies else "colliding"


@kernel
def remembered(energy: float, struck: float) -> float:
    """Return the energy of recent impacts after a step, given that before it and that of its impacts, all in J."""
    return energy + (struck - energy / STEPS_REMEMBERED)
