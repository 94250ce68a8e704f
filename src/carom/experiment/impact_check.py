"""Compares the impacts of a replay with those recorded, bit for bit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from carom.experiment.mismatch import Mismatch, different, same
from carom.physics.frame import Frame
from carom.recording.read.impacts import impacts_until
from carom.recording.read.recording import Recording
from carom.recording.read.rows import RecordedRows, chunk_of
from carom.recording.schema import paths
from carom.recording.schema.clock import Clock
from carom.recording.schema.header import Header
from carom.recording.schema.timelines import IMPACT, SIM_TIME, STEP
from carom.recording.write.impact_rows import impact_rows

LEFT_OUT = "impacts that the recording leaves out"

IntArray = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class _Recorded:
    """The impacts of a recording by their numbers."""

    number: IntArray  # (k,), rising
    rows: pa.Table

    @classmethod
    def of(cls, recording: Recording) -> _Recorded:
        found = [e for e in recording.store.entries if e.entity_path == paths.IMPACTS and e.first_step is not None]
        batches = [chunk.batch for chunk in recording.chunks(found)]
        if not batches:
            return cls(np.empty(0, dtype=np.int64), pa.table({STEP: pa.array([], pa.int64())}))
        table = pa.Table.from_batches(batches).combine_chunks()
        return cls(np.array(table[IMPACT].to_numpy()), table)


class ImpactCheck:
    """Compares impacts between one recorded frame and the next.

    Parameters
    ----------
    recording
        What was recorded.
    header
        Of the replayed space.
    rows
        The rows of the recording.
    """

    def __init__(self, recording: Recording, header: Header, rows: RecordedRows) -> None:
        self._recorded = _Recorded.of(recording)
        self._rows, self._header = rows, header
        self._clock = Clock(float(recording.info["time_scale"]))
        self._origin = recording.origin
        self._references = {name: float(value) for name, value in recording.arrow_references.items()}
        steps = recording.fingerprints()[STEP]
        told = impacts_until(recording, int(steps[-1].as_py())) if recording.frames else None
        self.leaves_out = told is not None and told.left_out > 0
        self._all_of_them = not self.leaves_out and not recording.clip
        self._since: list[NDArray[np.void]] = []
        self._missed = 0  # that the replay left out itself
        self._count: int | None = None  # at the recorded frame before

    def gather(self, frame: Frame) -> None:
        """Take the impacts that led to a frame, recorded or not."""
        if frame.impacts is not None and len(frame.impacts):
            self._since.append(frame.impacts)
        self._missed += frame.impacts_left_out

    def see(self, step: int) -> Mismatch | None:
        """Compare the impacts gathered up to a recorded frame."""
        since, missed, before = self._since, self._missed, self._count
        self._since, self._missed = [], 0
        self._count = self._count_at(step)
        if self._count is None or missed:
            return None
        found = sum(map(len, since))
        if before is not None and self._count - before != found:
            return Mismatch(step, "impacts since the frame before", self._count - before, found)
        return self._compare(step, np.concatenate(since), self._count) if found else None

    def _compare(self, step: int, impacts: NDArray[np.void], count: int) -> Mismatch | None:
        numbers = np.arange(count - len(impacts) + 1, count + 1)
        place = np.searchsorted(self._recorded.number, numbers)
        there = place < len(self._recorded.number)
        there[there] = self._recorded.number[place[there]] == numbers[there]
        if self._all_of_them and not there.all():
            return Mismatch(step, f"rows of /{paths.IMPACTS}", int(np.count_nonzero(there)), len(impacts))
        if not there.any():
            return None
        replayed = chunk_of(
            impact_rows(impacts[there], numbers[there], self._references, self._header.radius, self._origin),
            self._clock,
        )
        recorded = self._recorded.rows.take(pa.array(place[there])).combine_chunks()
        for name in (STEP, SIM_TIME, *replayed.components):
            if name not in recorded.column_names:
                return Mismatch(step, f"{name} of /{paths.IMPACTS}", "nothing", "values")
            one, other = (_whole(rows[name]) for rows in (recorded, replayed.batch))
            if not same(one, other):
                return _first_that_differs(replayed.batch[STEP].to_numpy(), name, one, other)
        return None

    def _count_at(self, step: int) -> int | None:
        """Return how many impacts the recording has counted up to a frame; None if it does not say."""
        for chunk in self._rows.at(paths.CONTACTS, step):
            if "impact_count" in chunk.components:
                return int(chunk.batch["impact_count"][0].as_py()[0])
        return None


def _whole(column: pa.Array | pa.ChunkedArray) -> pa.Array:
    whole = column.combine_chunks() if isinstance(column, pa.ChunkedArray) else column
    return whole.cast(pa.int64()) if pa.types.is_duration(whole.type) else whole


def _first_that_differs(steps: IntArray, name: str, recorded: pa.Array, replayed: pa.Array) -> Mismatch | None:
    for row, step in enumerate(steps.tolist()):
        found = different(step, paths.IMPACTS, name, recorded.slice(row, 1), replayed.slice(row, 1))
        if found:
            return found
    return None
