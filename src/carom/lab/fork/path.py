"""`Path`: where the bodies of one branch are at given times."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carom.errors import ExperimentError
from carom.lab.fork.branch import Start
from carom.lab.shrink.expression import Expression, UnknownNameError
from carom.lab.shrink.observation import Observation, Touches
from carom.physics.schedule import Every
from carom.physics.space import Space
from carom.plan.auto import frame_interval

FloatArray = NDArray[np.float64]

OPTION = "--outcome"
MOST_FRAMES = 200
_MULTIPLE = 1e-9  # relative, as in `Every`
_MOMENTS = "moments."  # the summary has these once something has happened


@dataclass(frozen=True, slots=True)
class Path:
    """Positions at multiples of an interval and at the end, and whether an outcome came about."""

    time: FloatArray  # (k,) s
    position: FloatArray  # (k, n, 3) m
    outcome: bool | None  # None if none is asked for


def interval_of(start: Start) -> float:
    """Return the interval in s at which branches are compared: that of the frames, or longer if these are many."""
    return float(max(frame_interval(start.scene), (start.scene.time.duration - start.checkpoint.time) / MOST_FRAMES))


def path_of(start: Start, shift: int | None, ulps: int, outcome: Expression | None, threads: int | None = 1) -> Path:
    """Run a branch to its end.

    Frames come at the first step at or after each multiple, and at the end. The bodies are taken back to the multiple
    along their velocities, since branches may take other steps.
    """
    interval = interval_of(start)
    space = start.space(threads, shift, ulps)
    time = _times(start.checkpoint.time, start.scene.time.duration, interval)
    position = np.full((len(time), *space.state.position.shape), np.nan)
    seen, initial, count, filled = Touches(space), space.status.energy.total, 0, 0
    for frame in space.run(schedule=Every(interval)):
        count += 1
        if outcome is not None:
            seen.see(frame)
        reached = int(np.searchsorted(time, frame.time * (1.0 + _MULTIPLE), side="right"))
        for row in range(filled, reached):  # more than one where steps are longer
            position[row] = frame.position - frame.velocity * (frame.time - time[row])
        filled = max(filled, reached)
    came = None
    if outcome is not None:
        summary = _summary(outcome, space, Observation(space, initial, count, [], seen))
        try:
            came = outcome.holds(summary)
        except UnknownNameError as error:
            raise ExperimentError(_explained(outcome, error.name, summary, len(space.state))) from None
    return Path(time, position, came)


def outcome_of(start: Start, text: str) -> Expression:
    """Read an outcome, before branches are run for it.

    Raises
    ------
    ExperimentError
        If it cannot be read, or names what no branch will have.
    """
    outcome, space = Expression(text, OPTION), start.space()
    summary = _summary(outcome, space, Observation(space, space.status.energy.total, 0, [], Touches(space)))
    for name in outcome.unknown(summary):
        if not name.startswith(_MOMENTS):
            raise ExperimentError(_explained(outcome, name, summary, len(space.state)))
    return outcome


def _summary(outcome: Expression, space: Space, seen: Observation) -> dict[str, Any]:
    return seen.summary | _of_bodies(outcome, space.state.position, space.state.velocity)


def _explained(outcome: Expression, name: str, summary: Mapping[str, Any], bodies: int) -> str:
    """Say that an outcome names no such number, or no such body."""
    if re.fullmatch(r"([xyz]|speed)_\d+", name):
        body = name.partition("_")[2]
        return f"{OPTION} {outcome.text}: there is no body {body} for {name}; the last is {bodies - 1}"
    return outcome.explain_unknown(name, summary)


def _times(origin: float, end: float, interval: float) -> FloatArray:
    """Return the multiples of an interval after a time, and the end (s)."""
    first, last = (int(np.floor(time / interval * (1.0 + _MULTIPLE))) for time in (origin, end))
    time = interval * np.arange(first + 1, last + 1).astype(np.float64)
    return time if len(time) and time[-1] * (1.0 + _MULTIPLE) >= end else np.append(time, end)


def _of_bodies(outcome: Expression, position: FloatArray, velocity: FloatArray) -> dict[str, float]:
    """Return what an outcome asks of single bodies: ``x_3`` in m, likewise y and z, and ``speed_3`` in m/s."""
    found: dict[str, float] = {}
    for name in outcome.names:
        what, _, number = name.partition("_")
        if number.isdigit() and int(number) < len(position):
            body = int(number)
            if what in ("x", "y", "z"):
                found[name] = float(position[body, "xyz".index(what)])
            elif what == "speed":
                found[name] = float(np.linalg.norm(velocity[body]))
    return found
