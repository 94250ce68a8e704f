"""Kernels for kicks, drifts and periodic boxes; the kernels for few bodies also include drag."""

from __future__ import annotations

from typing import Any, NamedTuple

from carom.arrays import FloatArray
from carom.physics.jit.decorators import Function, for_first, long_kernel
from carom.physics.vector import minimum_image

MIN_BODIES_PER_TASK = 5000


@long_kernel
def advance(lo: int, hi: int, what: FloatArray, rate: FloatArray, dt: float) -> None:
    """Add rate × dt to rows [lo, hi) of (n, 3) arrays."""
    for i in range(lo, hi):
        what[i, 0] += rate[i, 0] * dt
        what[i, 1] += rate[i, 1] * dt
        what[i, 2] += rate[i, 2] * dt


@long_kernel
def wrap_rows(lo: int, hi: int, position: FloatArray, box: FloatArray) -> None:
    """Wrap the centres [lo, hi) into the box."""
    for i in range(lo, hi):
        for k in range(3):
            position[i, k] = minimum_image(position[i, k], box[k])


class KickedBodies(NamedTuple):
    """The bodies of a kick."""

    x: FloatArray  # (n, 3) m
    v: FloatArray  # (n, 3) m/s
    a: FloatArray  # (n, 3) m/s²
    mass: FloatArray  # (n,) kg
    inverse_mass: FloatArray  # (n + p,) 1/kg


class DampedPath(NamedTuple):
    """How velocities change along a drift; see `carom.physics.contact.events.trajectories`."""

    kick: float  # s
    damping: float  # 1/s
    strength: float  # factor for the accelerations


class DampedStep(NamedTuple):
    """A leapfrog step with a force that depends on velocities: kick, factor, drift, factor, kick."""

    length: float  # s
    first_kick: float  # s
    before: float  # factor for the velocities before the drift, which turns them into mean velocities of the drift
    after: float  # factor for the velocities after the drift
    last_kick: float  # s
    booked: float  # s, part of the drift for which the work of other forces is booked beforehand
    held_kick: float  # s, effective length of the first kick for held contacts
    path: DampedPath


def _without_drag(function: Function) -> Function:
    """Let kernels call a function if its first argument is empty; `forces.drag` adds variants for a `DragLaw`."""
    return for_first(function, lambda damping: len(damping) == 0)(function)


# The next functions are for kernels only. ``damping`` is the `DragLaw`, or an empty tuple.


@_without_drag
def damped_step(damping: Any, length: float, kick: float, last_kick: float) -> DampedStep:
    """Return a step, given its length and the two kicks that it has without drag, in s."""
    return DampedStep(length, kick, 1.0, 1.0, last_kick, kick, kick, DampedPath(kick, 0.0, 1.0))


@_without_drag
def kick_before_drift(damping: Any, bodies: KickedBodies, step: DampedStep, holds: bool) -> None:
    """Kick before the drift of a step; ``holds`` states whether contacts are held after the kick."""
    advance(0, len(bodies.v), bodies.v, bodies.a, step.first_kick)


@_without_drag
def measure_hold(damping: Any, bodies: KickedBodies, step: DampedStep) -> None:
    """Compute how much the energy lost to drag changes because contacts are held."""


@_without_drag
def kick_after_drift(damping: Any, bodies: KickedBodies, step: DampedStep) -> None:
    """Kick after the drift of a step."""
    advance(0, len(bodies.v), bodies.v, bodies.a, step.last_kick)


@_without_drag
def book_exchange(damping: Any) -> None:
    """Add a step's exchange with the medium to `DragLaw.exchanged`."""
