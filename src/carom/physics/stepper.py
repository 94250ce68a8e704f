"""The protocol of steppers: `carom.physics.step` for kicks and drifts, `carom.physics.batch_step` for the rest."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from carom.physics.checkpoint import Checkpoint
from carom.physics.clock import Clock
from carom.physics.integrators.checkpoint import IntegratorCheckpoint
from carom.physics.schedule import Schedule

FloatArray = NDArray[np.float64]


class Goal(NamedTuple):
    """How far to advance."""

    end: float  # s, of the run
    schedule: Schedule  # after which steps a frame is due
    most: int  # steps
    shows_end: bool = True  # whether a frame is due after the last step

    def is_reached(self, clock: Clock) -> bool:
        """Whether a frame is due after the last step, by the schedule or because it was the last of the run."""
        return self.schedule(clock.step, clock.before, clock.time) or (self.shows_end and clock.limit == "end")


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

    def advance(self, goal: Goal, checked: bool) -> bool:
        """Advance by at least one step; return whether a frame is due.

        Parameters
        ----------
        goal
            How far; only integrators that take many steps per call go beyond the first step.
        checked
            Whether to check the energy after the step; a step with a frame is checked in any case.

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
