"""After which steps a frame is handed out; the last step of a run gets one in any case. Steps do not depend on it."""

from __future__ import annotations

from collections.abc import Callable, Container

Schedule = Callable[[int, float, float], bool]  # step, the time before it and after it in s → whether a frame is due

MULTIPLE_TOLERANCE = 1e-9  # of a time, within which it counts as a multiple of the frames' interval


def every(interval: float) -> Schedule:
    """Return a frame at the first step at or after each multiple of an interval in s; 0 is every step."""
    if interval == 0.0:
        return lambda step, before, time: True
    return lambda step, before, time: _multiples(time, interval) > _multiples(before, interval)


def at(steps: Container[int]) -> Schedule:
    """Return a frame after each of these steps."""
    return lambda step, before, time: step in steps


def _multiples(time: float, interval: float) -> float:
    """Count the multiples of an interval up to a time, forgiving the rounding of a clock that adds up steps."""
    return time / interval * (1.0 + MULTIPLE_TOLERANCE) // 1.0
