"""Places the camera so that the bodies fill a 3D view.

Let d be the unit vector towards the eye, e an axis of the screen, D the eye's distance from the target, and t the
target's coordinate along e. A sphere with centre o and radius r lies inside the picture's border of slope s if

    o·e − t + r √(1 + s²)  ≤  s (D − o·d).

Each border thus requires the largest o·e + s o·d + r √(1 + s²) of the bodies. Two opposite borders together give the
smallest D and its t.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from carom.arrays import BoolArray, FloatArray, IntArray
from carom.recording.schema.header import Header

if TYPE_CHECKING:
    from carom.physics.frame import Frame


ASPECT = 1.25  # width over height of a 3D view, unless the layout gives another

_ESCAPING = 0.05  # largest share of the bodies that may be outside the view
_FAR = 20.0  # times the median distance from the middle; farther bodies may lie outside the picture
_FEW = 5  # bodies; of so few or fewer all are inside the view
_FILLED = 0.9  # of the picture's shorter side, filled by the bodies of the first moment
_LOOSE = 1.7  # largest distance over that which just shows the first moment, whose bodies then fill 53 %
_LOOSE_PATHS = 25.0  # for paths: 23 if e = 0.7, at pericentre, in a picture 3.3 times as wide as high
_MOST, _LARGEST = 100_000, 1000  # bodies that are measured; of more, every k-th and as many of the largest
_SLOPE = float(np.tan(np.radians(55.0 / 2)))  # Rerun's field of view is 55° from top to bottom
_FLAT = 0.2  # thickness over width; flatter sets of bodies are seen from higher above
_LOW, _HIGH = np.array([0.75, -1.0, 0.55]), np.array([0.45, -0.6, 1.0])  # towards the eye; z is up


@dataclass(frozen=True, slots=True)
class View:
    """Position of the camera, and whether it follows the bodies."""

    target: FloatArray  # (3,) m
    distance: float  # m, of the eye from the target
    follows: bool
    to_eye: FloatArray  # (3,) unit vector

    @property
    def eye(self) -> FloatArray:
        """Position of the eye (m)."""
        return np.asarray(self.target + self.distance * self.to_eye)

    def axes(self) -> FloatArray:
        """Return the unit vectors to the right and up on the screen, (2, 3)."""
        return _screen(self.to_eye)[:2]

    def height(self) -> float:
        """Return the height (m) of the picture at the target."""
        return 2.0 * _SLOPE * self.distance


class CameraFit:
    """Fits the camera to the bodies at a first moment, and at other moments unless it would move too far away.

    Parameters
    ----------
    radius
        (n,) m.
    first
        (n, 3) m, positions at the moment that the view opens with.
    corners
        (k, 3) m, points that must be inside the view, such as the corners of walls.
    to_eye
        (3,) unit vector towards the eye; by default it follows from the shape of the set of bodies.
    """

    def __init__(
        self,
        radius: FloatArray,
        first: FloatArray,
        corners: FloatArray | None = None,
        to_eye: FloatArray | None = None,
    ) -> None:
        self._shown = _shown(radius)
        first, radius = first[self._shown], radius[self._shown]
        near = _near(first)
        self._radius = radius
        self._first, self._first_radius = first[near], radius[near]
        self._corners = np.zeros((0, 3)) if corners is None else corners
        direction = _direction(first if corners is None else corners) if to_eye is None else to_eye
        self._axes = _screen(direction)
        self._centre = _middle(first, radius)
        self._own = self._box(first)  # (2, 3) m, lower and upper ends along the axes
        self._still = self._own  # the same of all moments
        self._moving = self._own - self._axes @ self._centre  # of all moments, each about its own middle
        self._drift = 0.0
        self._loose = _LOOSE

    def see(self, batch: Sequence[Frame], origin: FloatArray) -> None:
        """Take the last frame of a batch into account."""
        self.look(batch[-1].position - origin)

    def look(self, position: FloatArray) -> None:
        """Take positions (n, 3) into account."""
        position = position[self._shown]
        centre = _middle(position, self._radius)
        self._drift = max(self._drift, float(np.linalg.norm(centre - self._centre)))
        box = self._box(position)
        self._still = _joined(self._still, box)
        self._moving = _joined(self._moving, box - self._axes @ centre)

    def include(self, points: FloatArray) -> None:
        """Take points (k, 3) m of paths into account, also where they are far wider than the set of bodies."""
        along = points[np.all(np.isfinite(points), axis=1)] @ self._axes.T
        if len(along):
            self._still = _joined(self._still, np.array([along.min(axis=0), along.max(axis=0)]))
            self._loose = _LOOSE_PATHS

    def view(self, aspect: float = ASPECT, room: float = 0.0) -> View:
        """Return a view of the first moment and, unless bodies would look too small, of all others.

        Parameters
        ----------
        aspect
            Width of the picture over its height.
        room
            m, margin around the bodies for arrows; smaller if bodies would look too small.
        """
        follows = len(self._corners) == 0 and self._drift > np.ptp(self._own, axis=0).max() / 2
        whole = self._moving if follows else self._still - self._axes @ self._centre
        slopes = _FILLED * _SLOPE * np.array([aspect, 1.0])
        now = self._borders(self._first, self._first_radius, slopes)
        if len(self._corners):
            now = np.maximum(now, self._borders(self._corners, np.zeros(len(self._corners)), slopes))
        if not np.isfinite(now).all():
            return View(np.zeros(3), 4.0 * float(self._radius.max()), False, self._axes[2])
        others = _corners_of(whole) @ self._axes + self._centre
        later = np.maximum(now, self._borders(others, np.zeros(8), slopes))
        if room > 0.0:
            later = np.maximum(later, self._borders(self._first, self._first_radius + room, slopes))
        distance = min(_distance(later, slopes), self._loose * _distance(now, slopes))
        # the target may be anywhere between the two at which the bodies of the first moment touch a border
        low, high = now[:, 0] - slopes * distance, slopes * distance - now[:, 1]
        across, up = np.clip((later[:, 0] - later[:, 1]) / 2, np.minimum(low, high), np.maximum(low, high))
        target = self._centre + across * self._axes[0] + up * self._axes[1]
        return View(target, distance, follows, self._axes[2])

    def _borders(self, position: FloatArray, radius: FloatArray, slopes: FloatArray) -> FloatArray:
        """Return the numbers that the right and left, upper and lower borders require, (2, 2) m from the centre."""
        right, up, depth = self._axes @ (position - self._centre).T
        found = np.empty((2, 2))
        for k, along in enumerate((right, up)):
            reach = slopes[k] * depth + radius * np.sqrt(1.0 + slopes[k] ** 2)
            found[k] = _largest(along + reach, radius), _largest(reach - along, radius)
        return found

    def _box(self, position: FloatArray) -> FloatArray:
        near = _near(position)
        along, radius = position[near] @ self._axes.T, self._radius[near]
        low = [-_largest(radius - along[:, k], radius) for k in range(3)]
        high = [_largest(radius + along[:, k], radius) for k in range(3)]
        return np.array([low, high])


def corners_of(header: Header, origin: FloatArray) -> FloatArray | None:
    """Return the drawn corners (8, 3) of the walls or of the periodic box; None if there is neither."""
    size = header.walls if header.walls is not None else header.box
    return None if size is None else _corners_of(np.array([-size / 2, size / 2]) - origin)


def _corners_of(ends: FloatArray) -> FloatArray:
    """Return the corners (8, 3) of the box between two opposite ones, (2, 3)."""
    return np.array([[ends[i, 0], ends[j, 1], ends[k, 2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)])


def _joined(one: FloatArray, other: FloatArray) -> FloatArray:
    """Return the box around two boxes; ends that are not finite are ignored."""
    other = np.where(np.isfinite(other), other, one)
    return np.array([np.minimum(one[0], other[0]), np.maximum(one[1], other[1])])


def _distance(borders: FloatArray, slopes: FloatArray) -> float:
    return float(np.max(borders.sum(axis=1) / (2.0 * slopes)))


def _direction(position: FloatArray) -> FloatArray:
    """Choose the direction to the eye: higher above if the bodies lie in a horizontal plane, but not in a line."""
    finite = position[np.all(np.isfinite(position), axis=1)]
    direction = _LOW
    if len(finite) > 2:
        level = np.sqrt(np.maximum(np.linalg.eigvalsh(np.cov(finite[:, :2].T)), 0.0))
        if float(np.std(finite[:, 2])) < _FLAT * level[1] and level[0] > _FLAT * level[1]:
            direction = _HIGH
    return np.asarray(direction / np.linalg.norm(direction))


def _screen(to_eye: FloatArray) -> FloatArray:
    """Return the axes of the screen: to the right, up and towards the eye."""
    right = np.cross([0.0, 0.0, 1.0], to_eye)
    if not right.any():  # straight from above or below
        right = np.array([1.0, 0.0, 0.0])
    right /= np.linalg.norm(right)
    return np.array([right, np.cross(to_eye, right), to_eye])


def _largest(values: FloatArray, radius: FloatArray) -> float:
    """Return the largest value of the bodies that must be inside the view, or of all if the bodies are points.

    The bodies that may be outside are weighted by number and by area, so that a planet among 1000 moons is inside.
    """
    finite = np.isfinite(values)
    values, radius = values[finite], radius[finite]
    if len(values) == 0:
        return -np.inf
    area = (radius / max(radius.max(), np.finfo(float).tiny)) ** 2
    if area.sum() == 0.0:
        return float(values.max())
    weight = 0.5 / len(values) + 0.5 * area / area.sum()
    order = np.argsort(-values)
    beyond = np.cumsum(weight[order])
    return float(values[order[np.searchsorted(beyond, _ESCAPING)]])


def _shown(radius: FloatArray) -> slice | IntArray:
    """Return which of many bodies stand for all."""
    if len(radius) <= _MOST:
        return slice(None)
    chosen = np.zeros(len(radius), dtype=bool)
    chosen[:: -(-len(radius) // _MOST)] = True
    chosen[np.argpartition(radius, -_LARGEST)[-_LARGEST:]] = True
    return np.flatnonzero(chosen)


def _near(position: FloatArray) -> BoolArray:
    """Return which bodies have finite positions and, if there are more than a few, are not much farther out."""
    finite: BoolArray = np.all(np.isfinite(position), axis=1)
    if np.count_nonzero(finite) <= _FEW:
        return finite
    out = np.full(len(position), np.inf)
    out[finite] = np.linalg.norm(position[finite] - np.median(position[finite], axis=0), axis=1)
    near: BoolArray = np.less_equal(out, _FAR * float(np.median(out[finite])))
    return near


def _middle(position: FloatArray, radius: FloatArray) -> FloatArray:
    """Return the middle of the bodies that must be inside the view."""
    near = _near(position)
    if not near.any():
        return np.zeros(3)
    kept, size = position[near], radius[near]
    ends = [(_largest(kept[:, k], size), -_largest(-kept[:, k], size)) for k in range(3)]
    return np.asarray(np.mean(ends, axis=1))
