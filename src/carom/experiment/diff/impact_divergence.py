"""The first impact at which two recordings part."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from carom.experiment.diff.frame_alignment import SAME_TIME
from carom.recording.read.impacts import count_at, impacts_by_number
from carom.recording.read.recording import Recording
from carom.recording.schema.timelines import STEP

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

_VALUES = ("nx", "ny", "nz", "approach_speed", "normal_impulse", "tangential_impulse", "energy_lost")


@dataclass(frozen=True, slots=True)
class Impact:
    """One recorded impact."""

    bodies: tuple[int, int]  # from n on planes and walls
    time: float  # s
    approach_speed: float  # m/s
    normal_impulse: float  # N s
    mode: str


@dataclass(frozen=True, slots=True)
class ImpactPair:
    """The impact with the same number in both recordings."""

    number: int  # from 1 on
    a: Impact
    b: Impact


@dataclass(frozen=True, slots=True)
class ImpactDivergence:
    """The impacts of two recordings, compared number by number."""

    counts: tuple[int, int] | None  # up to the last frame at a common time; None if there is no such frame
    compared: int  # impacts that both recorded
    first: ImpactPair | None  # the first of them that is not the same
    other_bodies: ImpactPair | None  # the first of them between other bodies

    @property
    def same(self) -> bool:
        """Whether no difference was found."""
        return self.first is None and (self.counts is None or self.counts[0] == self.counts[1])


def impact_divergence(a: Recording, b: Recording) -> ImpactDivergence | None:
    """Compare the impacts that both recorded; None if one has none recorded.

    Raises
    ------
    RecordingError
        If impacts cannot be read.
    """
    if not (a.records_contacts and b.records_contacts):
        return None
    one, other = (impacts_by_number(recording)[0] for recording in (a, b))
    common, rows_a, rows_b = np.intersect1d(one, other, assume_unique=True, return_indices=True)
    tables = a.impacts().take(pa.array(rows_a)), b.impacts().take(pa.array(rows_b))
    between_others = np.zeros(len(common), dtype=bool)
    for name in ("i", "j"):
        between_others |= tables[0][name].to_numpy() != tables[1][name].to_numpy()
    differs = between_others | _times_differ(a, b, *(table["time"].to_numpy() for table in tables))
    differs |= np.array(tables[0]["mode"].to_pylist(), object) != np.array(tables[1]["mode"].to_pylist(), object)
    for name in _VALUES:
        in_a, in_b = (table[name].to_numpy() for table in tables)
        differs |= (in_a != in_b) & ~(np.isnan(in_a) & np.isnan(in_b))
    return ImpactDivergence(
        counts=_counts(a, b),
        compared=len(common),
        first=_first(common, differs, *tables),
        other_bodies=_first(common, between_others, *tables),
    )


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


def _first(numbers: IntArray, chosen: NDArray[np.bool_], a: pa.Table, b: pa.Table) -> ImpactPair | None:
    if not chosen.any():
        return None
    row = int(np.argmax(chosen))
    return ImpactPair(int(numbers[row]), _impact(a, row), _impact(b, row))


def _impact(table: pa.Table, row: int) -> Impact:
    (values,) = table.slice(row, 1).to_pylist()
    return Impact(
        (values["i"], values["j"]), values["time"], values["approach_speed"], values["normal_impulse"], values["mode"]
    )
