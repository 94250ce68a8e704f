"""Where the bodies are at the moments of impacts, between two frames.

A body that has impacts between the frames is at the contact point of each, on the straight lines from one to the next.
The others go along the cubic that has their positions and velocities in both frames. Orientations are interpolated.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from carom.physics.checkpoint import Checkpoint
from carom.physics.frame import Frame

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
    for body in np.unique(np.concatenate([impacts["i"], impacts["j"]])):
        if body < len(radius):
            touched, at = _touched(impacts, int(body), radius)
            way = np.concatenate([np.zeros((1, 3)), _nearest(at - start[body], box), path[body][None]])
            clock = np.concatenate([[before.time], touched, [after.time]])
            for k in range(3):
                found[:, body, k] = start[body, k] + np.interp(times, clock, way[:, k])
    return found


def orientations_at(times: FloatArray, before: Frame | Checkpoint, after: Frame) -> FloatArray | None:
    """Return orientations (k, n, 4) at some times (k,) s; None where bodies have none."""
    if before.orientation is None or after.orientation is None:
        return None
    s = np.clip((times - before.time) / (after.time - before.time), 0.0, 1.0)[:, None, None]
    sign = np.where(np.sum(before.orientation * after.orientation, axis=1, keepdims=True) < 0.0, -1.0, 1.0)
    turned = (1.0 - s) * before.orientation + s * sign * after.orientation
    return np.asarray(turned / np.linalg.norm(turned, axis=2, keepdims=True))


def _touched(impacts: NDArray[np.void], body: int, radius: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return when a body had impacts (k,) and where its centre was, (k, 3) m."""
    own = impacts[(impacts["i"] == body) | (impacts["j"] == body)]
    point = np.stack([own["x"], own["y"], own["z"]], axis=1)
    normal = np.stack([own["nx"], own["ny"], own["nz"]], axis=1)  # out of i
    side = np.where(own["i"] == body, -1.0, 1.0)[:, None]
    return own["time"], point + side * radius[body] * normal


def _nearest(apart: FloatArray, box: FloatArray) -> FloatArray:
    """Return vectors to the nearest images."""
    return apart - box * np.round(apart / box) if box[0] > 0.0 else apart
