"""The phase of a run: free flight, collisions, or a pile that has settled."""

from __future__ import annotations

MEMORY = 50  # steps over which the energy of impacts is summed
SETTLED_BELOW = 1e-3  # of the energy scale; a pile whose impacts sum to less has settled


class Phase:
    """Follows the contacts of n bodies from step to step.

    ``name`` is "warm-up" before the first step, then "free", "colliding", or "settled": most bodies touch, and the
    impacts of late were slight.
    """

    def __init__(self, bodies: int) -> None:
        self.name = "warm-up"
        self._bodies = bodies
        self.activity = 0.0  # J, ½ μ v_n² of the impacts in the last steps

    def see(self, contacts: int, struck: float, scale: float) -> None:
        """Take note of a step.

        Parameters
        ----------
        contacts
            How many there were.
        struck
            J, Σ ½ μ v_n² of those that were impacts.
        scale
            J, the energy scale of the run.
        """
        self.activity += struck - self.activity / MEMORY
        if contacts == 0:
            self.name = "free"
        else:
            quiet = self.activity <= SETTLED_BELOW * scale
            self.name = "settled" if quiet and 2 * contacts >= self._bodies else "colliding"
