"""`FrameAlignment`: the common frames of two recordings, and the distances of the bodies in each."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from carom.errors import RecordingError
from carom.lab.diff.divergence import Curve
from carom.physics.periodic_box import minimum_images
from carom.recording.read.frame_rows import RecordedPositions
from carom.recording.read.recording import Recording

FloatArray = NDArray[np.float64]

SAME_TIME = 1e-12  # relative; times are sums of dt, whose round-off is of this order after thousands of steps
_GAPS_AT_THE_END = 2.0  # times the largest gap between common frames: one run may be recorded at two intervals
_UNSEEN = 2.0  # largest acceleration between frames over that which three of them show
_SINGLE = float(np.finfo(np.float32).eps)


class FrameAlignment:
    """Frames matched by step if steps of the same number are at the same times up to the end, otherwise by time.

    By time, the second one is interpolated linearly between its frames where it has none at the same time.

    Raises
    ------
    RecordingError
        If they have no frame in common, or do not show the same bodies.
    """

    def __init__(self, a: Recording, b: Recording) -> None:
        for recording in (a, b):
            recording.require_frames()
        if list(a.shown) != list(b.shown):
            raise RecordingError(f"{a.path} and {b.path} do not show the same bodies: they cannot be compared")
        self._a, self._b = _Frames(a), _Frames(b)
        self._of_bits = bool(a.engine) == bool(b.engine)
        box = a.info.get("box")
        self._box = None if box is None else np.asarray(box, dtype=np.float64)
        _, first, second = np.intersect1d(self._a.step, self._b.step, return_indices=True)
        self.by = "step"
        same = np.allclose(self._a.time[first], self._b.time[second], rtol=SAME_TIME, atol=0.0)
        if not (same and self._reaches_the_end(first)):
            self.by = "sim_time"
            first = np.flatnonzero((self._a.time >= self._b.time[0]) & (self._a.time <= self._b.time[-1]))
            second = np.searchsorted(self._b.time, self._a.time[first] * (1.0 - SAME_TIME))
        if len(first) == 0:
            raise RecordingError(f"{a.path} and {b.path} have no frame in common")
        self._first, self._second = first, second

    def _reaches_the_end(self, common: NDArray[np.int64]) -> bool:
        """Tell whether frames of the first recording go on to the last time that both have.

        Runs with other steps may have the same number at the start only, or by chance.
        """
        if len(common) == 0:
            return False
        times, end = self._a.time[common], min(self._a.time[-1], self._b.time[-1])
        return bool(end - times[-1] <= _GAPS_AT_THE_END * np.diff(times).max(initial=0.0))

    def __len__(self) -> int:
        return len(self._first)

    def at(self, k: int) -> tuple[FloatArray, FloatArray, float]:
        """Return the positions in both (m), and the smallest rms difference that rounding cannot explain (m)."""
        i, j, part = self._place(k)
        if part == 1.0:
            exact = self._a.positions.exact(self._a.step[i]), self._b.positions.exact(self._b.step[j])
            if exact[0] is not None and exact[1] is not None:
                return exact[0], self._near(exact[0], exact[1]), 0.0
        one, other = self._a.positions.drawn(self._a.step[i]), self._b.positions.drawn(self._b.step[j])
        rounding = _rounding(one - self._a.origin) + _rounding(other - self._b.origin)
        if part < 1.0:
            earlier = self._near(other, self._b.positions.drawn(self._b.step[j - 1]))
            rounding += 4.0 * part * (1.0 - part) * self._bend(j, earlier, other)
            other = earlier + part * (other - earlier)
        return one, self._near(one, other), rounding

    def curve(self) -> Curve:
        """Measure the difference in every frame."""
        rms, floor, reach = np.zeros(len(self)), np.zeros(len(self)), 0.0
        for k in range(len(self)):
            one, other, floor[k] = self.at(k)
            rms[k] = _rms(other - one)
            reach = max(reach, float(np.max(np.abs(one), initial=0.0)))
        first = self._a.positions.drawn(self._a.step[self._first[0]])
        return Curve(
            step=np.array([self._a.step[i] for i in self._first]),
            time=self._a.time[self._first],
            rms=rms,
            floor=floor,
            energy=np.array([self._energy(k) for k in range(len(self))]),
            differs=np.array([self._differs(k) for k in range(len(self))]) if self._of_bits else rms > floor,
            size=max(_rms(first - first.mean(axis=0)), self._a.radius),
            reach=reach,
            of_bits=self._of_bits,
        )

    def _place(self, k: int) -> tuple[int, int, float]:
        """Return the frame of the first recording, that of the second, and the fraction of the way to the latter."""
        i, j = int(self._first[k]), int(self._second[k])
        time, reached = self._a.time[i], self._b.time[j]
        if self.by == "step" or abs(reached - time) <= SAME_TIME * abs(time) or j == 0:
            return i, j, 1.0
        return i, j, float((time - self._b.time[j - 1]) / (reached - self._b.time[j - 1]))

    def _near(self, one: FloatArray, other: FloatArray) -> FloatArray:
        """Return the periodic images of other positions that are nearest to some positions."""
        if self._box is None:
            return other
        apart = other - one
        return other + (minimum_images(apart, self._box) - apart)  # exactly `other` where that is nearest

    def _bend(self, j: int, earlier: FloatArray, later: FloatArray) -> float:
        """Bound the error of linear interpolation at the midpoint: an eighth of the acceleration times h².

        Frames need not be equally spaced. Of the accelerations with the frame before and the one after, twice the
        larger counts, because three frames understate how strongly an orbit bends between them.
        """
        time, largest = self._b.time, 0.0
        h = time[j] - time[j - 1]
        speed = (later - earlier) / h
        for third, near, side in ((j - 2, earlier, -1.0), (j + 1, later, 1.0)):
            if 0 <= third < len(time):
                beyond = self._near(near, self._b.positions.drawn(self._b.step[third]))
                span = abs(time[third] - time[j if third > j else j - 1])
                change = side * (beyond - near) / span - speed
                largest = max(largest, _UNSEEN * 2.0 * _rms(change) / (h + span))
        return largest * h * h / 8.0 if len(time) > 2 else float("inf")

    def _differs(self, k: int) -> bool:
        i, j, part = self._place(k)
        return part < 1.0 or bool(self._a.bits[i] != self._b.bits[j])

    def _energy(self, k: int) -> float:
        i, j, part = self._place(k)
        later = self._b.energy(j)
        other = later if part == 1.0 else (1.0 - part) * self._b.energy(j - 1) + part * later
        return other - self._a.energy(i)


class _Frames:
    """The frames of one recording."""

    def __init__(self, recording: Recording) -> None:
        prints: Any = recording.fingerprints()
        self.step: list[int] = prints["step"].to_pylist()
        self.time: FloatArray = prints["time"].to_numpy()
        self.bits: NDArray[np.uint64] = prints["fingerprint"].to_numpy()
        self.positions = RecordedPositions(recording)
        self.origin = recording.origin
        self.radius = float(np.max(recording.bodies.radius))
        table = recording.energy("total")
        self._energy = dict(zip(table["step"].to_pylist(), table["total"].to_pylist(), strict=True))

    def energy(self, frame: int) -> float:
        """Total energy in J; NaN where that piece of the recording is missing."""
        return float(self._energy.get(self.step[frame], np.nan))


def _rounding(drawn: FloatArray) -> float:
    """Bound the rms rounding of positions in single precision (m); 0 where one is no number."""
    rms = _rms(drawn)
    return 0.5 * _SINGLE * rms if np.isfinite(rms) else 0.0


def _rms(vectors: FloatArray) -> float:
    """Return the rms length; a vector with a NaN counts as infinitely long."""
    with np.errstate(invalid="ignore", over="ignore"):
        rms = float(np.sqrt(np.mean(np.sum(vectors**2, axis=1))))
    return rms if np.isfinite(rms) else float("inf")
