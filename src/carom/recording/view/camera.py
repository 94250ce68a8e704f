"""Places the camera so that a recording opens with its bodies in view."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carom.physics.frame import Frame

FloatArray = NDArray[np.float64]

_MOST = 95.0  # per cent of the bodies in view; the others may be escaping
_GROWTH = 2.5  # limit of the distance, in units of that for the first frame: farther away, bodies look too small
_MARGIN = 1.05

_TO_EYE = np.array([0.75, -1.0, 0.55]) / np.linalg.norm([0.75, -1.0, 0.55])  # from the scene; z is up
_RIGHT = np.cross([0.0, 0.0, 1.0], _TO_EYE) / np.linalg.norm(np.cross([0.0, 0.0, 1.0], _TO_EYE))
_UP = np.cross(_TO_EYE, _RIGHT)
_SLOPE = np.tan(np.radians(55.0 / 2))  # Rerun's eye opens 55° from top to bottom
_ASPECT = 1.25  # of the narrower of the two 3D views


@dataclass(frozen=True, slots=True)
class View:
    """Position of the camera, and whether it follows the bodies because they leave its view as a whole."""

    target: FloatArray  # (3,) m
    distance: float  # m, of the eye from the target
    follows: bool

    @property
    def eye(self) -> FloatArray:
        """Place of the eye (m)."""
        return np.asarray(self.target + self.distance * _TO_EYE)


class CameraFit:
    """Fits the camera's distance to most of the bodies; a few that escape do not count."""

    def __init__(self, radius: FloatArray, first: FloatArray) -> None:
        self._radius = radius
        self._centre = _middle(first)
        self._first = self._distance(first, self._centre)
        self._drift = 0.0
        self._moving = self._first  # the eye's distance if it follows the bodies
        self._still = self._first  # … and if it stays

    def see(self, batch: Sequence[Frame], origin: FloatArray) -> None:
        """Take the last frame of a batch into account."""
        self.look(batch[-1].position - origin)

    def look(self, position: FloatArray) -> None:
        """Take positions (n, 3) into account."""
        centre = _middle(position)
        self._drift = max(self._drift, float(np.linalg.norm(centre - self._centre)))
        self._moving = max(self._moving, self._distance(position, centre))
        self._still = max(self._still, self._distance(position, self._centre))

    def view(self) -> View:
        """Return a view of the first frame and, unless bodies would look too small, of all others."""
        follows = self._drift > self._first / 2
        distance = self._moving if follows else self._still
        return View(self._centre, min(distance, _GROWTH * self._first), follows)

    def _distance(self, position: FloatArray, centre: FloatArray) -> float:
        """Return the distance from which most bodies are inside the picture's borders.

        A body at height h over the line of sight and depth d towards the eye is inside if
        h + r ≤ (distance - d) · slope.
        """
        offset = position - centre
        height = np.maximum(np.abs(offset @ _UP), np.abs(offset @ _RIGHT) / _ASPECT) + self._radius
        distance = offset @ _TO_EYE + height / _SLOPE
        finite = distance[np.isfinite(distance)]
        if len(finite) == 0:
            return float(self._radius.max())
        return _MARGIN * float(np.percentile(finite, _MOST, method="higher"))


def _middle(position: FloatArray) -> FloatArray:
    finite = position[np.all(np.isfinite(position), axis=1)]
    if len(finite) == 0:
        return np.zeros(3)
    low, high = np.percentile(finite, [100 - _MOST, _MOST], axis=0, method="nearest")
    return np.asarray((low + high) / 2)
