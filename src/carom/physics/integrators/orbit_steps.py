"""The steps of Wisdom–Holman integration: many equal ones, or a single one of any length."""

from __future__ import annotations

from typing import Any

from carom.arrays import FloatArray, Records
from carom.physics.integrators.jacobi import from_jacobi, put, to_jacobi
from carom.physics.integrators.mutual_pull import kick
from carom.physics.integrators.orbit_arrays import Orbits
from carom.physics.integrators.orbit_encounters import meets
from carom.physics.integrators.symplectic_corrector import correct, drift
from carom.physics.jit.decorators import long_kernel, unowned
from carom.physics.step_rule import END_TOLERANCE

PARTED = 1.2  # times the distance from which bodies are close, beyond which they are no longer


@long_kernel
def begin(o: Orbits, h: float) -> None:
    """Take positions and velocities as a new start, for steps of h seconds."""
    to_jacobi(o.position, o.order, o.share, o.x)
    to_jacobi(o.velocity, o.order, o.share, o.v)
    correct(o, o.x, o.v, h, True)


@long_kernel
def advance(o: Orbits, progress: Records, end: float, until: float, most: int) -> None:
    """Make whole steps; see `BatchIntegrator`."""
    run = progress[0]
    run.close = 0
    while run.steps < most and (run.time < until or run.steps == 0) and end - run.time > run.dt * (1.0 + END_TOLERANCE):
        _copy(o.x, o.x_spare)
        _copy(o.v, o.v_spare)
        if not _step(o, run, o.x_spare, o.v_spare):
            run.close = 1
            break
        _copy(o.x_spare, o.x)
        _copy(o.v_spare, o.v)
        run.count += 1
        run.steps += 1
        run.before = run.time
        run.time = run.start + run.count * run.dt
        if not run.time > run.before:
            break
    if run.count > 0:
        _put_out(o, run.dt)


@long_kernel
def leap(o: Orbits, h: float, position: FloatArray, velocity: FloatArray, surely: bool) -> bool:
    """Write positions and velocities a single step of h seconds, forward or back, from those of the bodies.

    Returns False without writing if bodies meet on the way, unless ``surely``.
    """
    x, v = o.x_spare, o.v_spare
    to_jacobi(o.position, o.order, o.share, x)
    to_jacobi(o.velocity, o.order, o.share, v)
    correct(o, x, v, h, True)
    drift(x, v, o.mu, o.lanes, 0.5 * h)
    from_jacobi(x, o.share, o.place)
    from_jacobi(v, o.share, o.speed)
    if not surely and meets(o, x, -0.5 * abs(h), 0.5 * abs(h), 1.0):
        return False
    kick(o, x, v, h)
    drift(x, v, o.mu, o.lanes, 0.5 * h)
    correct(o, x, v, h, False)
    put(o, x, o.place, position)
    put(o, v, o.speed, velocity)
    return True


@long_kernel
def meets_soon(o: Orbits, until: float) -> bool:
    """Tell whether bodies come close in a time in s from now."""
    x, v = o.x_spare, o.v_spare
    to_jacobi(o.position, o.order, o.share, x)
    to_jacobi(o.velocity, o.order, o.share, v)
    from_jacobi(x, o.share, o.place)
    from_jacobi(v, o.share, o.speed)
    return meets(o, x, 0.0, until, PARTED)


@unowned
def _step(o: Orbits, run: Any, x: FloatArray, v: FloatArray) -> bool:
    """Drift to the middle of the next step and kick, unless bodies meet there."""
    dt = run.dt
    drift(x, v, o.mu, o.lanes, dt if run.count > 0 else 0.5 * dt)
    from_jacobi(x, o.share, o.place)
    from_jacobi(v, o.share, o.speed)
    if meets(o, x, -0.5 * dt, 0.5 * dt, 1.0):
        return False
    kick(o, x, v, dt)
    return True


@unowned
def _put_out(o: Orbits, h: float) -> None:
    """Write positions and velocities after the last whole step."""
    x, v = o.x_spare, o.v_spare
    _copy(o.x, x)
    _copy(o.v, v)
    drift(x, v, o.mu, o.lanes, 0.5 * h)
    correct(o, x, v, h, False)
    put(o, x, o.place, o.position)
    put(o, v, o.speed, o.velocity)


@unowned
def _copy(source: FloatArray, target: FloatArray) -> None:
    for i in range(len(source)):
        target[i, 0], target[i, 1], target[i, 2] = source[i, 0], source[i, 1], source[i, 2]
