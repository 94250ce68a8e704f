"""A recording in which anything was altered does not replay."""

from __future__ import annotations

import math
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest

import carom
from carom.errors import RecordingError
from carom.recording.edit.clip import clip
from carom.recording.read.recording import Recording
from carom.recording.rrd.framing import CHUNK
from carom.recording.schema import series
from carom.runs.replay import CHOICE, OUTCOME, replay
from carom.runs.resume import resumable_run
from edited_recordings import assembled, changed, is_of, mapped, messages_of, without_column
from small_scenes import cloud

WHERE_IT_CHANGES = ("phase", "step/limit")


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of 12 bodies, of 30 steps or so with impacts and friction."""
    path = tmp_path_factory.mktemp("altered") / "cloud.rrd"
    carom.run(cloud(12, time={"duration": 0.6, "max_dt": 0.02}), path)
    return path


def nudged(row: list[Any]) -> list[Any]:
    """Change the first number of a row by as little as can be, or a text."""
    if not row:
        return row
    if isinstance(row[0], bool):
        return [not row[0], *row[1:]]
    if isinstance(row[0], list):
        return [nudged(row[0]), *row[1:]]
    if isinstance(row[0], str):
        return [f"{row[0]}!", *row[1:]]
    if isinstance(row[0], float):
        if math.isnan(row[0]):
            return [0.0, *row[1:]]
        return [float(np.nextafter(np.float32(row[0]), np.float32(math.inf))), *row[1:]]
    return [row[0] ^ 1, *row[1:]]


RECORDED = [
    *((f"energy/{name}", "Scalars:scalars") for name in ("total", "translational", "rotational", "gravitational")),
    *((f"energy/ledger/{name}", "Scalars:scalars") for name in ("restitution", "friction", "stabilisation")),
    *((f"energy/{name}", "Scalars:scalars") for name in ("integration_error", "relative_error")),
    *((f"step/{name}", "Scalars:scalars") for name in ("dt", "contacts", "colours", "sweeps", "overlap")),
    ("step/relative_overlap", "Scalars:scalars"),
    ("world/bodies", "Ellipsoids3D:centers"),
    ("world/bodies", "Ellipsoids3D:quaternions"),
    ("world/angular_impulse", "Arrows3D:vectors"),
    ("world/spin_change", "Arrows3D:origins"),
    ("world/spin_change", "spin_change"),
    ("world/angular_impulse", "body"),
    ("world/contacts", "LineStrips3D:strips"),
    ("world/contacts", "LineStrips3D:colors"),
    *(
        ("state/momentum", name)
        for name in ("momentum", "momentum_error", "angular_momentum", "angular_momentum_error")
    ),
    ("phase", "StateChange:state"),
    ("step/limit", "StateChange:state"),
    ("events", "TextLog:text"),
]


@pytest.mark.parametrize(("entity", "component"), RECORDED, ids=[" ".join(pair) for pair in RECORDED])
def test_one_altered_value_is_found_and_named(entity: str, component: str, whole: Path, tmp_path: Path) -> None:
    altered = changed(whole, tmp_path / "altered.rrd", entity, mapped(component, nudged))
    result = replay(Recording.open(altered))
    assert not result.same and result.difference is not None
    assert f"/{entity}" in result.difference.quantity, result.difference


@pytest.mark.parametrize(
    ("entity", "component", "said"),
    [
        ("state/fingerprint", "fingerprint", "the checkpoint at step 0 does not match the fingerprint of its frame"),
        ("state/checkpoint", "velocity", "the checkpoint at step 0 is damaged"),
        ("state/checkpoint", "previous_dt", "the checkpoint at step 0 is damaged"),
    ],
)
def test_an_altered_checkpoint_is_not_begun_with(
    entity: str, component: str, said: str, whole: Path, tmp_path: Path
) -> None:
    altered = Recording.open(changed(whole, tmp_path / "altered.rrd", entity, mapped(component, nudged)))
    with pytest.raises(RecordingError, match=said):
        replay(altered)
    with pytest.raises(RecordingError, match=said.partition(" at ")[0]):
        resumable_run(altered, 2.0)


def test_a_later_checkpoint_that_was_altered_with_its_digest_is_found(whole: Path, tmp_path: Path) -> None:
    step = Recording.open(whole).checkpoint_steps[-1]

    def last_row(batch: pa.RecordBatch) -> pa.RecordBatch:
        place = batch["step"].to_pylist().index(step) if step in batch["step"].to_pylist() else None
        rows = iter(range(batch.num_rows))
        return mapped("acceleration", lambda row: nudged(row) if next(rows) == place else row)(batch)

    changed(whole, tmp_path / "altered.rrd", "state/checkpoint", last_row)
    result = replay(Recording.open(tmp_path / "altered.rrd"))
    assert result.difference is not None and result.difference.step == step
    assert result.difference.quantity == "acceleration of /state/checkpoint"


def test_rows_that_were_added_are_found(whole: Path, tmp_path: Path) -> None:
    # Rerun shows the last row of a time: a second one hides the first.
    parts = messages_of(whole)
    chunks = [body for kind, body in parts if kind == CHUNK]
    twice = next(body for body in chunks if is_of(body, "step/dt"))
    assembled(whole, tmp_path / "altered.rrd", [*parts, (CHUNK, twice)], footer=False)
    result = replay(Recording.open(tmp_path / "altered.rrd"))
    assert result.difference is not None and not result.same


def test_a_row_where_there_was_no_frame_is_found(whole: Path, tmp_path: Path) -> None:
    def thinned(batch: pa.RecordBatch) -> pa.RecordBatch:
        return batch.filter(pa.array(batch["step"].to_numpy() % 2 == 0))

    changed(whole, tmp_path / "altered.rrd", "state/fingerprint", thinned)
    result = replay(Recording.open(tmp_path / "altered.rrd"))
    assert result.difference is not None and "without a frame" in result.difference.quantity


def test_a_series_that_another_version_did_not_record_is_mentioned_once(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    with monkeypatch.context() as earlier:
        earlier.setattr(series, "SERIES", [each for each in series.SERIES if each.path != "step/contact_force"])
        carom.run(cloud(12, time={"duration": 0.1, "max_dt": 0.02}), tmp_path / "old.rrd")
    assert replay(tmp_path / "old.rrd").difference is not None, "this version records it"
    other = mapped("version.carom", lambda row: ["0.0.9"])
    changed(tmp_path / "old.rrd", tmp_path / "old.rrd", "__properties/run", other, static=True)
    result = replay(tmp_path / "old.rrd")
    assert result.same and "rows of /step/contact_force, because the recording lacks them" in result.not_compared


def test_a_whole_run_leaves_nothing_out_and_a_window_or_a_clip_says_what(whole: Path, tmp_path: Path) -> None:
    assert replay(Recording.open(whole)).not_compared == []
    steps = Recording.open(whole).checkpoint_times
    later = sorted(steps.values())[len(steps) // 2]
    window = replay(Recording.open(whole), later)
    assert window.same and window.not_compared == [CHOICE, OUTCOME]
    for bodies in (None, [1, 5, 7]):
        clip(whole, tmp_path / "clip.rrd", later + 0.05, 0.6, bodies)
        part = replay(Recording.open(tmp_path / "clip.rrd"))
        assert part.same and part.compared == part.frames > 2 and part.not_compared[0] == CHOICE


@pytest.mark.parametrize("entity", ["step/dt", "energy/total", "world/bodies"])
def test_a_row_that_is_missing_from_a_whole_recording_is_a_difference(entity: str, whole: Path, tmp_path: Path) -> None:
    altered = changed(whole, tmp_path / "altered.rrd", entity, lambda batch: batch.slice(0, batch.num_rows - 1))
    result = replay(Recording.open(altered))
    assert result.difference is not None and f" /{entity}" in result.difference.quantity


@pytest.mark.parametrize(
    ("entity", "component"),
    [("step/dt", "Scalars:scalars"), ("state/momentum", "momentum"), ("state/checkpoint", "velocity")],
)
def test_a_component_that_is_missing_from_a_whole_recording_is_a_difference(
    entity: str, component: str, whole: Path, tmp_path: Path
) -> None:
    altered = changed(whole, tmp_path / "altered.rrd", entity, partial(without_column, name=component), every=False)
    result = replay(Recording.open(altered))
    assert result.difference is not None and result.difference.quantity == f"{component} of /{entity}"


@pytest.mark.parametrize("entity", ["phase", "step/limit"])
def test_states_that_are_missing_from_a_whole_recording_are_a_difference(
    entity: str, whole: Path, tmp_path: Path
) -> None:
    altered = changed(whole, tmp_path / "altered.rrd", entity, lambda batch: batch.slice(0, 0))
    result = replay(Recording.open(altered))
    assert result.difference is not None and result.difference.quantity == f"rows of /{entity}"


@pytest.mark.parametrize("component", ["TextLog:text", "TextLog:level"])
def test_altered_events_of_the_end_are_found(component: str, whole: Path, tmp_path: Path) -> None:
    altered = changed(whole, tmp_path / "altered.rrd", "events", mapped(component, nudged), every=False)
    result = replay(Recording.open(altered))
    assert result.difference is not None and result.difference.quantity == "/events at the end"


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    ["outcome", "contacts.total", "energy.max_error", "moments.impact.between", "frames", "contacts.impacts_counted"],
)
def test_an_altered_outcome_is_found(name: str, whole: Path, tmp_path: Path) -> None:
    altered = changed(whole, tmp_path / "altered.rrd", "__properties/outcome", mapped(name, nudged), static=True)
    result = replay(Recording.open(altered))
    assert result.difference is not None and result.difference.quantity == f"{name} of the property outcome"


def altered_scene(whole: Path, out: Path, digest: bool) -> Recording:
    """Return a recording with another constant of gravity in its scene, with the first digest or without any."""

    def heavier(row: list[Any]) -> list[Any]:
        text = row[0].replace("constant = 1.0", "constant = 1.1")
        assert text != row[0]
        return [text]

    changed(whole, out, "scene/toml", mapped("TextDocument:text", heavier), static=True)
    if not digest:
        drop = partial(without_column, name="scene_sha256")
        changed(out, out, "__properties/carom", drop, static=True)
    return Recording.open(out)


@pytest.mark.parametrize("digest", [True, False])
def test_a_scene_that_was_altered_is_neither_replayed_nor_resumed(whole: Path, tmp_path: Path, digest: bool) -> None:
    altered = altered_scene(whole, tmp_path / "altered.rrd", digest)
    with pytest.raises(RecordingError, match="its scene was altered after the recording"):
        replay(altered)
    with pytest.raises(RecordingError, match="its scene was altered after the recording"):
        resumable_run(altered, 2.0)


@pytest.mark.slow
@pytest.mark.parametrize("every", [pytest.param("step", marks=pytest.mark.slow), 0.05])
def test_a_clip_replays_wherever_it_begins(every: str | float, tmp_path: Path) -> None:
    scene = cloud(12, time={"duration": 1.0, "max_dt": 0.02}, record={"every": every, "impacts": "all"})
    run = carom.run(scene, tmp_path / "run.rrd")
    times = run.fingerprints()["time"].to_numpy()
    hit = set(run.impacts()["step"].to_pylist()) & set(run.fingerprints()["step"].to_pylist())
    assert hit or every != "step", "a clip begins with a step that has impacts"
    for first in range(1, len(times) - 2, max(1, len(times) // 12)):
        clip(run.path, tmp_path / "clip.rrd", times[first], times[-1])
        checked = replay(Recording.open(tmp_path / "clip.rrd"))
        assert checked.same, f"from frame {first}: {checked.difference}"
