"""The outline of a recorded series: of constant size, and sufficient to lay out a plot."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

_SPANS = 512  # the edge of a legend is then known to a few pixels
_ROUNDING = 1e-9  # relative difference of equal steps, whose times are rounded


class Curve:
    """Lowest and highest value of a series in each of at most `2 * _SPANS` spans of time."""

    def __init__(self) -> None:
        self._time = np.zeros(0)  # (k,) s, start of each span
        self._low = np.zeros(0)  # (k,)
        self._high = np.zeros(0)  # (k,)
        self._between = (np.inf, -np.inf)  # lowest and highest value without the first and the last
        self._last = np.zeros(0)  # the last value; empty up to the first value, which is left out
        self._begun = False

    @classmethod
    def of(cls, time: FloatArray, value: FloatArray) -> Curve:
        """Return the outline of a whole series."""
        curve = cls()
        curve.see(time, value)
        return curve

    def see(self, time: FloatArray, value: FloatArray) -> None:
        """Add values that are finite; times (s) follow those added before."""
        finite = np.isfinite(value)
        time, value = time[finite], value[finite]
        self._see_between(value)
        self._time = np.concatenate((self._time, time))
        self._low, self._high = np.concatenate((self._low, value)), np.concatenate((self._high, value))
        while len(self._time) > 2 * _SPANS:
            self._merge()

    def insert(self, time: FloatArray, value: FloatArray) -> None:
        """Add values that are finite, at any times (s)."""
        finite = np.isfinite(value)
        place, value = np.searchsorted(self._time, time[finite], side="right"), value[finite]
        self._time = np.insert(self._time, place, time[finite])
        self._low, self._high = np.insert(self._low, place, value), np.insert(self._high, place, value)

    def _see_between(self, value: FloatArray) -> None:
        if len(value):
            later = np.concatenate((self._last, value if self._begun else value[1:]))
            low, high = self._between
            self._between = float(later[:-1].min(initial=low)), float(later[:-1].max(initial=high))
            self._last, self._begun = later[-1:], True

    @property
    def largest(self) -> float:
        """The largest absolute value; 0 if there is none."""
        return max(float(np.abs(self._low).max(initial=0.0)), float(np.abs(self._high).max(initial=0.0)))

    @property
    def is_flat(self) -> bool:
        """Whether it is constant without its first and last value: dt begins at 0, and the last step is shortened."""
        low, high = self._between
        return high <= low or high - low <= _ROUNDING * max(abs(low), abs(high))

    def times(self) -> tuple[float, float]:
        """Return the time (s) of the first span and of the last."""
        return (float(self._time[0]), float(self._time[-1])) if len(self._time) else (np.inf, -np.inf)

    def range(self, start: float = -np.inf, end: float = np.inf) -> tuple[float, float]:
        """Return the lowest and highest value between two times (s); (∞, -∞) if there is none."""
        # a span that begins before the interval may reach into it
        first = max(0, int(np.searchsorted(self._time, start, side="right")) - 1)
        last = int(np.searchsorted(self._time, end, side="right"))
        return (
            float(self._low[first:last].min(initial=np.inf)),
            float(self._high[first:last].max(initial=-np.inf)),
        )

    def _merge(self) -> None:
        """Join the spans in pairs."""
        pairs = np.arange(0, len(self._time), 2)
        self._time = self._time[pairs]
        self._low = np.minimum.reduceat(self._low, pairs)
        self._high = np.maximum.reduceat(self._high, pairs)
