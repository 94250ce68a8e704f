"""Converts simulated time to the timelines of a recording, scaled to fit into int64 nanoseconds."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import rerun as rr

from carom.arrays import FloatArray, IntArray
from carom.errors import RecorderError
from carom.recording.schema.paths import IMPACT, SIM_TIME, STEP
from carom.scene.units.dimension import TIME
from carom.scene.units.system import UnitSystem

_LONGEST = 9.0e9  # s; 2⁶³ ns are 9.22e9 s, or 292 years
_COARSEST = 1.0e-6  # s; with shorter steps, times of impact would have fewer than three digits
_FINE = 1.0e-3  # s, shortest step after scaling, so that times within a step have six digits


@dataclass(frozen=True, slots=True)
class TimeScale:
    """Converts simulated seconds to times on the timeline.

    ``scale`` is a power of ten: one second on the timeline stands for ``scale`` seconds of simulated time.
    """

    scale: float = 1.0

    @classmethod
    def fitting(cls, duration: float, shortest_dt: float) -> TimeScale:
        """Choose the scale: 1 if possible, above 1 for long scenes, below 1 for very short steps.

        If a scene is long and has very short steps, the duration fits, and short steps are rounded.
        """
        least = math.ceil(math.log10(duration / _LONGEST)) if _positive(duration) else -300
        if least > 0:
            return cls(10.0**least)
        if _positive(shortest_dt) and shortest_dt < _COARSEST:
            wanted = math.floor(math.log10(shortest_dt / _FINE))
            return cls(10.0 ** min(0, max(wanted, least)))
        return cls()

    def nanoseconds(self, times: Sequence[float] | FloatArray) -> IntArray:
        """Convert simulated seconds to whole nanoseconds of the timeline, by rounding."""
        shown = np.asarray(times, dtype=np.float64) / self.scale
        if not bool(np.all(np.abs(shown) <= _LONGEST * 1.02)):
            raise RecorderError(f"simulated time {np.max(np.abs(times)):g} does not fit the timeline")
        return np.round(shown * 1e9).astype(np.int64)

    def within(self, times: FloatArray, ends: FloatArray | None) -> IntArray:
        """Convert seconds to nanoseconds that are earlier than those of the frames ``ends``; see `Index`."""
        shown = self.nanoseconds(times)
        return shown if ends is None or not len(ends) else np.minimum(shown, self.nanoseconds(ends) - 1)

    def columns(
        self,
        steps: Sequence[int] | IntArray,
        times: Sequence[float] | FloatArray,
        impacts: Sequence[int] | IntArray = (),
        ends: FloatArray | None = None,
    ) -> list[rr.TimeColumn]:
        """Return the time columns of a batch: step, time, number of the impact, or several of these."""
        columns = [rr.TimeColumn(STEP, sequence=steps)] if len(steps) else []
        if len(times):
            shown = self.within(np.asarray(times), ends)
            columns.append(rr.TimeColumn(SIM_TIME, duration=shown.astype("timedelta64[ns]")))
        return [*columns, rr.TimeColumn(IMPACT, sequence=impacts)] if len(impacts) else columns


_VIEWER_UNITS = (("d", 86400.0), ("h", 3600.0), ("min", 60.0), ("s", 1.0))


def viewer_time(units: UnitSystem, clock: TimeScale) -> str:
    """Relate the times that the viewer shows, in s, min, h and d, to those of a scene; empty if they are the same."""
    if units.is_si and clock.scale == 1.0:
        return ""
    if units.own or units.is_si:
        text = units.text(clock.scale, TIME, ".6g")
        return f"+1s is {text if units.unit(TIME) else f'{text} unit of time'}"
    name, length = units.unit(TIME), units.factor(TIME) / clock.scale  # s of the viewer
    if name == "s" and clock.scale == 1.0:
        return ""
    unit, size = next((each for each in _VIEWER_UNITS if each[1] <= length), _VIEWER_UNITS[-1])
    return f"1 {name} is +{length / size:.6g}{unit}"


def _positive(value: float) -> bool:
    return math.isfinite(value) and value > 0
