"""The clock of a run."""

from __future__ import annotations

from dataclasses import dataclass, field

from carom.errors import PhysicsError
from carom.physics.diagnostics.run_monitor import remedies_of
from carom.scene.schema import Scene
from carom.scene.units.dimension import TIME
from carom.scene.units.system import UnitSystem

_INWARD = "bodies fall into each other's centres: set gravity.softening"
_CLOSE = {"error": _INWARD, "pull": f"{_INWARD}, or let them touch, contact.enabled"}  # by the limit that sets the step


@dataclass(slots=True)
class Clock:
    """Number, times and length of the last step."""

    scene: Scene
    units: UnitSystem  # of the scene, whose own look-up takes 2 µs
    step: int = 0
    time: float = 0.0  # s
    before: float = 0.0  # s, time before the last step
    dt: float = 0.0  # s
    limit: str = "start"  # what set dt
    foreseen: dict[str, float] = field(default_factory=dict)  # number of the scene's own steps so far, by their limit

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
                f"(limit: {limit}); {_remedy(self.scene, limit)}"
            )
        self.step += steps
        self.before, self.time = before, time

    def foresee(self, limit: str, steps: float) -> None:
        """Count steps that the scene would have taken; those of a coarse look ahead are longer."""
        self.foreseen[limit] = self.foreseen.get(limit, 0.0) + steps


def _remedy(scene: Scene, limit: str) -> str:
    """Say what to do about steps too short to move the clock, by the limit that sets them."""
    if limit in _CLOSE:
        return _CLOSE[limit]
    raised = remedies_of(scene).get(limit)
    if scene.time.accuracy is not None:
        return f"raise {raised}" if raised else "shorten time.duration"
    if limit in ("cap", "fixed"):
        return f"raise {raised}"
    return f"raise {raised or 'time.target_dx or time.cfl'}, or set time.fixed_dt"
