"""Steps that keep an accuracy until the promise ends, and ordinary steps after that."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Protocol

from carom.arrays import FloatArray
from carom.physics.integrators.batch_integrator import BY_LEAPFROG
from carom.physics.schedule import Goal
from carom.physics.world import Clock
from carom.plan.auto import integrator
from carom.scene.load import Scene
from carom.state.checkpoint import Checkpoint, IntegratorCheckpoint

HORIZON = "horizon"  # name of the limit of the last step that keeps the accuracy


class Stepper(Protocol):
    """Advances a world and keeps its books."""

    @property
    def previous_dt(self) -> float:
        """The step (s) from which the next step is chosen."""

    @property
    def first_dt(self) -> float:
        """The step (s) that the limits allow in the present state."""

    @property
    def checkpoint(self) -> IntegratorCheckpoint | None:
        """A copy of the state that the next step needs in addition to the bodies and contacts."""

    @property
    def has_solution(self) -> bool:
        """Whether the last step has dense output, for `between`."""

    def warm_up(self, dt: float) -> None:
        """Take a step of about dt seconds, to load the kernels."""

    def begin(self) -> None:
        """Begin a run at the present positions and velocities."""

    def take_over(self) -> None:
        """Continue from the present state of a run, in place of another stepper."""

    def restore(self, checkpoint: Checkpoint) -> None:
        """Continue from a checkpoint, whose bodies are already restored."""

    def advance(self, goal: Goal) -> bool:
        """Advance by at least one step; return whether a frame is due."""

    def between(self, earlier: float) -> tuple[FloatArray, FloatArray] | None:
        """Return positions and velocities, (n, 3) m and m/s, at a time (s) before the end of the last step."""


class PromisedStepper:
    """Advances a world by the steps that keep an accuracy until the promise ends, then by ordinary steps.

    A step ends where the promise ends (``until``, s). A checkpoint at that time therefore belongs to the accurate
    stepper, a later checkpoint to the ordinary stepper, which ``ordinary`` makes when it is needed.
    """

    def __init__(self, clock: Clock, until: float, accurate: Stepper, ordinary: Callable[[], Stepper]) -> None:
        self._clock, self._until, self._accurate, self._make = clock, until, accurate, ordinary
        self._ordinary: Stepper | None = None
        self._is_over = False  # whether ordinary steps are taken

    @property
    def _present(self) -> Stepper:
        return self._ordinary if self._ordinary and self._is_over else self._accurate

    @property
    def previous_dt(self) -> float:
        """The step (s) from which the next step is chosen."""
        return self._present.previous_dt

    @property
    def first_dt(self) -> float:
        """The step (s) that the limits allow in the present state."""
        return self._present.first_dt

    @property
    def checkpoint(self) -> IntegratorCheckpoint | None:
        """A copy of the integrator's state without the bodies, in the same form during the whole run."""
        carried = self._accurate.checkpoint
        if carried is None or not self._is_over:
            return carried
        return self._present.checkpoint or replace(carried, last_dt=BY_LEAPFROG)

    def warm_up(self, dt: float) -> None:
        """Take a step of about dt seconds, to load the kernels."""
        self._accurate.warm_up(dt)

    def begin(self) -> None:
        """Begin a run at the present positions and velocities."""
        self._is_over = False
        self._accurate.begin()

    def take_over(self) -> None:
        """Continue from the present state of a run, in place of another stepper."""
        self._present.take_over()

    def restore(self, checkpoint: Checkpoint) -> None:
        """Continue from a checkpoint, whose bodies are already restored."""
        self._is_over = checkpoint.time > self._until
        if self._is_over:
            self._ordinary = self._ordinary or self._make()
        self._present.restore(checkpoint)

    def advance(self, goal: Goal) -> bool:
        """Advance up to the goal or the end of the promise; return whether a frame is due."""
        clock = self._clock
        if not self._is_over and clock.time >= self._until:
            self._is_over, self._ordinary = True, self._ordinary or self._make()
            self._ordinary.take_over()
        if self._is_over or goal.end <= self._until:
            return self._present.advance(goal)
        due = self._accurate.advance(goal._replace(end=self._until, shows_end=False))
        if clock.time == self._until:
            clock.limit = HORIZON
        return due

    @property
    def has_solution(self) -> bool:
        """Whether the last step has dense output, for `between`."""
        return self._present.has_solution

    def between(self, earlier: float) -> tuple[FloatArray, FloatArray] | None:
        """Return positions and velocities, (n, 3) m and m/s, at a time (s) before the end of the last step."""
        return self._present.between(earlier)


def without_accuracy(scene: Scene) -> Scene:
    """Return a scene without its promise, so that its steps are ordinary, as they are after the promise has ended.

    Impacts keep their exact times. An integrator that chooses its own steps is kept, since its state is recorded.
    """
    time = scene.time.model_copy(update={"accuracy": None})
    timing = scene.contact.model_copy(update={"timing": "time-of-impact"}) if scene.contact.enabled else scene.contact
    ordinary = scene.model_copy(update={"promise": None, "time": time, "contact": timing})
    if integrator(ordinary).controls_error:
        same = time.model_copy(update={"integrator": integrator(scene).name})
        return ordinary.model_copy(update={"time": same})
    return ordinary
