"""Where the bodies are, so that the first look at a recording shows them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from carom.physics.frame import Frame

FloatArray = NDArray[np.float64]

_MOST = 95.0  # per cent of the bodies to be seen; the rest may be on their way out
_GROWTH = 2.5  # a view that must hold more than this times the first frame would show it too small


class Extent:
    """A ball around most of the bodies, followed over the recording. Robust: a few that fly off do not count."""

    def __init__(self, radius: FloatArray, origin: FloatArray) -> None:
        self._radius = radius
        self._origin = origin
        self._balls: list[tuple[FloatArray, float]] = []

    def see(self, batch: Sequence[Frame]) -> None:
        """Take the first frame, and the last of every batch, into account."""
        first = [] if self._balls else batch[:1]
        for frame in [*first, batch[-1]]:
            self._balls.append(self._ball(frame.position - self._origin))

    def view(self) -> tuple[FloatArray, float]:
        """Centre and radius (m) of what a view should show: the first frame and, if it can be, all others."""
        centre, size = self._balls[0]
        reach = max(float(np.linalg.norm(c - centre)) + r for c, r in self._balls)
        return centre, min(max(size, reach), _GROWTH * size)

    def _ball(self, position: FloatArray) -> tuple[FloatArray, float]:
        finite = position[np.all(np.isfinite(position), axis=1)]
        if len(finite) == 0:
            return np.zeros(3), float(self._radius.max())
        centre = (np.percentile(finite, 5, axis=0) + np.percentile(finite, 95, axis=0)) / 2
        distance = np.sqrt(np.sum((position - centre) ** 2, axis=1)) + self._radius
        return centre, float(np.percentile(distance[np.isfinite(distance)], _MOST))
