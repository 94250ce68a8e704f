"""The first impact at which two recordings part."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from carom.lab.diff.frame_alignment import SAME_TIME
from carom.recording.read.impacts import count_at, impacts_by_number
from carom.recording.read.recording import Recording
from carom.recording.schema.paths import STEP

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

MOST_SKIPPED = 1000  # impacts of two bodies by which one run may have more than the other and still be matched
_VALUES = ("nx", "ny", "nz", "approach_speed", "normal_impulse", "tangential_impulse", "energy_lost")


@dataclass(frozen=True, slots=True)
class Impact:
    """One recorded impact."""

    number: int  # in its own run, from 1 on
    bodies: tuple[int, int]  # from n on planes and walls
    time: float  # s
    approach_speed: float  # m/s
    normal_impulse: float  # N s
    mode: str


@dataclass(frozen=True, slots=True)
class ImpactPair:
    """One impact in both recordings; None in one of them if only the other has it."""

    a: Impact | None
    b: Impact | None

    @property
    def time(self) -> float:
        """When it happened first, in s."""
        return min(impact.time for impact in (self.a, self.b) if impact is not None)


@dataclass(frozen=True, slots=True)
class ImpactDivergence:
    """The impacts of two recordings, compared one by one.

    The impacts of the same two bodies are matched in their order; where one run has more of them, so that the times are
    nearest.
    """

    counts: tuple[int, int] | None  # up to the last frame at a common time; None if there is no such frame
    compared: int  # impacts that both recorded
    first: ImpactPair | None  # the first of them that is not the same
    alone: ImpactPair | None  # the first that only one run has, while the recording of the other has all of its own

    @property
    def same(self) -> bool:
        """Whether no difference was found."""
        return self.first is None and self.alone is None and (self.counts is None or self.counts[0] == self.counts[1])


def impact_divergence(a: Recording, b: Recording) -> ImpactDivergence | None:
    """Compare the impacts that both recorded; None if one has none recorded.

    Raises
    ------
    RecordingError
        If impacts cannot be read.
    """
    if not (a.records_contacts and b.records_contacts):
        return None
    numbers = impacts_by_number(a)[0], impacts_by_number(b)[0]
    tables = a.impacts(), b.impacts()
    ends = tuple(np.stack((table["i"].to_numpy(), table["j"].to_numpy()), axis=1) for table in tables)
    times = tuple(table["time"].to_numpy() for table in tables)
    rows = _matched(ends, times)
    common = [table.take(pa.array(row)) for table, row in zip(tables, rows, strict=True)]
    differs = _times_differ(a, b, *(table["time"].to_numpy() for table in common))
    differs |= np.array(common[0]["mode"].to_pylist(), object) != np.array(common[1]["mode"].to_pylist(), object)
    for name in _VALUES:
        in_a, in_b = (table[name].to_numpy() for table in common)
        differs |= (in_a != in_b) & ~(np.isnan(in_a) & np.isnan(in_b))
    first = None
    if differs.any():
        found = np.flatnonzero(differs)
        k = found[np.argmin(np.minimum(*(time[row[found]] for time, row in zip(times, rows, strict=True))))]
        first = ImpactPair(*(_impact(t, n, int(r[k])) for t, n, r in zip(tables, numbers, rows, strict=True)))
    return ImpactDivergence(_counts(a, b), len(rows[0]), first, _alone((a, b), tables, numbers, times, rows))


def _matched(ends: tuple[IntArray, ...], times: tuple[FloatArray, ...]) -> tuple[IntArray, IntArray]:
    """Return the rows of matched impacts in both runs, in the order of time in the first."""
    found: tuple[list[IntArray], list[IntArray]] = ([], [])
    groups = [_rows_by_ends(each) for each in ends]
    for key in groups[0].keys() & groups[1].keys():
        rows = groups[0][key], groups[1][key]
        short, long = sorted(rows, key=len)
        chosen = long[_nearest_in_order(*(times[0 if each is rows[0] else 1][each] for each in (short, long)))]
        one, other = (short, chosen) if short is rows[0] else (chosen, short)
        found[0].append(one)
        found[1].append(other)
    if not found[0]:
        return np.empty(0, np.int64), np.empty(0, np.int64)
    one, other = np.concatenate(found[0]), np.concatenate(found[1])
    order = np.argsort(one, kind="stable")
    return one[order], other[order]


def _rows_by_ends(ends: IntArray) -> dict[tuple[int, int], IntArray]:
    """Return the rows of the impacts of each two ends, rising."""
    if not len(ends):
        return {}
    keys, inverse = np.unique(ends, axis=0, return_inverse=True)
    inverse = inverse.ravel()
    order = np.argsort(inverse, kind="stable")
    rows = np.split(order, np.flatnonzero(np.diff(inverse[order])) + 1)
    return {(int(i), int(j)): each for (i, j), each in zip(keys, rows, strict=True)}


def _nearest_in_order(short: FloatArray, long: FloatArray) -> IntArray:
    """Choose as many of the longer list of times as the shorter has, in order, with the least sum of differences.

    Dynamic programming over how many of the longer are skipped so far. Beyond `MOST_SKIPPED`, the last are left out.
    """
    skips = min(len(long) - len(short), MOST_SKIPPED)
    if skips == 0:
        return np.arange(len(short))
    cost, taken = np.zeros(skips + 1), np.empty((len(short), skips + 1), np.int64)
    for k, time in enumerate(short):
        best = np.minimum.accumulate(cost)  # to have skipped no more than so many before
        first = np.maximum.accumulate(np.where(cost == best, np.arange(skips + 1), 0))
        taken[k] = first
        cost = best + np.abs(long[k : k + skips + 1] - time)
    skipped = int(np.argmin(cost))
    chosen = np.empty(len(short), np.int64)
    for k in range(len(short) - 1, -1, -1):
        chosen[k] = k + skipped
        skipped = int(taken[k, skipped])
    return chosen


def _alone(
    recordings: tuple[Recording, Recording],
    tables: tuple[pa.Table, ...],
    numbers: tuple[IntArray, ...],
    times: tuple[FloatArray, ...],
    rows: tuple[IntArray, IntArray],
) -> ImpactPair | None:
    """Return the first impact that only one run has, in the time that both show; None if there is none for certain."""
    spans = [recording.fingerprints()["time"].to_numpy() for recording in recordings]
    begin, end = max(span[0] for span in spans), min(span[-1] for span in spans)
    found: list[ImpactPair] = []
    for own, other in ((0, 1), (1, 0)):
        if int(tables[other].schema.metadata[b"left_out"]):
            continue  # it may have happened, and not been recorded
        inside = (times[own] > begin) & (times[own] <= end)
        inside[rows[own]] = False
        if inside.any():
            impact = _impact(tables[own], numbers[own], int(np.argmax(inside)))
            found.append(ImpactPair(impact, None) if own == 0 else ImpactPair(None, impact))
    return min(found, key=lambda pair: pair.time, default=None)


def _times_differ(
    a: Recording, b: Recording, one: NDArray[np.float64], other: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Compare times, which are recorded in whole units: nanoseconds, scaled."""
    units = [1e-9 * float(recording.info["time_scale"]) for recording in (a, b)]
    rounding = 0.0 if units[0] == units[1] else max(units)
    return np.asarray(np.abs(one - other) > rounding)


def _counts(a: Recording, b: Recording) -> tuple[int, int] | None:
    """Count all impacts, recorded or not, up to the last frame of one that ends where a frame of the other does."""
    frames = [recording.fingerprints() for recording in (a, b)]
    times = [table["time"].to_numpy() for table in frames]
    end = min(time[-1] for time in times) * (1.0 + SAME_TIME)
    rows = [int(np.searchsorted(time, end, side="right")) - 1 for time in times]
    if min(rows) < 0 or abs(times[0][rows[0]] - times[1][rows[1]]) > SAME_TIME * abs(end):
        return None
    counts = [count_at(r, int(f[STEP][row].as_py())) for r, f, row in zip((a, b), frames, rows, strict=True)]
    return counts[0], counts[1]


def _impact(table: pa.Table, numbers: IntArray, row: int) -> Impact:
    (values,) = table.slice(row, 1).to_pylist()
    return Impact(
        int(numbers[row]),
        (values["i"], values["j"]),
        values["time"],
        values["approach_speed"],
        values["normal_impulse"],
        values["mode"],
    )
