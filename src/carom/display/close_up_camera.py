"""The camera of a close-up: a position from which two bodies and all arrows beside them are seen."""

from __future__ import annotations

import numpy as np

from carom.arrays import BoolArray, FloatArray
from carom.physics.vector import minimum_images
from carom.recording.layout import drawing
from carom.recording.layout.camera import CameraFit
from carom.recording.layout.canvas import UP, View, turned

_MOST_UNLIKE = 6.0  # ratio of radii above which the view shows only a part of the larger body
ROOM = 1.35  # half size of the view around each body, in its radii
_ASIDE = 0.85  # the direction to the eye loses this fraction of its component along the normal
_USUAL = np.array([0.75, -1.0, 0.55]) / np.linalg.norm([0.75, -1.0, 0.55])  # towards the eye
_AROUND = np.radians([0, 30, -30, 60, -60, 90, -90, 120, -120, 150, -150, 180])  # from `_USUAL`, nearest first
SEEN = 0.5  # smallest ratio of an arrow's length on the screen to its length; below it, the arrow is a speck
_SHORT = 0.1  # fraction of the longest arrow of a kind; a shorter arrow is a speck from any side
# vertical part of the normal on the screen; velocities stand beside steeper normals, and above flatter normals
_STEEP = 0.7


def shown_whole(radius: FloatArray) -> BoolArray:
    """Return a mask (b,) of the bodies that are small enough to be shown whole."""
    return np.asarray(radius <= _MOST_UNLIKE * radius.min())


def lengths(vectors: FloatArray | None) -> FloatArray:
    """Return the vectors (..., 3) that are not short, as (k, 3), divided by the length of the longest."""
    if vectors is None:
        return np.zeros((0, 3))
    each = vectors.reshape(-1, 3)
    sizes = drawing.magnitudes(each)
    longest = float(sizes.max(initial=0.0))
    return np.asarray(each[sizes > _SHORT * longest] / longest if longest > 0.0 else np.zeros((0, 3)))


def direction(position: FloatArray, normal: FloatArray | None, *arrows: FloatArray) -> FloatArray | None:
    """Choose the direction to the eye of bodies at (b, 3) m: the usual direction, or the nearest that shows all arrows.

    The direction is nearly perpendicular to the normal. Each of ``arrows`` is (k, 3). Without a normal, the result is
    None, and the camera chooses the direction.
    """
    if len(position) == 2 and normal is None:
        apart = position[1] - position[0]
        normal = apart / max(float(np.linalg.norm(apart)), np.finfo(float).tiny)
    if normal is None:
        return None
    ways = np.stack([turned(_USUAL, UP, angle) for angle in _AROUND])
    ways -= _ASIDE * (ways @ normal)[:, None] * normal
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    drawn = np.concatenate(arrows)
    towards = np.abs(ways @ (drawn / np.linalg.norm(drawn, axis=1, keepdims=True)).T)
    seen = np.sqrt(1.0 - np.minimum(towards, 1.0) ** 2).min(axis=1, initial=1.0)
    return np.asarray(ways[int(np.argmax(np.minimum(seen, SEEN)))])


def fit(radius: FloatArray, position: FloatArray, to_eye: FloatArray | None) -> CameraFit:
    """Fit the camera to both bodies; if one is many times larger, only to the smaller."""
    if not shown_whole(radius).all():
        place = [int(np.argmin(radius))]
        return CameraFit(3.0 * radius[place], position[place], to_eye=to_eye)
    return CameraFit(ROOM * radius, position, to_eye=to_eye)


def beside(eye: View, normal: FloatArray | None, spin: FloatArray | None) -> FloatArray:
    """Return the direction (3,) across the normal on the screen in which no spin points: up, right, down or left."""
    right, up = eye.axes()
    across = up if normal is None or abs(normal @ up) < _STEEP else right
    return np.asarray(across if spin is None or spin.sum(axis=0) @ across <= 0.0 else -across)


def followed(position: FloatArray, half: float) -> FloatArray:
    """Return the point (3,) m that a camera follows, so that bodies at (b, 3) m are within ``half`` (m) of it.

    If two bodies are too far apart, the point is near the first body.
    """
    apart = position.mean(axis=0) - position[0]
    far = float(np.linalg.norm(apart))
    return np.asarray(position[0] + apart * min(1.0, half / far) if far > 0.0 else position[0])


def nearest_images(position: FloatArray, box: FloatArray | None) -> FloatArray:
    """Return positions, (..., b, 3) m: of the first body, and of each other body's image nearest to the first."""
    if box is None:
        return position
    first = position[..., :1, :]
    return first + minimum_images(position - first, box)
