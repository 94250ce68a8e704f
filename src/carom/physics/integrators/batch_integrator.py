"""The protocol of integrators that choose their own steps and take many of them per call.

`carom.registry` names the function ``make(scene, needs, bodies, uniform)`` of each such integrator. Other integrators
are sequences of kicks and drifts; `carom.physics.step` takes their steps one at a time.
"""

from __future__ import annotations

from typing import NamedTuple, Protocol

from carom import registry
from carom.arrays import FloatArray
from carom.physics.bodies import Bodies
from carom.plan.auto import integrator
from carom.plan.features import Requirements
from carom.scene.load import Scene
from carom.state.checkpoint import IntegratorCheckpoint

BY_LEAPFROG = -1.0  # value of ``last_dt`` after contacts have come to rest and leapfrog has taken over


class Meeting(NamedTuple):
    """Two ends that touch: bodies, or n + p for plane p."""

    ends: tuple[int, int]
    rests: bool  # whether forces press the pair together, so that it does not separate


class Batch(NamedTuple):
    """Steps taken in one call; no steps if bodies meet at the start."""

    steps: int
    before: float  # s, time before the last step
    time: float  # s, time after the last step
    dt: float  # s, length of the last step
    limit: str  # the limit that set the length of the last step
    meeting: Meeting | None = None  # the pair that touches at the end, which must be resolved before the next call


class BatchIntegrator(Protocol):
    """Moves bodies in place, many steps per call."""

    @property
    def next_dt(self) -> float:
        """The length of the next step in seconds."""

    @property
    def checkpoint(self) -> IntegratorCheckpoint:
        """A copy of the state that the next step needs in addition to the bodies."""

    def begin(self, dt: float) -> None:
        """Start anew at the present positions and velocities, with a first step of about dt seconds."""

    def restore(self, checkpoint: IntegratorCheckpoint | None, next_dt: float) -> None:
        """Continue from a checkpoint with a step of ``next_dt`` s; without a checkpoint, start at the present state."""

    def advance(self, time: float, end: float, until: float, steps: int) -> Batch:
        """Take steps until a time or a number of steps is reached, or the run ends.

        Times are in s. The last step is cut to end at ``end``, but not at ``until``.
        """

    def at(self, earlier: float) -> tuple[FloatArray, FloatArray]:
        """Return positions and velocities, (n, 3) m and m/s, at a time (s) before the end of the last step."""


def batch_integrator_of(
    scene: Scene, needs: Requirements, bodies: Bodies, uniform: FloatArray
) -> BatchIntegrator | None:
    """Return the integrator of a scene if it takes many steps per call; ``uniform`` is the field, (3,) m/s²."""
    row = integrator(scene)
    if not row.controls_error:
        return None
    made: BatchIntegrator = registry.load("integrators", row.name)(scene, needs, bodies, uniform)
    return made
