"""Where the bodies are at the moments of impacts, between two frames.

A body that has impacts between the frames is at the contact point of each, on the straight lines from one to the next.
The others go along the cubic that has their positions and velocities in both frames. Orientations are interpolated.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from carom.physics.checkpoint import Checkpoint
from carom.physics.frame import Frame
from carom.physics.parallel.jit import inline, long_kernel

FloatArray = NDArray[np.float64]


def positions_at(
    times: FloatArray,
    before: Frame | Checkpoint,
    after: Frame,
    impacts: NDArray[np.void],
    radius: FloatArray,
    box: FloatArray,
) -> FloatArray:
    """Return positions (k, n, 3) m at some times (k,) s.

    Parameters
    ----------
    before, after
        The frames on both sides.
    impacts
        All impacts between them, `CONTACT_ROW`, in order of time.
    radius
        (n,) m.
    box
        (3,) m, of a periodic domain; zeros in open space.
    """
    start, dt = before.position, after.time - before.time
    path = _nearest(after.position - start, box)
    s = np.clip((times - before.time) / dt, 0.0, 1.0)[:, None, None]
    own, other = before.velocity * dt - path, path - after.velocity * dt  # Hermite's, about the straight line
    found: FloatArray = start + s * path + s * (1.0 - s) * ((1.0 - s) * own + s * other)
    _pass_through(times, before.time, after.time, impacts, start, path, radius, box, found)
    return found


def orientations_at(times: FloatArray, before: Frame | Checkpoint, after: Frame) -> FloatArray | None:
    """Return orientations (k, n, 4) at some times (k,) s; None where bodies have none."""
    if before.orientation is None or after.orientation is None:
        return None
    s = np.clip((times - before.time) / (after.time - before.time), 0.0, 1.0)[:, None, None]
    sign = np.where(np.sum(before.orientation * after.orientation, axis=1, keepdims=True) < 0.0, -1.0, 1.0)
    turned = (1.0 - s) * before.orientation + s * sign * after.orientation
    return np.asarray(turned / np.linalg.norm(turned, axis=2, keepdims=True))


def _nearest(apart: FloatArray, box: FloatArray) -> FloatArray:
    """Return vectors to the nearest images."""
    return apart - box * np.round(apart / box) if box[0] > 0.0 else apart


@long_kernel
def _pass_through(
    times: FloatArray,
    began: float,
    ended: float,
    impacts: NDArray[np.void],
    start: FloatArray,
    path: FloatArray,
    radius: FloatArray,
    box: FloatArray,
    found: FloatArray,
) -> None:
    """Move the bodies that have impacts onto the straight lines from one to the next; see `positions_at`."""
    n = len(radius)
    first = np.zeros(n + 2, dtype=np.int64)  # of each body's impacts, in order of time
    for c in range(len(impacts)):
        first[min(n, impacts[c].i) + 1] += 1
        first[min(n, impacts[c].j) + 1] += 1
    for i in range(n + 1):
        first[i + 1] += first[i]
    own, filled = np.empty(2 * len(impacts), dtype=np.int64), first.copy()
    for c in range(len(impacts)):
        for body in (impacts[c].i, impacts[c].j):
            b = min(n, body)
            own[filled[b]] = c
            filled[b] += 1
    for body in range(n):
        lo, count = first[body], first[body + 1] - first[body]
        if count == 0:
            continue
        clock, way = np.empty(count + 2), np.empty((count + 2, 3))
        clock[0], clock[-1] = began, ended
        for k in range(3):
            way[0, k], way[-1, k] = 0.0, path[body, k]
        for c in range(count):
            impact = impacts[own[lo + c]]
            reach = -radius[body] if impact.i == body else radius[body]  # along the normal, which points out of i
            clock[c + 1] = impact.time
            way[c + 1, 0] = impact.x + reach * impact.nx - start[body, 0]
            way[c + 1, 1] = impact.y + reach * impact.ny - start[body, 1]
            way[c + 1, 2] = impact.z + reach * impact.nz - start[body, 2]
            if box[0] > 0.0:
                for k in range(3):
                    way[c + 1, k] -= box[k] * np.rint(way[c + 1, k] / box[k])
        for m in range(len(times)):
            for k in range(3):
                found[m, body, k] = start[body, k] + _interpolated(times[m], clock, way[:, k])


@inline
def _interpolated(time: float, clock: FloatArray, values: FloatArray) -> float:
    """Interpolate between values at times that do not fall, like `numpy.interp`."""
    k = 0
    while k < len(clock) - 1 and clock[k + 1] <= time:
        k += 1
    if k == len(clock) - 1 or time <= clock[k]:
        return float(values[k])
    return float((values[k + 1] - values[k]) / (clock[k + 1] - clock[k]) * (time - clock[k]) + values[k])
