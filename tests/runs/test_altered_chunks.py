"""No chunk of a recording can be deleted or altered without a replay that says so."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest

import carom
from carom.errors import PhysicsError, RecordingError, SceneError
from carom.recording.read.recording import Recording
from carom.recording.rrd.framing import CHUNK, END
from carom.recording.rrd.messages import RECORDING, decode
from carom.runs.replay import CHOICE, replay
from carom.scene.load import Scene
from edited_recordings import (
    Change,
    assembled,
    changed,
    mapped,
    messages_of,
    repacked,
    stream,
    with_column,
    without_column,
)
from recording.read.test_first_difference import nudged

ROW_ID = "rerun.controls.RowId"
# when, where and by which command it was run: nothing of that comes back when it is run again
CIRCUMSTANCES = ("RecordingInfo:start_time", "wall_time", "profile.")
SAMPLE = 2  # of some 880 changes, tried in the default suite, by CAROM_SEED
# whose rows a recorder chooses by a budget, and a replay of another version's recording by another
CHOSEN = ("impacts", "state/checkpoint", "world/bodies ", "world/forces/")
STATIC = ("state/bodies", "__properties/arrows")
LARGE_SAMPLE = 20  # tried in the slow part, and more by generators.sh; all of them take half an hour

SCENE: dict[str, Any] = {  # 13 frames with spins, impacts, contacts at rest, planes and walls
    "seed": 3,
    "time": {"duration": 0.6, "max_dt": 0.02, "cfl": 1.0},
    "gravity": {"constant": 0.0, "uniform": [0.0, 0.0, -9.81]},
    "contact": {"restitution": 0.5, "static_friction": 0.5},
    "domain": {"boundary": "walls", "size": [2.0, 2.0, 2.0]},
    "plane": [{"name": "ramp", "normal": [0.3, 0.0, 1.0], "point": [0.0, 0.0, -0.9]}],
    "record": {"every": 0.05},
    "group": [{"count": 4, "radius": {"min": 0.3, "max": 0.4}, "velocity": {"dispersion": 2.0}}],
}

Mutant = tuple[str, list[int], Change | None]  # what is changed, in which messages, and how; None deletes them


def altered(name: str, batch: pa.RecordBatch) -> pa.RecordBatch:
    """Change the first value of each row of a component, or the last time of a timeline, where a chunk has it."""
    if name not in batch.schema.names:
        return batch
    column = batch[name]
    if pa.types.is_list(column.type):
        return mapped(name, nudged)(batch)
    values = np.array(column.cast(pa.int64()).to_numpy(zero_copy_only=False))
    values[-1] += 1
    return with_column(batch, name, pa.array(values).cast(column.type))


def doubled(batch: pa.RecordBatch) -> pa.RecordBatch:
    (whole,) = pa.Table.from_batches([batch, batch.slice(batch.num_rows - 1)]).combine_chunks().to_batches()
    return whole


def mutants_of(parts: list[tuple[int, bytes]]) -> Iterator[Mutant]:
    """Return each kind of change of each kind of chunk: an entity with its columns."""
    kinds: dict[tuple[str, tuple[str, ...]], list[int]] = {}
    for place, (kind, body) in enumerate(parts):
        if kind == CHUNK and decode(body)[0].kind == RECORDING:
            chunk = decode(body)[1]
            names = tuple(name for name in chunk.batch.schema.names if name != ROW_ID)
            kinds.setdefault((chunk.entity_path, names), []).append(place)
    for (path, names), places in kinds.items():
        compared = [name for name in names if not name.startswith(CIRCUMSTANCES)]
        if path == "__properties/run":
            compared = [name for name in names if name.startswith("version.")]
        if compared:
            yield f"{path} deleted", places, None
            yield f"{path} emptied", places, lambda batch: batch.slice(0, 0)
            yield f"{path} without its last row", places[-1:], lambda batch: batch.slice(0, batch.num_rows - 1)
            yield f"{path} with its last row twice", places[-1:], doubled
        for name in compared:
            yield f"{path} without {name}", places, partial(without_column, name=name)
            yield f"{path} with another {name}", places, partial(altered, name)


def mutated(source: Path, out: Path, parts: list[tuple[int, bytes]], mutant: Mutant) -> Recording | None:
    """Write a recording with one change; without an index where this would name chunks that are gone."""
    _, places, change = mutant
    if change is None:
        kept = [part for place, part in enumerate(parts) if place not in places and part[0] != END]
        return Recording.open(assembled(source, out, kept, footer=False))
    new = list(parts)
    batches = [decode(parts[place][1])[1].batch for place in places]
    changes = [change(batch) for batch in batches]
    if changes == batches:
        return None  # of empty lists, say
    for place, batch in zip(places, changes, strict=True):
        new[place] = CHUNK, repacked(parts[place][1], stream(batch))
    return Recording.open(assembled(source, out, new))


def said(recording: Recording) -> tuple[bool, list[str], dict[str, str]]:
    result = replay(recording)
    return result.same, result.not_compared, result.recorded_with


def silent(source: Path, out: Path, mutants: list[Mutant]) -> list[str]:
    """Return the changes after which a replay says the same as before.

    Of another version's recording nobody knows how many impacts are kept, and with which bodies and arrows.
    """
    parts, found = messages_of(source), list[str]()
    unfinished = assembled(source, out, [part for part in parts if part[0] != END], footer=False)
    before = {True: said(Recording.open(source)), False: said(Recording.open(unfinished))}
    named = CHOICE in before[True][1]
    assert before[True][0] and before[False][0]
    for mutant in mutants:
        try:
            recording = mutated(source, out, parts, mutant)
            if recording and said(recording) == before[recording.finished]:
                found += [mutant[0]] if not (named and mutant[0].startswith(CHOSEN)) else []
        except (RecordingError, SceneError, PhysicsError):
            continue
    return found


@pytest.fixture(scope="module")
def sources(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """A recording of this version, and one of another with the same schema."""
    folder = tmp_path_factory.mktemp("sources")
    own, other = folder / "own.rrd", folder / "other.rrd"
    carom.run(Scene.from_dict(SCENE), own)
    changed(own, other, "__properties/run", mapped("version.carom", lambda row: ["0.0.9"]), static=True)
    return {"own": own, "other": other}


def chosen(mutants: list[Mutant], seed: int, count: int) -> list[Mutant]:
    places = np.random.default_rng(seed).permutation(len(mutants))[:count]
    return [mutants[place] for place in places.tolist()]


@pytest.mark.parametrize(
    ("version", "count"),
    [
        ("own", SAMPLE),
        pytest.param("own", LARGE_SAMPLE, marks=pytest.mark.slow),
        pytest.param("other", LARGE_SAMPLE, marks=[pytest.mark.slow, pytest.mark.nightly]),
    ],
)
def test_what_is_deleted_or_altered_is_a_difference_or_named(
    version: str, count: int, seed: int, sources: dict[str, Path], tmp_path: Path
) -> None:
    source = sources[version]
    mutants = chosen(list(mutants_of(messages_of(source))), seed, count)
    assert silent(source, tmp_path / "out.rrd", mutants) == []


@pytest.mark.parametrize(
    ("entity", "name"),
    [
        ("state/checkpoint", ""),
        ("state/bodies", "group"),
        ("events", "kind"),
        ("events", "sim_time"),
        ("phase", "sim_time"),
        ("world/forces/normal", "Arrows3D:vectors"),
        ("__properties/arrows", "impacts.energy"),
    ],
)
def test_what_once_replayed_as_the_same_bits_no_longer_does(
    entity: str, name: str, sources: dict[str, Path], tmp_path: Path
) -> None:
    change = partial(altered, name) if name else lambda batch: batch.slice(0, batch.num_rows - 1)
    changed(sources["own"], tmp_path / "out.rrd", entity, change, static=entity in STATIC, every=bool(name))
    result = replay(Recording.open(tmp_path / "out.rrd"))
    told = "impact_sums" if name == "group" else entity.rpartition("/")[2]  # sums by group come before static data
    assert result.difference is not None and told in result.difference.quantity
