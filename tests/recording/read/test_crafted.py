"""Recordings with data that carom does not write: each reader refuses them in one sentence."""

from __future__ import annotations

import gc
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest

from carom.errors import RecordingError
from carom.recording.read.frame_rows import drawn_paths
from carom.recording.read.recording import Recording
from edited_recordings import Change, changed, mapped, retyped, with_column, without_column

OUTCOME, ABOUT = "__properties/outcome", "__properties/carom"


def several(values: list[Any]) -> Callable[[int], pa.Array]:
    return lambda rows: pa.array([values] * rows)


def doubled(batch: pa.RecordBatch) -> pa.RecordBatch:
    return with_column(batch, "step", pa.array(np.zeros(batch.num_rows, np.int64)))


STATIC: list[tuple[str, Change, str]] = [
    (ABOUT, retyped("title", several([3])), "title"),
    (ABOUT, retyped("bodies", several([-1])), "bodies"),
    (ABOUT, retyped("bodies", several([2**60])), "bodies"),
    (ABOUT, retyped("time_scale", several(["x"])), "time_scale"),
    (ABOUT, retyped("origin", several([0.0, 1.0])), "origin"),
    (ABOUT, retyped("origin", several([0.0, np.nan, 1.0])), "origin"),
    (ABOUT, lambda batch: without_column(batch, "bodies"), "has no bodies"),
    (OUTCOME, retyped("outcome", several([1.5])), "outcome"),
    (OUTCOME, retyped("contacts.total", several(["many"])), "contacts.total"),
    (OUTCOME, retyped("moments.impact.bodies", several(["1,two"])), "moments.impact.bodies"),
    (OUTCOME, lambda batch: without_column(batch, "moments.impact.time"), "impact without time"),
    (OUTCOME, retyped("profile.gravity", several(["long"])), "profile.gravity"),
]
MOVING: list[tuple[str, Change, str]] = [
    (
        "state/fingerprint",
        retyped("fingerprint", lambda rows: pa.array([[]] * rows, pa.list_(pa.uint64()))),
        "1 values",
    ),
    ("state/fingerprint", mapped("fingerprint", lambda row: [*row, *row]), "1 values"),
    ("state/fingerprint", mapped("fingerprint", lambda row: [None]), "1 values"),
    ("state/fingerprint", mapped("time", lambda row: [np.nan]), "times that do not increase"),
    ("state/fingerprint", doubled, "sorted by step"),
    ("energy/total", retyped("Scalars:scalars", several(["x"])), "of type list"),
    ("energy/total", mapped("Scalars:scalars", lambda row: [1.0, 2.0]), "1 values"),
    ("energy/total", lambda batch: without_column(batch, "Scalars:scalars"), "has no /energy/total: a part"),
    ("state/momentum", mapped("momentum_error", lambda row: []), "1 values"),
    ("step/contacts", mapped("Scalars:scalars", lambda row: [None]), "1 values"),
    ("events", retyped("TextLog:level", several([1])), "of type list"),
]


@pytest.mark.parametrize(("entity", "change", "said"), STATIC, ids=[f"{said}" for _, _, said in STATIC])
def test_a_property_of_another_kind_is_named(entity: str, change: Change, said: str, run_file: Path) -> None:
    recording = Recording.open(changed(run_file, run_file, entity, change, static=True))
    with pytest.raises(RecordingError, match=said):
        recording.summary()


@pytest.mark.parametrize(("entity", "change", "said"), MOVING, ids=[f"{path}: {said}" for path, _, said in MOVING])
def test_a_row_that_has_not_what_it_should_is_named(entity: str, change: Change, said: str, run_file: Path) -> None:
    recording = Recording.open(changed(run_file, run_file, entity, change))
    with pytest.raises(RecordingError, match=said):
        recording.summary()


def test_what_is_lost_of_overlaps_and_momenta_is_neither_zero_nor_in_the_way_of_the_rest(run_file: Path) -> None:
    changed(run_file, run_file, "step/relative_overlap", lambda batch: batch.slice(0, 0), footer=False)
    changed(run_file, run_file, "state/momentum", lambda batch: batch.slice(0, 0), footer=False)
    for key in ("contacts.total", "contacts.max_overlap", "momentum.max_error"):
        changed(run_file, run_file, OUTCOME, partial(without_column, name=key), static=True, footer=False)
    recording = Recording.open(run_file)
    summary = recording.summary()
    assert summary["contacts"]["max_overlap"] is None and np.isnan(summary["momentum"]["max_error"])
    assert summary["contacts"]["summed_over"] == "frames" and summary["frames"] > 0


def test_rows_that_lost_their_time_are_refused(run_file: Path) -> None:
    changed(run_file, run_file, "step/contacts", lambda batch: without_column(batch, "sim_time"), footer=False)
    with pytest.raises(RecordingError, match="rows of /step/contacts with steps, but without sim_time"):
        Recording.open(run_file)


def test_positions_that_are_no_numbers_are_refused_by_a_picture(run_file: Path) -> None:
    changed(run_file, run_file, "world/bodies", retyped("Ellipsoids3D:centers", several([True] * 60)))
    with pytest.raises(RecordingError, match=r"damaged .*type bool"):
        drawn_paths(Recording.open(run_file), [0])


def test_names_of_fewer_bodies_than_there_are_are_refused(run_file: Path) -> None:
    changed(run_file, run_file, "state/bodies", mapped("name", lambda row: row[:-1]), static=True)
    with pytest.raises(RecordingError, match="names or groups of its bodies do not fit 60 bodies"):
        Recording.open(run_file).bodies  # noqa: B018 - reads them


def test_chunks_that_unpack_to_more_than_the_file_do_not_stay_in_memory(run_file: Path) -> None:
    rows = 400_000  # of 52 bytes

    def bomb(batch: pa.RecordBatch) -> pa.RecordBatch:
        noise = pa.array(np.random.default_rng(1).random(rows))  # with zeros, rows would take too few bytes of the file
        values = pa.ListArray.from_arrays(pa.array(np.arange(rows + 1, dtype=np.int32)), noise)
        columns = {"Scalars:scalars": values, "step": pa.array(np.zeros(rows, np.int64))}
        columns |= {"sim_time": pa.array(np.zeros(rows, np.int64)).cast(pa.duration("ns"))}
        columns |= {"rerun.controls.RowId": batch["rerun.controls.RowId"].take(pa.array(np.zeros(rows, np.int64)))}
        arrays = [columns[name] for name in batch.schema.names]
        return pa.record_batch(arrays, schema=batch.schema)

    changed(run_file, run_file, "energy/total", bomb, every=False)
    held = pa.total_allocated_bytes()
    with pytest.raises(RecordingError, match="sorted by step"):
        Recording.open(run_file).energy("total")
    gc.collect()  # from Python 3.12 on, contextlib's frames and the error refer to each other
    assert pa.total_allocated_bytes() < held + 10_000_000


ALTERED = ("position", "velocity", "acceleration", "orientation", "angular_velocity", "previous_dt", "energy_scale")


@pytest.mark.parametrize("component", [*ALTERED, "ledger_friction", "time"])
def test_a_checkpoint_with_one_number_changed_is_refused(component: str, run_file: Path) -> None:
    changed(
        run_file, run_file, "state/checkpoint", mapped(component, lambda row: [np.nextafter(row[0], 1e9), *row[1:]])
    )
    with pytest.raises(RecordingError, match="it does not match its digest"):
        Recording.open(run_file).checkpoint(0)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (mapped("books", lambda row: ["[" * 100_000]), "damaged"),
        (mapped("books", lambda row: ['{"energy": 3}']), "sums are inconsistent"),
        (mapped("position", lambda row: [1e308, *row[1:]]), "too large to be squared"),
        (mapped("velocity", lambda row: row[:-1]), "179 values instead of 180"),
        (retyped("acceleration", several(["x"])), "damaged"),
    ],
)
def test_a_checkpoint_that_cannot_be_computed_with_is_refused(change: Change, said: str, run_file: Path) -> None:
    changed(run_file, run_file, "state/checkpoint", change)
    with pytest.raises(RecordingError, match=f"checkpoint at step 0 is damaged: .*{said}|{said}"):
        Recording.open(run_file).checkpoint(0)


def test_a_checkpoint_without_its_digest_is_damaged(run_file: Path) -> None:
    changed(run_file, run_file, "state/checkpoint", lambda batch: without_column(batch, "digest"))
    with pytest.raises(RecordingError, match="the checkpoint at step 0 is damaged"):
        Recording.open(run_file).checkpoint(0)
