"""The protocol of integrators that choose their own steps and take many of them per call.

`carom.registry` names the function ``make(scene, needs, bodies, uniform)`` of each. Other integrators are sequences of
kicks and drifts, which `carom.physics.step` takes one at a time.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, NamedTuple, Protocol

import numpy as np

from carom import registry
from carom.arrays import FloatArray
from carom.physics.bodies import Bodies
from carom.physics.saved import BODY, ENCOUNTER, RUN, Saved
from carom.plan.auto import integrator
from carom.plan.features import Requirements
from carom.scene.load import Scene

BY_LEAPFROG = -1.0  # value of ``last_dt`` where contacts came to rest, and leapfrog takes the steps


class EqualSteps(NamedTuple):
    """A series of equal steps of Wisdom–Holman integration, stored as five numbers in a checkpoint."""

    phase: float  # one of the phases in `wisdom_holman`
    start: float  # s, when the series began
    steps: float  # number of steps since then
    dt: float  # s
    limit: float  # index of the limit that set dt


@dataclass(frozen=True, slots=True)
class OrbitCheckpoint:
    """State of Wisdom–Holman integration; arrays are in the order of its Jacobi coordinates."""

    series: Annotated[FloatArray, Saved("orbit_series", "", RUN, len(EqualSteps._fields))]  # of `EqualSteps`
    order: Annotated[FloatArray, Saved("orbit_order", "", BODY)]  # (n,) index of each body in the scene
    near: Annotated[FloatArray, Saved("orbit_near", "m", BODY)]  # (n,) distance below which another body is close
    # (n, 3) Jacobi coordinates after the last kick
    position: Annotated[FloatArray, Saved("orbit_position", "m", BODY, 3)]
    velocity: Annotated[FloatArray, Saved("orbit_velocity", "m/s", BODY, 3)]  # (n, 3)

    def check(self) -> None:
        """Raise ValueError if no integration has such a state."""
        series = EqualSteps(*self.series.tolist())
        if not np.array_equal(np.sort(self.order), np.arange(len(self.order))):
            raise ValueError("orbit_order is not an order of the bodies")
        if series.phase not in (0.0, 1.0, 2.0) or series.steps < 0.0 or series.limit not in (0.0, 1.0, 2.0):
            raise ValueError("orbit_series is not a series of equal steps")


@dataclass(frozen=True, slots=True)
class IntegratorCheckpoint:
    """State of Gauss–Radau integration; rows of the last two are the coordinates x, y, z of body after body.

    With Wisdom–Holman integration, its arrays have rows only in close encounters.
    """

    # `BY_LEAPFROG`, or 0 if the last step predicts nothing
    last_dt: Annotated[float, Saved("integrator_last_dt", "s")]
    # (n, 3) accumulated rounding errors of the positions
    position_rest: Annotated[FloatArray, Saved("integrator_position_rest", "m", ENCOUNTER, 3)]
    velocity_rest: Annotated[FloatArray, Saved("integrator_velocity_rest", "m/s", ENCOUNTER, 3)]  # (n, 3)
    # (3 n, 8) coefficients of the last step's polynomial
    accepted: Annotated[FloatArray, Saved("integrator_accepted", "m/s²", ENCOUNTER, 8, rows=3)]
    # (3 n, 8) error of the predicted coefficients
    correction: Annotated[FloatArray, Saved("integrator_correction", "m/s²", ENCOUNTER, 8, rows=3)]
    orbits: OrbitCheckpoint | None = None  # None with Gauss–Radau integration alone

    def check(self) -> None:
        """Raise ValueError if no integration has such a state."""
        if self.orbits is None and not len(self.accepted):
            raise ValueError("integrator_accepted has no values")


class Meeting(NamedTuple):
    """Two ends that touch: bodies, or n + p for plane p."""

    ends: tuple[int, int]
    rests: bool  # whether forces press them together so that they do not separate


class Batch(NamedTuple):
    """Steps taken in one call; none if bodies meet at their start."""

    steps: int
    before: float  # s, time before the last step
    time: float  # s, time after it
    dt: float  # s, its length
    limit: str  # what set its length
    meeting: Meeting | None = None  # the pair that touches at the end; to be resolved before the next call


class BatchIntegrator(Protocol):
    """Moves bodies in place, many steps per call."""

    @property
    def next_dt(self) -> float:
        """The next step in seconds."""

    @property
    def checkpoint(self) -> IntegratorCheckpoint:
        """A copy of the state that the next step needs in addition to the bodies."""

    def begin(self, dt: float) -> None:
        """Start anew at the present positions and velocities, with a first step of about dt seconds."""

    def restore(self, checkpoint: IntegratorCheckpoint | None, next_dt: float) -> None:
        """Continue from a checkpoint with a step in s; without a checkpoint, start at the present state."""

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
