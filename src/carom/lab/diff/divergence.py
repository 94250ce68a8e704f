"""The first difference between two runs, its growth, and its cause.

Two runs of a chaotic system that differ by round-off diverge exponentially: ln d = a + λ t. A difference with another
cause, such as a bug or a different scene, exceeds the bound for grown round-off, or grows as a power of time.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carom.arrays import BoolArray, FloatArray, IntArray
from carom.errors import RecordingError
from carom.physics.vector import minimum_images
from carom.recording.read.first_difference import other_bits
from carom.recording.read.frame_rows import RecordedPositions
from carom.recording.read.lookup import frame_of
from carom.recording.read.recorded_contacts import rows_of_engine
from carom.recording.read.recording import Recording
from carom.scene.units.dimension import LENGTH, RATE, TIME
from carom.scene.units.system import SI, UnitSystem

_SATURATED = 0.1  # difference, in sizes of the system, beyond which its growth saturates
_POINTS, _FACTOR = 5, 10.0  # smallest number of frames, and smallest growth, to which a rate is fitted
_ROUNDING = 16 * 2.0**-53  # relative rounding error that the few operations of a step cause in a coordinate
_GRAZING = 1000.0  # ratio of mean free path to radius: a grazing impact multiplies a difference by this factor at once
_SURE = 3.0  # standard errors by which a significant rate exceeds 0
_LARGEST_EXPONENT = 700.0  # exp overflows above 709.78
SAME_TIME = 1e-12  # relative tolerance; times are sums of dt, with this round-off after thousands of steps
# longest time after the last common frame, in largest gaps between common frames; a run may have two frame intervals
_GAPS_AT_THE_END = 2.0
_UNSEEN = 2.0  # factor on the second difference of three frames, for larger accelerations between them
_SINGLE = float(np.finfo(np.float32).eps)
ARRAYS = ("position", "velocity", "orientation", "angular_velocity")


@dataclass(frozen=True, slots=True)
class DistanceCurve:
    """The difference between two recordings in each common frame."""

    step: IntArray  # (k,)
    time: FloatArray  # (k,) s
    rms: FloatArray  # (k,) m, rms distance between counterparts
    floor: FloatArray  # (k,) m, possible rounding of recorded positions
    energy: FloatArray  # (k,) J, energy of the second run minus energy of the first
    differs: BoolArray  # (k,) whether fingerprints differ, or positions if a run has no fingerprints
    size: float  # m, rms distance of the bodies from their centre
    reach: float  # m, the largest coordinate, to which round-off is relative
    of_bits: bool = True  # whether fingerprints were compared, which is not possible for other engines

    @property
    def seen(self) -> BoolArray:
        """Mask of the frames with different bits and a difference beyond rounding, (k,)."""
        return self.differs & (self.rms > self.floor)


@dataclass(frozen=True, slots=True)
class Divergence:
    """A line through ln rms over the growing part of a curve."""

    rate: float  # 1/s, λ
    standard_error: float  # 1/s, standard error if the points were independent
    doubling_time: float  # s
    begin: float  # s, start of the growth
    end: float  # s, end of the growth
    points: int
    factor: float  # factor by which the difference grew in that time
    power: float  # exponent p of the best power law t^p
    is_exponential: bool  # whether the exponential fits better than any power of time


@dataclass(frozen=True, slots=True)
class DiffVerdict:
    """The cause in one word and in one sentence, and the numbers behind it."""

    kind: str  # kind of the divergence: "same", "start", "jump", "chaos", "drift" or "small"
    text: str
    first: int | None  # index of the first frame whose bits differ
    jump: float  # m, difference at that frame; 0 if it is below the resolution
    allowed: float  # m, bound of the difference that round-off can cause


def divergence_of(curve: DistanceCurve) -> Divergence | None:
    """Fit the growing part of a curve: from the first visible difference to the largest difference below saturation."""
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


def verdict(curve: DistanceCurve, divergence: Divergence | None, units: UnitSystem = SI) -> DiffVerdict:
    """Return whether grown round-off explains a difference."""
    if not curve.differs.any():
        alike = "same bits" if curve.of_bits else "no difference within the precision of the recordings"
        return DiffVerdict("same", f"{alike} in all {len(curve.time)} common frames", None, 0.0, 0.0)
    first = int(np.argmax(curve.differs))
    when = f"step {curve.step[first]}, t = {units.text(curve.time[first], TIME)}"
    jump = float(curve.rms[first]) if curve.seen[first] else 0.0
    # upper bound (m) of the growth of round-off since the last identical frame
    before = max(0, first - 1)
    steps = max(1, int(curve.step[first] - curve.step[before]))
    rate = divergence.rate if divergence is not None and divergence.is_exponential else 0.0
    stretched = np.exp(min(rate * (curve.time[first] - curve.time[before]), _LARGEST_EXPONENT))
    allowed = float(_GRAZING * steps * _ROUNDING * curve.reach * stretched)
    if divergence is None:
        how = (
            f"no growth rate; it needs {_POINTS} frames over which it grows tenfold, all below a tenth of the "
            f"system's size ({units.text(_SATURATED * curve.size, LENGTH, '.2g')})"
        )
    elif divergence.is_exponential:
        how = (
            f"it grows as e^(λt), λ = {rate_text(divergence.rate, divergence.standard_error, units)}, and doubles "
            f"every {units.text(divergence.doubling_time, TIME, '.3g')}"
        )
    else:
        how = f"it grows as a power of time, t^{divergence.power:.2g}, not exponentially"
    apart, resolved = units.text(jump, LENGTH, ".2e"), units.text(curve.floor[first], LENGTH, ".0e")
    seen = apart if jump else f"less than the precision of the recording, {resolved}"
    if not jump and not curve.floor[first]:
        seen = "no distance yet, while other numbers of the states differ,"
    if first == 0:
        kind, text = "start", f"different from the first frame on ({when}), by {seen}; {how}"
    elif jump > allowed:
        alike = "with the same bits" if curve.of_bits else "without a difference"
        kind = "jump"
        text = (
            f"a jump, not round-off: at {when}, one frame after the last {alike}, bodies are {apart} "
            f"apart, {jump / allowed:.1e} times what round-off could have grown to; {how}"
        )
    elif divergence is None:
        largest = units.text(float(np.max(curve.rms[first:])), LENGTH, ".1e")
        kind = "small"
        text = f"{kind}: {seen} at {when}, at most {largest} later; {how}; its cause is therefore unknown"
    else:
        kind = "chaos" if divergence.is_exponential else "drift"
        text = f"{kind}: {seen} at {when}; {how}"
    return DiffVerdict(kind, text, first, jump, allowed)


def rate_text(rate: float, error: float, units: UnitSystem) -> str:
    """Write a rate of growth and its error (1/s) in the units of the scene, such as "0.3 ± 0.02 /day"."""
    unit = units.unit(TIME)
    return f"{units.shown(rate, RATE):.3g} ± {units.shown(error, RATE):.1g}{f' /{unit}' if unit else ''}"


def _line(x: FloatArray, y: FloatArray) -> tuple[float, float, float]:
    """Fit a line by least squares: its slope, the slope's standard error, and the sum of squared residuals."""
    middle = x - x.mean()
    spread = float(middle @ middle)
    slope = float(middle @ y) / spread
    residual = y - y.mean() - slope * middle
    misfit = float(residual @ residual)
    return slope, float(np.sqrt(misfit / (len(x) - 2) / spread)), misfit


# `FrameAlignment`: the common frames of two recordings, and the distances of the bodies in each.


class FrameAlignment:
    """Frames matched by step if equal steps have equal times up to the end, otherwise by time.

    Matching by time interpolates the second recording linearly between its frames. Recordings without a common frame,
    or with different bodies, are refused.
    """

    def __init__(self, a: Recording, b: Recording) -> None:
        for recording in (a, b):
            recording.require_frames()
        shown = list(a.shown), list(b.shown)
        changing = a.lives is not None or b.lives is not None
        if shown[0] != shown[1] and not (changing and a.shows_all and b.shows_all):
            raise RecordingError(f"{a.path} and {b.path} contain different bodies and cannot be compared")
        # the number of bodies that exist in both recordings; None if all bodies always exist
        self._common = min(map(len, shown)) if changing else None
        self._a, self._b = _Frames(a, self._common), _Frames(b, self._common)
        self._of_bits = bool(a.engine) == bool(b.engine)
        self._cell = a.cell
        _, first, second = np.intersect1d(self._a.step, self._b.step, return_indices=True)
        self.by = "step"
        # If steps differ, frames have equal numbers and times only at the start, or by chance.
        times, end = self._a.time[first], min(self._a.time[-1], self._b.time[-1])
        gap = _GAPS_AT_THE_END * np.diff(times).max(initial=0.0)
        same = len(first) > 0 and np.allclose(times, self._b.time[second], rtol=SAME_TIME, atol=0.0)
        if not (same and end - times[-1] <= gap):
            self.by = "sim_time"
            first = np.flatnonzero((self._a.time >= self._b.time[0]) & (self._a.time <= self._b.time[-1]))
            second = np.searchsorted(self._b.time, self._a.time[first] * (1.0 - SAME_TIME))
        if len(first) == 0:
            raise RecordingError(f"{a.path} and {b.path} have no frame in common")
        self._first, self._second = first, second

    def __len__(self) -> int:
        return len(self._first)

    def at(self, k: int) -> tuple[FloatArray, FloatArray, float]:
        """Return both recordings' positions (m), and the largest rms difference (m) that rounding explains.

        If bodies come and go, only the bodies that exist in both frames are included.
        """
        one, other, rounding = self.everywhere(k)
        if self._common is None:
            return one, other, rounding
        both = np.isfinite(one).all(axis=1) & np.isfinite(other).all(axis=1)
        return one[both], other[both], rounding

    def everywhere(self, k: int) -> tuple[FloatArray, FloatArray, float]:
        """Return the result of `at` for all bodies; a body that does not exist has the position NaN."""
        i, j, part = self._place(k)
        if part == 1.0:
            exact = self._a.exact(i), self._b.exact(j)
            if exact[0] is not None and exact[1] is not None:
                return exact[0], self._near(exact[0], exact[1], self._a.time[i]), 0.0
        one, other = self._a.drawn(i), self._b.drawn(j)
        rounding = _rounding(self._existing(one) - self._a.origin) + _rounding(self._existing(other) - self._b.origin)
        if part < 1.0:
            earlier = self._near(other, self._b.drawn(j - 1), self._b.time[j - 1])
            rounding += 4.0 * part * (1.0 - part) * self._bend(j, earlier, other)
            other = earlier + part * (other - earlier)
        return one, self._near(one, other, self._a.time[i]), rounding

    def _existing(self, vectors: FloatArray) -> FloatArray:
        """Leave out the bodies that do not exist, whose vectors are NaN."""
        return vectors if self._common is None else vectors[np.isfinite(vectors).all(axis=1)]

    def curve(self) -> DistanceCurve:
        """Measure the difference in every frame."""
        rms, floor, reach = np.zeros(len(self)), np.zeros(len(self)), 0.0
        for k in range(len(self)):
            one, other, floor[k] = self.at(k)
            rms[k] = _rms(other - one)
            reach = max(reach, float(np.max(np.abs(one), initial=0.0)))
        first, _, _ = self.at(0)
        places = [self._place(k) for k in range(len(self))]
        differs = [part < 1.0 or bool(self._a.bits[i] != self._b.bits[j]) for i, j, part in places]
        return DistanceCurve(
            step=np.array([self._a.step[i] for i in self._first]),
            time=self._a.time[self._first],
            rms=rms,
            floor=floor,
            energy=np.array([self._energy(*place) for place in places]),
            differs=np.array(differs) if self._of_bits else rms > floor,
            size=max(_rms(first - first.mean(axis=0)) if len(first) else 0.0, self._a.radius),
            reach=reach,
            of_bits=self._of_bits,
        )

    def _place(self, k: int) -> tuple[int, int, float]:
        """Return frame i of the first and j of the second recording, and where i lies between j - 1 (0) and j (1)."""
        i, j = int(self._first[k]), int(self._second[k])
        time, reached = self._a.time[i], self._b.time[j]
        if self.by == "step" or abs(reached - time) <= SAME_TIME * abs(time) or j == 0:
            return i, j, 1.0
        return i, j, float((time - self._b.time[j - 1]) / (reached - self._b.time[j - 1]))

    def _near(self, one: FloatArray, other: FloatArray, time: float) -> FloatArray:
        """Return the periodic images of positions ``other`` at a time (s) that are nearest to positions ``one``."""
        cell = self._cell(time)
        if cell is None:
            return other
        apart = other - one
        return other + (minimum_images(apart, cell) - apart)  # gives exactly `other` if that is the nearest image

    def _bend(self, j: int, earlier: FloatArray, later: FloatArray) -> float:
        """Bound the interpolation error at the midpoint by an eighth of the acceleration times h².

        Frames need not be equally spaced. The acceleration is at most twice the larger second difference at both ends:
        the second difference of three frames understates the curvature of an orbit between them.
        """
        time, largest = self._b.time, 0.0
        h = time[j] - time[j - 1]
        speed = (later - earlier) / h
        for third, near, side in ((j - 2, earlier, -1.0), (j + 1, later, 1.0)):
            if 0 <= third < len(time):
                beyond = self._near(near, self._b.drawn(third), self._b.time[third])
                span = abs(time[third] - time[j if third > j else j - 1])
                change = side * (beyond - near) / span - speed
                largest = max(largest, _UNSEEN * 2.0 * _rms(self._existing(change)) / (h + span))
        return largest * h * h / 8.0 if len(time) > 2 else float("inf")

    def _energy(self, i: int, j: int, part: float) -> float:
        later = self._b.energy(j)
        other = later if part == 1.0 else (1.0 - part) * self._b.energy(j - 1) + part * later
        return other - self._a.energy(i)


class _Frames:
    """The frames of one recording, with the first ``count`` bodies; None means all bodies."""

    def __init__(self, recording: Recording, count: int | None) -> None:
        self._count = count
        prints: Any = recording.fingerprints()
        self.step: list[int] = prints["step"].to_pylist()
        self.time: FloatArray = prints["time"].to_numpy()
        self.bits: NDArray[np.uint64] = prints["fingerprint"].to_numpy()
        self.positions = RecordedPositions(recording)
        self.origin = recording.origin
        self.radius = float(np.max(recording.bodies.radius))
        table = recording.energy("total")
        self._energy = dict(zip(table["step"].to_pylist(), table["total"].to_pylist(), strict=True))

    def drawn(self, frame: int) -> FloatArray:
        """Return the drawn positions (m)."""
        return self.positions.drawn(self.step[frame])[: self._count]

    def exact(self, frame: int) -> FloatArray | None:
        """Return the exact positions (m); None without a checkpoint."""
        found = self.positions.exact(self.step[frame])
        return None if found is None else found[: self._count]

    def energy(self, frame: int) -> float:
        """Total energy (J); NaN where it is missing from the recording."""
        return float(self._energy.get(self.step[frame], np.nan))


def _rounding(drawn: FloatArray) -> float:
    """Return a bound of the rms rounding of positions in single precision (m); 0 for positions with NaN."""
    rms = _rms(drawn)
    return 0.5 * _SINGLE * rms if np.isfinite(rms) else 0.0


def _rms(vectors: FloatArray) -> float:
    """Return the rms length of vectors: 0 without vectors, infinite if one has a NaN."""
    if not len(vectors):
        return 0.0
    with np.errstate(invalid="ignore", over="ignore"):
        rms = float(np.sqrt(np.mean(np.sum(vectors**2, axis=1))))
    return rms if np.isfinite(rms) else float("inf")


@dataclass(frozen=True, slots=True)
class FirstContact:
    """A contact of the first bodies that differ."""

    ends: tuple[int, int]  # numbers ≥ n are planes
    forces: tuple[float | None, float | None]  # N, forces along the normal; None if a run lacks this contact
    friction: tuple[float | None, float | None]  # N, magnitudes of friction
    turned: float  # rad, angle between the directions of friction; 0 if a direction is unknown


@dataclass(frozen=True, slots=True)
class FirstBits:
    """The first frame whose exact states differ."""

    step: int
    time: float  # s
    bodies: list[int]  # numbers of the bodies whose states differ
    arrays: list[str]  # names of the arrays that differ
    contact: FirstContact | None  # the contact of these bodies whose force differs most; None if no contact is known
    laws: list[str]  # warnings of either run about broken laws in this step


def first_bits(a: Recording, b: Recording, step: int) -> FirstBits | None:
    """Compare the exact states of a step; None if a recording lacks them, or if they are equal."""
    if step not in a.checkpoint_times or step not in b.checkpoint_times:
        return None
    one, other = a.checkpoint(step), b.checkpoint(step)
    n = min(len(one.position), len(other.position))  # some bodies may exist in one run only
    differs, arrays = np.zeros(n, dtype=bool), list[str]()
    for name in ARRAYS:
        left, right = getattr(one, name), getattr(other, name)
        if left is None or right is None:
            continue
        changed = other_bits(left[:n], right[:n]).any(axis=1)
        differs |= changed
        arrays += [name.replace("_", " ")] if changed.any() else []
    if not arrays:
        return None
    bodies = np.flatnonzero(differs).tolist()
    laws = dict.fromkeys(event.text for run in (a, b) for event in run.warnings() if event.step == step)
    return FirstBits(step, one.time, bodies, arrays, _first_contact(a, b, one.time, bodies), list(laws))


def _first_contact(a: Recording, b: Recording, time: float, bodies: list[int]) -> FirstContact | None:
    """Return the contact of the given bodies whose force differs most."""
    if not (a.records_contacts and b.records_contacts):
        return None
    try:
        forces = _forces(a, time), _forces(b, time)
    except RecordingError:  # another version of carom made the run
        return None
    own = [ends for ends in forces[0].keys() | forces[1].keys() if not set(ends).isdisjoint(bodies)]
    if not own:
        return None
    alike = forces if bool(a.engine) == bool(b.engine) else tuple(map(_sizes, forces))
    none = np.zeros(4)
    most = max(own, key=lambda ends: (_size(alike[0].get(ends, none) - alike[1].get(ends, none)), ends))
    one, other = (each.get(most) for each in alike)
    turned = 0.0
    if one is not None and other is not None and one[1:].any() and other[1:].any():
        cosine = float(one[1:] @ other[1:]) / (_size(one[1:]) * _size(other[1:]))
        turned = float(np.arccos(np.clip(cosine, -1.0, 1.0)))
    normal = [None if each is None else float(each[0]) for each in (one, other)]
    friction = [None if each is None else _size(each[1:]) for each in (one, other)]
    return FirstContact(most, (normal[0], normal[1]), (friction[0], friction[1]), turned)


def _forces(run: Recording, time: float) -> dict[tuple[int, int], FloatArray]:
    """Return normal force and friction vector of each contact, (4,) N; carom's runs have only friction's magnitude."""
    row = frame_of(run, time) if run.engine else None
    if row is None:
        rows = run.contacts(time).to_pylist()
        return {
            (row["i"], row["j"]): np.array([row["normal_force"] or 0.0, row["tangential_force"] or 0.0, 0.0, 0.0])
            for row in rows
        }
    contacts, dt = rows_of_engine(run, row)
    names = ("normal_impulse", "friction_x", "friction_y", "friction_z")
    values = np.stack([contacts[name] for name in names], axis=1) / (dt or 1.0)
    return dict(zip(zip(contacts["i"].tolist(), contacts["j"].tolist(), strict=True), values, strict=True))


def _sizes(forces: dict[tuple[int, int], FloatArray]) -> dict[tuple[int, int], FloatArray]:
    return {ends: np.array([each[0], _size(each[1:]), 0.0, 0.0]) for ends, each in forces.items()}


def _size(vector: FloatArray) -> float:
    return float(np.linalg.norm(vector))
