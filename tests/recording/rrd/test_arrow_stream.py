"""Streams that are refused before memory is allocated for them."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest

import inflated_recordings
from carom.arrow_claims import claims
from carom.errors import DamageError
from carom.recording.rrd.container import Container
from carom.recording.rrd.framing import END
from carom.recording.rrd.messages import record_batch
from edited_recordings import LZ4, assembled, messages_of, stream, with_column

ROWS = 200_000_000


def refused(column: pa.Array, options: pa.ipc.IpcWriteOptions | None = None) -> str:
    payload = stream(pa.record_batch([column], names=["component"]), options)
    with pytest.raises(DamageError) as caught:
        record_batch(memoryview(payload), 0, 0)
    return str(caught.value)


def deep(depth: int) -> pa.Array:
    column = pa.array([1.0])
    for _ in range(depth):
        column = pa.ListArray.from_arrays(pa.array([0, 1], pa.int32()), column)
    return column


@pytest.mark.parametrize(
    "column",
    [
        pytest.param(lambda: pa.nulls(ROWS), id="nulls"),
        pytest.param(
            lambda: pa.RunEndEncodedArray.from_arrays(pa.array([ROWS], pa.int32()), pa.array([1.0])), id="runs"
        ),
        pytest.param(lambda: pa.array([0.0], pa.float64()).dictionary_encode(), id="dictionary"),
        pytest.param(lambda: pa.array(["x"], pa.string_view()), id="view"),
        pytest.param(lambda: pa.array([b"x"], pa.binary()), id="bytes"),
        pytest.param(lambda: pa.array([[1.0] * 17], pa.list_(pa.float64(), 17)), id="wide fixed lists"),
        pytest.param(lambda: deep(20), id="lists in lists"),
    ],
)
def test_a_column_of_a_type_that_carom_never_writes_is_refused(column: Callable[[], pa.Array]) -> None:
    assert "type" in refused(column())


def test_nulls_inside_of_a_list_may_not_be_more_than_its_bytes_can_hold() -> None:
    column = pa.ListArray.from_arrays(pa.array([0, ROWS], pa.int32()), pa.nulls(ROWS))
    assert f"claims {ROWS} values" in refused(column)


def test_buffers_that_are_packed_a_second_time_are_not_unpacked() -> None:
    zeros = pa.array(np.zeros(100_000))
    assert "compressed a second time" in refused(zeros, pa.ipc.IpcWriteOptions(compression="zstd"))


def test_the_claims_of_a_batch_are_read_without_building_it() -> None:
    batch = pa.record_batch([pa.array([[1.0, 2.0], [3.0]]), pa.array([1, 2])], names=["lists", "numbers"])
    reader = pa.ipc.MessageReader.open_stream(stream(batch))
    reader.read_next_message()
    claimed = claims(reader.read_next_message().metadata.to_pybytes())
    assert claimed.rows == 2 and claimed.lengths.tolist() == [2, 3, 2] and not claimed.compressed
    assert claimed.buffer_bytes == sum(buffer.size for column in batch for buffer in column.buffers() if buffer)


@pytest.mark.parametrize("cut", range(0, 200, 7))
def test_metadata_that_are_cut_off_are_refused_and_nothing_else(cut: int) -> None:
    reader = pa.ipc.MessageReader.open_stream(stream(pa.record_batch([pa.array([1.0])], names=["x"])))
    reader.read_next_message()
    whole = reader.read_next_message().metadata.to_pybytes()
    if cut < len(whole) - 16:
        with pytest.raises(ValueError, match=r"."):
            claims(whole[:cut])


def test_a_chunk_listed_twice_is_refused(run_file: Path) -> None:
    # 1 kB of footer could stand for any number of rows.
    where = Container.open(run_file).stores[0].entries[5]

    def doubled(batch: pa.RecordBatch) -> pa.RecordBatch:
        for name, value in (("chunk_byte_offset", where.offset), ("chunk_byte_size", where.length)):
            batch = with_column(batch, name, pa.array([value] * batch.num_rows, pa.uint64()))
        return batch

    assembled(run_file, run_file, messages_of(run_file), index=doubled)
    with pytest.raises(DamageError, match=f"chunk at byte {where.offset}, where no chunk can be"):
        Container.open(run_file)


def test_an_index_of_more_chunks_than_the_file_can_hold_is_refused(run_file: Path) -> None:
    def repeated(batch: pa.RecordBatch) -> pa.RecordBatch:
        return batch.take(pa.array(np.zeros(20_000, np.int64)))

    assembled(run_file, run_file, messages_of(run_file), index=repeated)
    with pytest.raises(DamageError, match="lists 20000 chunks in"):
        Container.open(run_file)


def test_a_message_of_endless_fields_is_not_taken_apart(run_file: Path) -> None:
    parts = [(kind, body) for kind, body in messages_of(run_file) if kind != END]
    parts[3] = (parts[3][0], b"\x08\x00" * 5_000_000)
    assembled(run_file, run_file, parts, footer=False)
    with pytest.raises(DamageError, match="too many fields"):
        Container.open(run_file)


ROOMY = 1 << 26


@pytest.mark.parametrize(("size", "stored"), [(ROOMY + 1, 1_000_000), (ROOMY + 1, ROOMY // 8), (4 * ROOMY, ROOMY // 3)])
def test_a_chunk_of_far_more_bytes_than_its_file_is_refused_before_it_is_unpacked(size: int, stored: int) -> None:
    payload, held = memoryview(bytes(size // 200)), pa.total_allocated_bytes()
    with pytest.raises(DamageError, match=f"would have {size} bytes"):
        record_batch(payload, LZ4, size, stored)
    assert pa.total_allocated_bytes() == held


def test_rows_that_take_no_bytes_of_the_file_are_refused() -> None:
    rows = 1_000_000
    payload = stream(pa.record_batch([pa.array(np.zeros(rows))], names=["component"]))
    packed = pa.compress(payload, codec="lz4_raw", asbytes=True)
    with pytest.raises(DamageError, match=f"a chunk of {rows} rows in {len(packed)} bytes"):
        record_batch(memoryview(packed), LZ4, len(payload))


@pytest.mark.nightly
@pytest.mark.slow
def test_no_small_recording_takes_half_a_gigabyte() -> None:
    """The command that takes most, on a file whose states unpack 200 times. `make hunt` tries all."""
    with tempfile.TemporaryDirectory() as folder:
        done = [sys.executable, inflated_recordings.__file__, folder, "state-checkpoint-moving-whole"]
        said = subprocess.run(done, capture_output=True, text=True, check=False)
    assert said.returncode == 0, said.stdout + said.stderr
