"""The growth of a difference between two runs, and its cause.

Two runs of a chaotic system that differ by round-off diverge exponentially: ln d = a + λ t. A difference with another
cause, a bug or a different scene, is larger than round-off can have grown to by then, or grows as a power of time.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carom.scene.units.dimension import LENGTH, RATE, TIME
from carom.scene.units.system import SI, UnitSystem

FloatArray = NDArray[np.float64]

_SATURATED = 0.1  # of the size of the system; a larger difference cannot grow freely
_POINTS, _FACTOR = 5, 10.0  # least number of frames, and least growth, to which a rate is fitted
_ROUNDING = 16 * 2.0**-53  # of a coordinate, for the few operations on it in a step
_GRAZING = 1000.0  # a grazing impact stretches a difference by mean free path over radius at once
_SURE = 3.0  # standard errors by which a rate must differ from 0


@dataclass(frozen=True, slots=True)
class Curve:
    """The difference frame by frame."""

    step: NDArray[np.int64]  # (k,)
    time: FloatArray  # (k,) s
    rms: FloatArray  # (k,) m, of the distances between counterparts
    floor: FloatArray  # (k,) m; a smaller difference may be the rounding of recorded positions
    energy: FloatArray  # (k,) J, second minus first
    differs: NDArray[np.bool_]  # (k,) whether the fingerprints differ, or else the positions
    size: float  # m, rms distance of the bodies from their centre
    reach: float  # m, the largest coordinate, to which round-off is relative
    of_bits: bool = True  # whether fingerprints were compared; of another engine those have other columns

    @property
    def seen(self) -> NDArray[np.bool_]:
        """Which frames show a difference: other bits, and more than rounding explains, (k,)."""
        return self.differs & (self.rms > self.floor)


@dataclass(frozen=True, slots=True)
class Divergence:
    """A line through ln rms over the growing part of a curve."""

    rate: float  # 1/s, λ
    standard_error: float  # 1/s, as if the points were independent
    doubling_time: float  # s
    begin: float  # s
    end: float  # s
    points: int
    factor: float  # by which the difference grew meanwhile
    power: float  # p of the best t^p
    is_exponential: bool  # the line fits better than any power of time


@dataclass(frozen=True, slots=True)
class Verdict:
    """The cause in one word, in one sentence, and the numbers behind it."""

    kind: str  # "same", "start", "jump", "chaos", "drift" or "small"
    text: str
    first: int | None  # the frame (index) at which the bits differ first
    jump: float  # m, difference at that frame; 0 if it cannot be seen
    allowed: float  # m, largest difference that round-off could have caused


def divergence_of(curve: Curve) -> Divergence | None:
    """Fit the growing part of a curve: from the first visible difference to the largest below saturation."""
    seen = np.flatnonzero(curve.seen & np.isfinite(curve.rms))
    if len(seen) == 0:
        return None
    saturated = np.flatnonzero(curve.rms >= _SATURATED * curve.size)
    after = saturated[saturated >= seen[0]]
    seen = seen[seen <= (after[0] if len(after) else seen[-1])]
    seen = seen[: int(np.argmax(curve.rms[seen])) + 1]
    time, rms = curve.time[seen], curve.rms[seen]
    if len(seen) < _POINTS or rms[-1] < _FACTOR * rms[0] or not time[-1] > time[0]:
        return None
    rate, error, misfit = _line(time, np.log(rms))
    onset = curve.time[max(0, int(np.argmax(curve.differs)) - 1)]
    since = time - min(onset, time[0] - (time[1] - time[0]))
    power, _, misfit_of_power = _line(np.log(since), np.log(rms))
    doubling = float(np.log(2.0) / rate) if rate > 0 else float("inf")
    exponential = misfit <= misfit_of_power and rate > _SURE * error
    return Divergence(
        rate, error, doubling, float(time[0]), float(time[-1]), len(seen), float(rms[-1] / rms[0]), power, exponential
    )


def verdict(curve: Curve, divergence: Divergence | None, units: UnitSystem = SI) -> Verdict:
    """Decide whether a difference is grown round-off or a bug."""
    if not curve.differs.any():
        alike = "same bits" if curve.of_bits else "no difference that the recordings resolve"
        return Verdict("same", f"{alike} in all {len(curve.time)} frames that both have", None, 0.0, 0.0)
    first = int(np.argmax(curve.differs))
    when = f"step {curve.step[first]}, t = {units.text(curve.time[first], TIME)}"
    jump = float(curve.rms[first]) if curve.seen[first] else 0.0
    allowed = _allowed(curve, divergence, first)
    how = _grows(curve, divergence, units)
    apart, resolved = units.text(jump, LENGTH, ".2e"), units.text(curve.floor[first], LENGTH, ".0e")
    seen = apart if jump else f"less than the {resolved} that the recording resolves"
    if first == 0:
        return Verdict("start", f"different from the first frame on ({when}), by {seen}; {how}", first, jump, allowed)
    if jump > allowed:
        return Verdict(
            "jump",
            f"a jump, not round-off: at {when}, one frame after the last {_alike(curve)}, bodies are {apart} "
            f"apart, {jump / allowed:.1e} times what round-off could have become; {how}",
            first,
            jump,
            allowed,
        )
    if divergence is None:
        largest = units.text(float(np.max(curve.rms[first:])), LENGTH, ".1e")
        text = f"small: {seen} at {when}, at most {largest} later; {how}; its cause is therefore unknown"
        return Verdict("small", text, first, jump, allowed)
    kind = "chaos" if divergence.is_exponential else "drift"
    return Verdict(kind, f"{kind}: {seen} at {when}; {how}", first, jump, allowed)


def _allowed(curve: Curve, divergence: Divergence | None, first: int) -> float:
    """Bound the size (m) to which round-off can have grown since the last identical frame."""
    before = max(0, first - 1)
    steps = max(1, int(curve.step[first] - curve.step[before]))
    rate = divergence.rate if divergence is not None and divergence.is_exponential else 0.0
    stretched = np.exp(min(rate * (curve.time[first] - curve.time[before]), 700.0))
    return float(_GRAZING * steps * _ROUNDING * curve.reach * stretched)


def _alike(curve: Curve) -> str:
    return "with the same bits" if curve.of_bits else "without a difference"


def rate_text(rate: float, error: float, units: UnitSystem) -> str:
    """Write a rate of growth and its error (1/s) in the units of the scene, such as "0.3 ± 0.02 /day"."""
    unit = units.unit(TIME)
    return f"{units.shown(rate, RATE):.3g} ± {units.shown(error, RATE):.1g}{f' /{unit}' if unit else ''}"


def _grows(curve: Curve, divergence: Divergence | None, units: UnitSystem) -> str:
    if divergence is None:
        return (
            f"no rate of growth: that takes {_POINTS} frames over which it grows tenfold, all below a tenth of the "
            f"system's size ({units.text(_SATURATED * curve.size, LENGTH, '.2g')})"
        )
    if divergence.is_exponential:
        return (
            f"it grows by e^(λt), λ = {rate_text(divergence.rate, divergence.standard_error, units)}, "
            f"twice as much every {units.text(divergence.doubling_time, TIME, '.3g')}"
        )
    return f"it grows like a power of time, t^{divergence.power:.2g}, not exponentially"


def _line(x: FloatArray, y: FloatArray) -> tuple[float, float, float]:
    """Fit a line by least squares: its slope, the slope's standard error, and the sum of squared residuals."""
    middle = x - x.mean()
    spread = float(middle @ middle)
    slope = float(middle @ y) / spread
    residual = y - y.mean() - slope * middle
    misfit = float(residual @ residual)
    return slope, float(np.sqrt(misfit / (len(x) - 2) / spread)), misfit
