"""Estimates the number of steps of a run by a coarse run of the whole scene."""

from __future__ import annotations

import math
import sys
import time
from dataclasses import dataclass

from carom.errors import PhysicsError
from carom.physics.space import Space
from carom.plan.auto import integrator, step_limits
from carom.scene.schema import Scene

STRIDES = 8.0, 64.0  # times the steps of the scene; the longer if the shorter would take too long
LOOK_SECONDS = 3.0  # for each coarse run
MANY_STEPS = 100  # from this number on, the coarse run gives the time of a step better than the first steps
LIKELY = 2.0  # factor to which a complete estimate is right for the bundled scenes and extremes (test_estimate.py)


@dataclass(frozen=True, slots=True)
class Outlook:
    """Estimated steps of a whole run."""

    steps: int
    fewest: int
    most: int
    seconds: float
    seen: float  # part of the duration that the coarse run covered; 1 if it reached the end
    limits: dict[str, float]  # share of the steps that each limit sets, the largest first


def estimate_steps(scene: Scene, step_seconds: float, flight_seconds: float = math.inf) -> Outlook:
    """Estimate the steps of a run.

    Parameters
    ----------
    step_seconds
        Time that a step takes at the start.
    flight_seconds
        Time of a step where nothing touches, if a run takes many of these in one call, which the look does not.

    Raises
    ------
    SceneError, PhysicsError
        If the scene cannot run.
    """
    fixed = scene.time.fixed_dt
    if fixed is not None:
        steps = max(1, round(scene.time.duration / fixed))
        return Outlook(steps, steps, steps, steps * step_seconds, 1.0, {"fixed": 1.0})
    best: Outlook | None = None
    for stride in STRIDES:
        if best is None or best.seen < 1.0:
            found = _look(scene, stride, step_seconds, flight_seconds)
            best = found if best is None or found.seen > best.seen else best
    assert best is not None
    return best


def _look(scene: Scene, stride: float, step_seconds: float, flight_seconds: float) -> Outlook:
    """Run the whole scene with longer steps, and count those that it would have taken."""
    space, duration = Space(scene, stride=stride), scene.time.duration
    last = time.perf_counter()
    deadline = last + LOOK_SECONDS
    rates: list[float] = []  # 1/s, steps of the scene in a second of its time
    before, total, counted, seconds, touched = 0.0, 0.0, 0.0, 0.0, 0
    while before < duration and last < deadline:
        try:
            space.compute_dynamics(space.step + 1)
        except PhysicsError:
            if not rates:
                raise
            break  # the step is too long for this scene: use the part so far
        now, foreseen = time.perf_counter(), sum(space.foreseen.values())
        rates.append((foreseen - total) / space.dt)
        within = rates[-1] * (min(space.time, duration) - before)
        contacts = space.extremes.total_contacts
        each = now - last if contacts > touched else min(now - last, flight_seconds)
        counted, seconds = counted + within, seconds + each * within
        last, total, before, touched = now, foreseen, space.time, contacts
    rest = max(0.0, duration - before)
    half, lately = rates[len(rates) // 2 :], rates[-max(1, len(rates) // 4) :]
    steps = counted + rest * sum(lately) / len(lately)
    fewest, most = (counted + rest * min(half)) / LIKELY, (counted + rest * max(half)) * LIKELY
    if not integrator(scene).controls_error:
        fewest = max(fewest, min(steps, duration / step_limits(scene).max_dt))
    shares = {limit: count / total for limit, count in space.foreseen.items()}
    return Outlook(
        steps=_whole(steps),
        fewest=_whole(fewest),
        most=_whole(most),
        seconds=steps * (seconds / counted if counted > MANY_STEPS else step_seconds),
        seen=1.0 - rest / duration,
        limits=dict(sorted(shares.items(), key=lambda item: -item[1])),
    )


def _whole(steps: float) -> int:
    return max(1, round(min(steps, sys.float_info.max)))
