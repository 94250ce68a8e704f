"""The protocol of steppers: `carom.physics.step` for kicks and drifts, `carom.physics.batch_step` for the rest."""

from __future__ import annotations

from typing import NamedTuple, Protocol

from carom.arrays import FloatArray
from carom.physics.checkpoint import Checkpoint
from carom.physics.clock import Clock
from carom.physics.integrators.checkpoint import IntegratorCheckpoint
from carom.physics.schedule import Schedule, quiet


class Goal(NamedTuple):
    """How far to advance."""

    end: float  # s, of the run
    schedule: Schedule  # after which steps a frame is due
    checks: Schedule  # after which steps the errors are judged
    most: int  # steps
    shows_end: bool = True  # whether a frame is due after the last step

    def is_reached(self, clock: Clock) -> bool:
        """Whether a frame is due after the last step, by the schedule or because it was the last of the run."""
        return self.schedule(clock.step, clock.before, clock.time) or (self.shows_end and clock.limit == "end")

    def is_check(self, clock: Clock) -> bool:
        """Whether errors are judged after the last step, by the schedule or because it was the last of the run."""
        return self.checks(clock.step, clock.before, clock.time) or (self.shows_end and clock.limit == "end")

    def quiet(self, clock: Clock) -> tuple[float, float]:
        """Return after how many steps, and up to which time in s, neither a frame nor a check is due before."""
        frame, check = (quiet(due, clock.step, clock.time) for due in (self.schedule, self.checks))
        return min(frame[0], check[0]), min(frame[1], check[1])


class Stepper(Protocol):
    """Advances a world and keeps its books."""

    @property
    def previous_dt(self) -> float:
        """The step in s that the next one starts from: smoothed, without the cut at the end of a run."""

    @property
    def checkpoint(self) -> IntegratorCheckpoint | None:
        """A copy of the integrator's state besides the bodies; None if it has none."""

    @property
    def first_dt(self) -> float:
        """The step in s that the limits allow in the present state, before smoothing."""

    def warm_up(self, dt: float) -> None:
        """Take a few steps of dt seconds and book nothing; this loads the kernels."""

    def begin(self) -> None:
        """Begin a run at the present positions, velocities and accelerations."""

    def restore(self, checkpoint: Checkpoint) -> None:
        """Continue from a checkpoint, whose bodies are already in place."""

    def advance(self, goal: Goal) -> bool:
        """Advance by at least one step, and up to a goal where one call takes many; return whether a frame is due.

        Raises
        ------
        PhysicsError
            If the state is no longer finite, or a step no longer changes the clock.
        """

    @property
    def has_solution(self) -> bool:
        """Whether there is a solution between the beginning and the end of the last step."""

    def between(self, earlier: float) -> tuple[FloatArray, FloatArray] | None:
        """Return positions and velocities, (n, 3) m and m/s, at a time in s before the end of the last step.

        None if the integrator has no solution between the steps.
        """
