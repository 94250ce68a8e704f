"""Where the bodies are at the moments of impacts, between two frames.

A body that has impacts between the frames is at the contact point of each, on the straight lines from one to the next.
The others go along the cubic that has their positions and velocities in both frames. Orientations are interpolated.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from carom.physics.checkpoint import Checkpoint
from carom.physics.frame import Frame
from carom.physics.parallel.jit import long_kernel
from carom.physics.periodic_box import minimum_image, minimum_images

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


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
    first, order = _by_body(impacts, len(radius))
    most = int(np.diff(first).max(initial=0)) + 2  # with both frames
    scratch = np.empty(most), np.empty((most, 3))
    _pass_through(times, (before.time, after.time), impacts, first, order, start, path, radius, box, *scratch, found)
    return found


def _by_body(impacts: NDArray[np.void], bodies: int) -> tuple[IntArray, IntArray]:
    """Return where the impacts of each body begin, (n + 1,), and the impacts body after body, each body's in order."""
    struck = np.column_stack((impacts["i"], impacts["j"])).ravel()
    order = np.argsort(struck, kind="stable")
    return np.searchsorted(struck[order], np.arange(bodies + 1)), order // 2


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
    return minimum_images(apart, box) if box[0] > 0.0 else apart


@long_kernel
def _pass_through(
    times: FloatArray,
    ends: tuple[float, float],
    impacts: NDArray[np.void],
    first: IntArray,
    own: IntArray,
    start: FloatArray,
    path: FloatArray,
    radius: FloatArray,
    box: FloatArray,
    clock: FloatArray,
    way: FloatArray,
    found: FloatArray,
) -> None:
    """Move the bodies that have impacts onto the straight lines from one to the next; see `positions_at`.

    ``clock`` and ``way`` hold the times and positions of one body's corners. (Made in here, they took a second to
    compile.)
    """
    for body in range(len(radius)):
        lo, last = first[body], first[body + 1] - first[body] + 1  # the corner after the last impact
        if last == 1:
            continue
        clock[0], clock[last] = ends[0], ends[1]
        for k in range(3):
            way[0, k], way[last, k] = 0.0, path[body, k]
        for c in range(1, last):
            impact = impacts[own[lo + c - 1]]
            reach = -radius[body] if impact.i == body else radius[body]  # along the normal, which points out of i
            clock[c] = impact.time
            way[c, 0] = impact.x + reach * impact.nx - start[body, 0]
            way[c, 1] = impact.y + reach * impact.ny - start[body, 1]
            way[c, 2] = impact.z + reach * impact.nz - start[body, 2]
            if box[0] > 0.0:
                for k in range(3):
                    way[c, k] = minimum_image(way[c, k], box[k])
        for m in range(len(times)):
            time, c = times[m], 0  # the corner before, as in `numpy.interp`
            while c < last and clock[c + 1] <= time:
                c += 1
            for k in range(3):
                if c == last or time <= clock[c]:
                    found[m, body, k] = start[body, k] + way[c, k]
                else:
                    speed = (way[c + 1, k] - way[c, k]) / (clock[c + 1] - clock[c])
                    found[m, body, k] = start[body, k] + (speed * (time - clock[c]) + way[c, k])
