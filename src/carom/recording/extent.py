"""Where the bodies are, so that the first look at a recording shows them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carom.physics.frame import Frame

FloatArray = NDArray[np.float64]

_MOST = 95.0  # per cent of the bodies to be seen; the rest may be on their way out
_GROWTH = 2.5  # a view that held more than this times the first frame would show it too small


@dataclass(frozen=True, slots=True)
class View:
    """What an eye should show: a ball, and whether to follow the bodies, which leave it as a whole."""

    centre: FloatArray  # (3,) m
    size: float  # m
    follows: bool


class Extent:
    """A ball around most of the bodies, followed over the recording. Robust: a few that fly off do not count."""

    def __init__(self, radius: FloatArray, first: FloatArray) -> None:
        self._radius = radius
        self._centre = _middle(first)
        self._first = self._reach(first, self._centre)
        self._drift = 0.0
        self._spread = self._first  # about the centre of each moment
        self._largest = self._first  # about the first centre

    def see(self, batch: Sequence[Frame], origin: FloatArray) -> None:
        """Take the last frame of a batch into account."""
        position = batch[-1].position - origin
        centre = _middle(position)
        self._drift = max(self._drift, float(np.linalg.norm(centre - self._centre)))
        self._spread = max(self._spread, self._reach(position, centre))
        self._largest = max(self._largest, self._reach(position, self._centre))

    def view(self) -> View:
        """Show the first frame and, if that leaves it large enough, all others."""
        follows = self._drift > self._first
        size = self._spread if follows else self._largest
        return View(self._centre, min(size, _GROWTH * self._first), follows)

    def _reach(self, position: FloatArray, centre: FloatArray) -> float:
        distance = np.sqrt(np.sum((position - centre) ** 2, axis=1)) + self._radius
        finite = distance[np.isfinite(distance)]
        if len(finite) == 0:
            return float(self._radius.max())
        return float(np.percentile(finite, _MOST, method="higher"))


def _middle(position: FloatArray) -> FloatArray:
    finite = position[np.all(np.isfinite(position), axis=1)]
    if len(finite) == 0:
        return np.zeros(3)
    low, high = np.percentile(finite, [100 - _MOST, _MOST], axis=0, method="nearest")
    return np.asarray((low + high) / 2)
