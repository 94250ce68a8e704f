"""`CurveOutline`: the outline of a recorded series, from which plots choose their axes, and legends their places."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from carom.arrays import FloatArray

_SPANS = 512  # number of spans, which resolves the edge of a legend to a few pixels
_CURVE_ROUNDING = 1e-9  # largest relative difference of steps that count as equal, since their times are rounded


class CurveOutline:
    """Lowest and highest value of a series in each of at most `2 * _SPANS` spans of time."""

    def __init__(self) -> None:
        self._time = np.zeros(0)  # (k,) s, start of each span
        self._low = np.zeros(0)  # (k,)
        self._high = np.zeros(0)  # (k,)
        self._between = (np.inf, -np.inf)  # extremes of all values except the first and the last
        self._last = np.zeros(0)  # the last value; empty at first, since the very first value is omitted
        self._begun = False

    @classmethod
    def of(cls, time: FloatArray, value: FloatArray) -> CurveOutline:
        """Return the outline of a whole series."""
        curve = cls()
        curve.see(time, value)
        return curve

    def see(self, time: FloatArray, value: FloatArray) -> None:
        """Add finite values; times (s) are later than all times added before."""
        finite = np.isfinite(value)
        time, value = time[finite], value[finite]
        if len(value):
            later = np.concatenate((self._last, value if self._begun else value[1:]))
            low, high = self._between
            self._between = float(later[:-1].min(initial=low)), float(later[:-1].max(initial=high))
            self._last, self._begun = later[-1:], True
        self._time = np.concatenate((self._time, time))
        self._low, self._high = np.concatenate((self._low, value)), np.concatenate((self._high, value))
        while len(self._time) > 2 * _SPANS:  # the spans are joined in pairs
            pairs = np.arange(0, len(self._time), 2)
            self._time = self._time[pairs]
            self._low = np.minimum.reduceat(self._low, pairs)
            self._high = np.maximum.reduceat(self._high, pairs)

    def insert(self, time: FloatArray, value: FloatArray) -> None:
        """Add values that are finite, at any times (s)."""
        finite = np.isfinite(value)
        place, value = np.searchsorted(self._time, time[finite], side="right"), value[finite]
        self._time = np.insert(self._time, place, time[finite])
        self._low, self._high = np.insert(self._low, place, value), np.insert(self._high, place, value)

    @property
    def largest(self) -> float:
        """The largest absolute value; 0 if there is none."""
        return float(self._sizes().max(initial=0.0))

    @property
    def first(self) -> float:
        """The largest absolute value of the first span; 0 if there is none."""
        return float(self._sizes()[:1].max(initial=0.0))

    @property
    def usual(self) -> float:
        """The median of the largest absolute values of the spans; 0 if there is none."""
        return float(np.median(self._sizes())) if len(self._time) else 0.0

    @property
    def is_flat(self) -> bool:
        """Whether the series is constant between its ends; dt, for example, begins at 0 and ends in a shorter step."""
        low, high = self._between
        return high <= low or high - low <= _CURVE_ROUNDING * max(abs(low), abs(high))

    def over(self, unit: float) -> CurveOutline:
        """Return the outline in another unit, given the size of that unit in the recorded unit."""
        if unit == 1.0:
            return self
        scaled = CurveOutline()
        scaled._time, scaled._low, scaled._high = self._time, self._low / unit, self._high / unit
        scaled._between = self._between[0] / unit, self._between[1] / unit
        scaled._last, scaled._begun = self._last / unit, self._begun
        return scaled

    def times(self) -> tuple[float, float]:
        """Return the times (s) of the first and the last span."""
        return (float(self._time[0]), float(self._time[-1])) if len(self._time) else (np.inf, -np.inf)

    def range(self, start: float = -np.inf, end: float = np.inf) -> tuple[float, float]:
        """Return the lowest and highest value between two times (s); (∞, -∞) if there is none."""
        # a span that starts before the interval may extend into it
        first = max(0, int(np.searchsorted(self._time, start, side="right")) - 1)
        last = int(np.searchsorted(self._time, end, side="right"))
        low, high = self._low[first:last], self._high[first:last]
        return float(low.min(initial=np.inf)), float(high.max(initial=-np.inf))

    def _sizes(self) -> FloatArray:
        """Return the largest absolute value in each span."""
        return np.maximum(np.abs(self._low), np.abs(self._high))


Curves = Mapping[str, CurveOutline]  # by the paths of the series
