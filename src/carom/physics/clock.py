"""The clock of a run."""

from __future__ import annotations

from dataclasses import dataclass, field

from carom.physics.error import PhysicsError
from carom.scene.units.dimension import TIME
from carom.scene.units.system import SI, UnitSystem

REMEDY = {  # for steps too short to move the clock, by the limit that sets them
    "error": "bodies fall into each other's centres: set gravity.softening",
    "pull": "bodies fall into each other's centres: set gravity.softening, or let them touch, contact.enabled",
    "acceleration": "raise time.target_dx, or set time.fixed_dt",
    "held": "raise time.target_dx, or set time.fixed_dt",
    "velocity": "raise time.cfl, or set time.fixed_dt",
}
ANY_REMEDY = "raise time.target_dx or time.cfl, or set time.fixed_dt"


@dataclass(slots=True)
class Clock:
    """Number, times and length of the last step."""

    step: int = 0
    time: float = 0.0  # s
    before: float = 0.0  # s, time before the last step
    dt: float = 0.0  # s
    limit: str = "start"  # what set dt
    foreseen: dict[str, float] = field(default_factory=dict)  # number of the scene's own steps so far, by their limit
    units: UnitSystem = SI  # of the scene, whose own look-up takes 2 µs

    def advance(self, steps: int, before: float, time: float, dt: float, limit: str) -> None:
        """Advance by one or more steps.

        Parameters
        ----------
        steps
            Number of steps.
        before, time, dt
            s, time before the last one and after it, and its length.
        limit
            What set its length.

        Raises
        ------
        PhysicsError
            If the last step did not change the time.
        """
        self.dt, self.limit = dt, limit
        if not time > before:
            raise PhysicsError(
                f"step {self.step + steps} of {self.units.text(dt, TIME, '.3g')} no longer moves the clock at "
                f"t = {self.units.text(before, TIME)} "
                f"(limit: {limit}); {REMEDY.get(limit, ANY_REMEDY)}"
            )
        self.step += steps
        self.before, self.time = before, time

    def foresee(self, limit: str, steps: float) -> None:
        """Count steps that the scene would have taken; those of a coarse look ahead are longer."""
        self.foreseen[limit] = self.foreseen.get(limit, 0.0) + steps
