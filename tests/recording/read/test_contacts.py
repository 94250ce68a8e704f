"""The contacts and impacts of a recording, on short runs of a real scene."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pytest
from numpy.typing import NDArray

import carom
from carom.contact_table import CONTACT_ROW
from carom.errors import NotRecordedError, RecordingError
from carom.physics.space import Space
from carom.recording.edit.clip import clip
from carom.recording.read.lookup import frame_of
from carom.recording.read.recorded_contacts import of_body
from carom.recording.read.recorded_impacts import impacts_by_number, sums_between
from carom.recording.read.recording import Recording
from carom.recording.rrd.container import Container
from carom.recording.rrd.framing import CHUNK
from carom.recording.rrd.messages import Chunk, Entry, decode
from carom.recording.write.contact_encoder import BatchContacts
from carom.recording.write.impact_plan import ImpactPlan, Kept, impact_rows
from carom.runs.recomputed import contacts_of, impacts_of
from carom.runs.replay import CHOICE, replay
from carom.runs.resume import continue_run, resumable_run
from carom.scene.load import Scene
from carom.state.frame import Frame
from edited_recordings import assembled, changed, is_of, mapped, messages_of, repacked, stream, with_column
from scripted_run import ScriptedRun
from small_scenes import pair, scene_of

SINGLE = 1e-6  # relative, of a few roundings to float32
NUMBERS = ("x", "y", "z", "nx", "ny", "nz", "approach_speed", "normal_impulse", "tangential_impulse", "energy_lost")


def scene(impacts: str = "auto", duration: float = 2.0, every: float | str = 0.1) -> Scene:
    """Three balls of different sizes that bounce and roll on a floor and meet each other."""
    balls = [
        {"name": "low", "position": [0.0, 0.0, 0.3], "velocity": [1.0, 0.0, 0.0], "radius": 0.3},
        {"name": "high", "position": [1.0, 0.1, 1.5], "velocity": [0.0, 0.0, 0.0], "radius": 0.4},
        {"name": "far", "position": [4.0, 0.0, 0.8], "angular_velocity": [0.0, 5.0, 0.0], "radius": 0.2},
    ]
    return scene_of(
        [{"mass": 1.0, **ball} for ball in balls],
        gravity={"constant": 0.0, "uniform": [0.0, 0.0, -9.81]},
        contact={"restitution": 0.5},
        plane=[{"name": "floor", "point": [0.0, 0.0, 0.0]}],
        time={"duration": duration, "fixed_dt": 0.005},
        record={"every": every, "impacts": impacts},
    )


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    """A run of 400 steps, of which every twentieth is recorded."""
    return carom.run(scene(), tmp_path_factory.mktemp("run") / "run.rrd")


@pytest.fixture(scope="module")
def silent(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    """The same run without recorded contacts."""
    return carom.run(scene("none"), tmp_path_factory.mktemp("silent") / "silent.rrd")


@pytest.fixture(scope="module")
def truth() -> np.ndarray:
    """All impacts of the run, as the solver reports them."""
    frames = Space(scene(), record_contacts=True).run()
    return np.concatenate([frame.impacts for frame in frames if frame.impacts is not None])


def entities(recording: Recording) -> set[str]:
    return {entry.entity_path for entry in recording.store.entries}


def at_impacts(recording: Recording) -> list[Entry]:
    """Return the chunks of bodies that are on the timeline of impacts only."""
    own = [e for e in recording.store.entries if e.entity_path == "world/bodies" and not e.is_static]
    return [entry for entry in own if entry.first_step is None]


def assert_close(table: pa.Table, exact: pa.Table) -> None:
    for name in ("step", "i", "j", "mode"):
        assert table[name].to_pylist() == exact[name].to_pylist()
    for name in NUMBERS:
        of = exact[name].to_numpy()
        # a coordinate is rounded as a float32 of up to 5 m from the origin, a normal as one of length 1
        np.testing.assert_allclose(table[name].to_numpy(), of, rtol=SINGLE, atol=5.0 * SINGLE)


def test_every_impact_is_recorded_at_its_own_time_within_the_rounding_of_float32(
    recording: Recording, truth: np.ndarray
) -> None:
    table = recording.impacts()
    assert table.num_rows == len(truth) > 10
    assert table["step"].to_pylist() == truth["step"].tolist()
    np.testing.assert_allclose(table["time"].to_numpy(), truth["time"], atol=1e-9)  # the timeline counts nanoseconds
    np.testing.assert_allclose(table["normal_impulse"].to_numpy(), truth["normal_impulse"], rtol=SINGLE)
    assert table.schema.metadata == {b"source": b"recorded", b"left_out": b"0"}
    assert_close(table, impacts_of(recording, replay=True))


def test_impacts_of_a_recording_without_them_are_those_of_a_replay_with_the_same_bits(
    silent: Recording, truth: np.ndarray
) -> None:
    assert not {"impacts", "world/forces/normal"} & entities(silent)
    table = impacts_of(silent)
    for name in ("step", "time", "normal_impulse", "approach_speed", "x"):
        assert table[name].to_pylist() == truth[name].tolist()
    assert table.schema.metadata[b"source"] == b"replayed from step 0, with the same bits"


def test_impacts_of_an_interval_and_a_body_are_those_of_the_whole_run_that_fit(
    recording: Recording, silent: Recording, truth: np.ndarray
) -> None:
    inside = (truth["time"] >= 0.5) & (truth["time"] <= 1.5) & ((truth["i"] == 1) | (truth["j"] == 1))
    for table in (recording.impacts(0.5, 1.5, "high"), of_body(impacts_of(silent, 0.5, 1.5), 1)):
        assert table["step"].to_pylist() == truth["step"][inside].tolist()


def test_only_the_impacts_around_an_interval_are_read(recording: Recording, monkeypatch: pytest.MonkeyPatch) -> None:
    own = Recording.open(recording.path)
    first = int(own.impact_steps[0])
    frames = own.fingerprints()
    before = frames["time"].to_numpy()[frames["step"].to_numpy() < first - 20]  # no frame beside the impact
    read, inner = list[str](), Container.chunks

    def chunks(container: Container, entries: Iterable[Entry]) -> Iterator[Chunk]:
        asked = list(entries)
        read.extend(entry.entity_path for entry in asked)
        return inner(container, asked)

    monkeypatch.setattr(Container, "chunks", chunks)
    assert own.impacts(0.0, float(before[-1])).num_rows == 0 and "impacts" not in read
    assert own.impacts(0.0, frames["time"][-1].as_py()).num_rows == len(own.impact_steps) and "impacts" in read


@pytest.mark.parametrize("frame", [17, 19, 20])
def test_the_contacts_of_a_frame_are_those_of_its_step(recording: Recording, silent: Recording, frame: int) -> None:
    time = float(recording.fingerprints()["time"][frame].as_py())
    table, exact = recording.contacts(time), contacts_of(silent, time)
    seen = exact.filter(pa.array(np.isin(exact["j"].to_numpy() * 10 + exact["i"].to_numpy(), _pairs(table))))
    assert table.num_rows > 0
    for name in ("i", "j", "mode"):
        assert table[name].to_pylist() == seen[name].to_pylist()
    for name in ("x", "y", "z", "nx", "nz", "normal_impulse", "tangential_impulse"):
        np.testing.assert_allclose(table[name].to_numpy(), seen[name].to_numpy(), rtol=SINGLE, atol=5.0 * SINGLE)
    assert table.schema.metadata[b"source"] == b"recorded"
    assert b"replayed" in exact.schema.metadata[b"source"]


def test_an_impact_of_a_long_step_is_where_the_bodies_met(tmp_path: Path) -> None:
    bodies: list[dict[str, Any]] = [
        {"position": [-2, 0, 0], "velocity": [3, 0, 0]},
        {"position": [2, 1.2, 0], "velocity": [-3, 0, 0]},
    ]
    time = {"duration": 1.0, "fixed_dt": 1.0}
    contact = {"timing": "time-of-impact", "static_friction": 0.0, "kinetic_friction": 0.0}
    recorded = carom.run(scene_of(bodies, gravity={"constant": 0.0}, contact=contact, time=time), tmp_path / "run.rrd")
    assert recorded.steps()["step"].to_pylist() == [0, 1], "they are far apart again at the end of the step"
    table, exact = recorded.contacts(1.0), contacts_of(recorded, 1.0, replay=True)
    assert table["ny"].to_pylist() == pytest.approx([0.6], abs=SINGLE), "of 2 m between the centres"
    for name in ("time", "x", "y", "z", "nx", "ny", "nz"):
        np.testing.assert_allclose(table[name].to_numpy(), exact[name].to_numpy(), atol=5.0 * SINGLE)


def _pairs(table: pa.Table) -> np.ndarray:
    return np.asarray(table["j"].to_numpy() * 10 + table["i"].to_numpy())


def test_the_contacts_of_a_step_without_a_frame_are_run_again(recording: Recording) -> None:
    with pytest.raises(NotRecordedError, match=r"does not hold the contacts of the step .* 1\.012 s; carom\.rerun"):
        recording.contacts(1.012)  # between 1.010 and 1.015
    table = contacts_of(recording, 1.012)
    assert set(table["step"].to_pylist()) == {203}
    assert b"with the same bits" in table.schema.metadata[b"source"]


def test_stepping_through_impacts_shows_the_two_bodies_where_they_touch(tmp_path: Path) -> None:
    recording = carom.run(
        pair(time={"duration": 2.0, "fixed_dt": 0.1}, contact={"timing": "time-of-impact"}, record={"every": 0.7}),
        tmp_path / "pair.rrd",
    )
    (entry,) = at_impacts(recording)
    (chunk,) = recording.chunks([entry])
    assert chunk.batch["impact"].to_pylist() == [1]
    centres = np.array(chunk.batch["Ellipsoids3D:centers"][0].as_py()) + recording.origin
    np.testing.assert_allclose(centres, [[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0]], atol=SINGLE)  # radii of 1 m
    assert replay(recording).same
    clip(recording.path, tmp_path / "clip.rrd", 0.5, 1.5)
    assert [entry.rows for entry in at_impacts(Recording.open(tmp_path / "clip.rrd"))] == [1]


def test_a_replay_compares_impacts_and_contacts(recording: Recording, tmp_path: Path) -> None:
    found = replay(recording)
    assert found.same
    assert found.not_compared == []
    faster = mapped("approach_speed", lambda row: [float(np.float32(row[0] * (1.0 + 1e-6)))])
    found = replay(changed(recording.path, tmp_path / "altered.rrd", "impacts", faster))
    assert found.difference is not None
    assert found.difference.quantity == "approach_speed of /impacts"


@pytest.fixture
def thinned(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Recording:
    """A run whose recording leaves out most of the impacts between frames."""
    monkeypatch.setattr("carom.recording.write.impact_plan.SHARE", 1e-6)
    recording = carom.run(scene(every=0.3), tmp_path / "thinned.rrd")
    counts = recording.summary()["impacts"]
    assert counts["recorded"] > 3 and counts["left_out"] > 3
    return recording


def test_where_impacts_were_left_out_a_replay_compares_the_largest(thinned: Recording, tmp_path: Path) -> None:
    whole = replay(thinned)
    assert whole.same and whole.not_compared == []
    clip(thinned.path, tmp_path / "clip.rrd", 0.8, 1.9)
    part = replay(Recording.open(tmp_path / "clip.rrd"))
    assert part.same and CHOICE in part.not_compared, "a clip does not know what was recorded before it"


def test_a_replay_finds_that_fewer_impacts_were_kept_than_there_was_room_for(
    recording: Recording, tmp_path: Path
) -> None:
    counts = pc.value_counts(pc.ceil(pc.divide(pc.cast(recording.impacts()["step"], pa.float64()), 20.0)))
    interval = next(row["values"] for row in counts.to_pylist() if row["counts"] > 1)
    dropped = list[int]()

    def without_the_weakest(batch: pa.RecordBatch) -> pa.RecordBatch:
        inside = np.ceil(batch["step"].to_numpy() / 20.0) == interval
        impulses = np.array([row[0] for row in batch["normal_impulse"].to_pylist()])
        weakest = int(np.argmin(np.where(inside, impulses, np.inf)))
        dropped.append(batch["impact"][weakest].as_py())
        return batch.filter(pa.array(np.arange(batch.num_rows) != weakest))

    changed(recording.path, tmp_path / "fewer.rrd", "impacts", without_the_weakest)
    found = replay(Recording.open(tmp_path / "fewer.rrd")).difference
    assert found is not None
    assert (found.quantity, found.recorded, found.replayed) == (f"impact {dropped[0]} in /impacts", "nothing", "a row")


def test_a_replay_compares_the_numbers_of_impacts_in_the_outcome(recording: Recording, tmp_path: Path) -> None:
    count = recording.closing["impacts.recorded"]
    one_more = mapped("impacts.recorded", lambda row: [row[0] + 1])
    changed(recording.path, tmp_path / "altered.rrd", "__properties/outcome", one_more, static=True)
    found = replay(Recording.open(tmp_path / "altered.rrd")).difference
    assert found is not None
    assert (found.quantity, found.recorded, found.replayed) == (
        "impacts.recorded of the property outcome",
        count + 1,
        count,
    )


def test_a_replay_finds_that_not_the_largest_impacts_were_kept(thinned: Recording, tmp_path: Path) -> None:
    hardest = pc.index(thinned.impacts()["normal_impulse"], pc.max(thinned.impacts()["normal_impulse"])).as_py()
    number = impacts_by_number(thinned)[0][hardest]

    def renumbered(batch: pa.RecordBatch) -> pa.RecordBatch:
        numbers = batch["impact"].to_numpy() + (batch["impact"].to_numpy() == number)
        return with_column(batch, "impact", pa.array(numbers))

    changed(thinned.path, tmp_path / "altered.rrd", "impacts", renumbered)
    found = replay(Recording.open(tmp_path / "altered.rrd")).difference
    assert found is not None
    assert (found.quantity, found.recorded, found.replayed) == (f"impact {number} in /impacts", "nothing", "a row")


def test_a_replay_compares_the_bodies_that_are_drawn_at_impacts(recording: Recording, tmp_path: Path) -> None:
    def moved(batch: pa.RecordBatch) -> pa.RecordBatch:
        if "step" in batch.schema.names:
            return batch
        return mapped("Ellipsoids3D:centers", lambda row: [[row[0][0] + 1e-3, *row[0][1:]], *row[1:]])(batch)

    assert at_impacts(recording)
    changed(recording.path, tmp_path / "altered.rrd", "world/bodies", moved)
    found = replay(Recording.open(tmp_path / "altered.rrd")).difference
    assert found is not None and found.quantity == "x (as drawn in /world/bodies)"
    assert found.by == pytest.approx(-1e-3, rel=1e-3)


def test_impacts_whose_columns_change_their_type_are_found_by_a_replay(recording: Recording, tmp_path: Path) -> None:
    parts = messages_of(recording.path)
    chunks = (k for k, (kind, body) in enumerate(parts) if kind == CHUNK and is_of(body, "impacts"))
    k = max(chunks, key=lambda k: decode(parts[k][1])[1].batch.num_rows)  # a slow machine writes several
    body, batch = parts[k][1], decode(parts[k][1])[1].batch
    rest = batch.slice(5)
    rest = with_column(rest, "mode", rest["mode"].cast(pa.list_(pa.float64())))
    pieces = [(CHUNK, repacked(body, stream(piece))) for piece in (batch.slice(0, 5), rest)]
    path = assembled(recording.path, tmp_path / "altered.rrd", [*parts[:k], *pieces, *parts[k + 1 :]], footer=False)
    found = replay(Recording.open(path)).difference
    assert found is not None and found.quantity == "type of mode of /impacts"


@pytest.mark.parametrize(("entity", "column"), [("world/forces/normal", "bodies"), ("world/contacts", "impact_count")])
def test_rows_without_values_are_refused_by_a_replay(
    entity: str, column: str, recording: Recording, tmp_path: Path
) -> None:
    def emptied(batch: pa.RecordBatch) -> pa.RecordBatch:
        if column not in batch.schema.names:  # at impacts
            return batch
        return with_column(batch, column, pa.nulls(batch.num_rows, batch[column].type))

    changed(recording.path, tmp_path / "altered.rrd", entity, emptied)
    with pytest.raises(RecordingError, match=r"altered\.rrd is not a recording, or is damaged"):
        replay(Recording.open(tmp_path / "altered.rrd"))


def sums(recording: Recording, first: int, last: int) -> list[float]:
    """Return the sums over all impacts between two frames as one row."""
    found = sums_between(recording, first, last)
    assert found is not None
    return [float(value) for value in found.flat()]


def test_a_replay_finds_altered_sums_over_impacts_and_a_file_with_some_missing_has_none(
    recording: Recording, tmp_path: Path
) -> None:
    def doubled(row: list[float]) -> list[float]:
        return [2.0 * value for value in row]

    altered = tmp_path / "altered.rrd"
    changed(recording.path, altered, "world/contacts", lambda b: _with_sums(b, mapped("impact_sums", doubled)))
    difference = replay(Recording.open(altered)).difference
    assert difference is not None and difference.quantity == "impact_sums of /world/contacts"
    changed(recording.path, altered, "world/contacts", lambda b: _with_sums(b, mapped("impact_sums", lambda _: [])))
    assert sums_between(Recording.open(altered), 0, 400) is None
    changed(recording.path, altered, "world/contacts", lambda b: _with_sums(b, mapped("impact_sums", lambda r: r[1:])))
    with pytest.raises(RecordingError, match="damaged"):
        sums_between(Recording.open(altered), 0, 400)


def _with_sums(batch: pa.RecordBatch, change: Callable[[pa.RecordBatch], pa.RecordBatch]) -> pa.RecordBatch:
    return change(batch) if "impact_sums" in batch.schema.names else batch  # not at impacts


def test_a_resumed_run_has_the_impacts_of_one_that_never_stopped(recording: Recording, tmp_path: Path) -> None:
    path = carom.run(scene(duration=1.0), tmp_path / "half.rrd").path
    half = resumable_run(Recording.open(path), until=2.0)
    continue_run(half, half.space(), tmp_path / "whole.rrd")
    whole = Recording.open(tmp_path / "whole.rrd")
    assert whole.impacts().equals(recording.impacts())
    assert sums(whole, 0, 400) == sums(recording, 0, 400) and len(sums(whole, 0, 400)) > 16
    assert replay(whole).same


def test_a_clip_has_its_impacts_and_those_of_its_bodies_only(recording: Recording, tmp_path: Path) -> None:
    clip(recording.path, tmp_path / "clip.rrd", 0.45, 1.55)
    table = recording.impacts()
    steps = table["step"].to_numpy()
    inside = table.filter(pa.array((steps >= 100) & (steps <= 300)))
    assert Recording.open(tmp_path / "clip.rrd").impacts().equals(inside)
    assert sums(Recording.open(tmp_path / "clip.rrd"), 100, 300) == sums(recording, 100, 300)
    assert replay(Recording.open(tmp_path / "clip.rrd")).same
    clip(recording.path, tmp_path / "few.rrd", 0.45, 1.55, bodies=[1])
    few = Recording.open(tmp_path / "few.rrd").impacts()
    assert set(few["i"].to_pylist()) == {1}
    assert set(few["j"].to_pylist()) == {3}  # the floor
    assert replay(Recording.open(tmp_path / "few.rrd")).same


@pytest.mark.parametrize("replayed", [False, True])
def test_the_angular_impulses_of_an_impact_change_the_spins(tmp_path: Path, replayed: bool) -> None:
    balls = [
        {"position": [-2.0, 0.0, 0.0], "velocity": [1.0, 0.0, 0.0], "mass": 2.0, "radius": 0.6},
        {"position": [0.0, 0.4, 0.0], "mass": 0.5, "radius": 0.4},
    ]
    times, record = {"duration": 2.0, "fixed_dt": 0.1}, {"every": "step"}
    recording = carom.run(scene_of(balls, gravity={"constant": 0.0}, time=times, record=record), tmp_path / "run.rrd")
    (impact,) = impacts_of(recording, replay=replayed).to_pylist()
    (contact,) = contacts_of(recording, impact["time"], replay=replayed).to_pylist()
    spins = recording.checkpoint(recording.checkpoint_steps[-1]).angular_velocity
    assert spins is not None and np.all(np.abs(spins[:, 2]) > 0.05), "both rotate after it, and did not before"
    expected = recording.bodies.inertia * np.abs(spins[:, 2])
    for row in (impact, contact):
        assert [row["angular_impulse_i"], row["angular_impulse_j"]] == pytest.approx(
            expected, rel=1e-12 if replayed else SINGLE
        )


def test_planes_have_no_angular_impulse_nor_do_bodies_without_spins(recording: Recording, tmp_path: Path) -> None:
    for row in recording.impacts().to_pylist():
        assert row["angular_impulse_i"] is not None and (row["angular_impulse_j"] is None) is (row["j"] >= 3)
    smooth = carom.run(pair(2.0, contact={"static_friction": 0.0, "kinetic_friction": 0.0}), tmp_path / "smooth.rrd")
    assert smooth.impacts()["angular_impulse_i"].to_pylist() == [None]


@pytest.mark.parametrize(
    ("question", "message"),
    [
        (lambda r: r.impacts(3.0, 4.0), r"covers 0 to 2 s; 3 to 4 s is outside"),
        (lambda r: r.impacts(2.0, 1.0), r"the end is before the start"),
        (lambda r: r.impacts(body="higg"), r'no body "higg"; did you mean "high"\?'),
        (lambda r: r.contacts(9.0), r"covers 0 to 2 s; 9 s is outside"),
        (lambda r: r.contacts("1 s"), r"^at = '1 s': a time is a number, in seconds$"),
        (lambda r: r.bodies("1 s"), r"^at = '1 s': a time is a number, in seconds$"),
        (lambda r: r.impacts(end=float("nan")), r"^end = nan: a time is a number, in seconds$"),
        (lambda r: r.trajectory(0, start="1 s"), r"^start = '1 s': a time is a number, in seconds$"),
    ],
)
def test_a_question_about_missing_contacts_is_refused_in_one_sentence(
    recording: Recording, question: Any, message: str
) -> None:
    with pytest.raises(RecordingError, match=message):
        question(recording)


def frames_with_impacts(count: int, each: int) -> list[Frame]:
    """Frames that have impacts of rising impulses, made up."""
    frames = []
    for frame in ScriptedRun(20).frames(count):
        rows = np.zeros(each, CONTACT_ROW)
        rows["step"], rows["time"], rows["j"] = frame.step, frame.time, 1
        rows["normal_impulse"] = np.random.default_rng(frame.step).permutation(each) + 1.0
        frames.append(replace(frame, impacts=rows, contact_rows=np.zeros(0, CONTACT_ROW)))
    return frames


def test_numbers_too_large_for_float32_are_recorded_as_infinite_without_a_warning() -> None:
    (frame,) = frames_with_impacts(1, 2)
    assert frame.impacts is not None
    for name in ("x", "approach_speed", "normal_impulse", "friction_x", "restitution_loss"):
        frame.impacts[name] = [1.0, 1e60]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        rows = impact_rows(frame.impacts, np.array([1, 2]), {}, ScriptedRun(20).header, np.zeros(3))
    columns = {column.component_descriptor().component: column.as_arrow_array() for column in rows.columns}
    for name in ("approach_speed", "normal_impulse", "tangential_impulse", "energy_lost"):
        assert columns[name].to_pylist() == [[1.0], [np.inf]]


def test_impacts_and_contacts_too_large_for_float32_are_those_of_a_replay(tmp_path: Path) -> None:
    suns = [
        {"position": [2e9 * k, 5e7 * k, 0.0], "velocity": [v, 0.0, 0.0], "radius": 7e8, "mass": 2e30}
        for k, v in enumerate((6.2e5, -6.2e5, -6.2e5))
    ]
    scene = scene_of(suns, gravity={"constant": 0.0}, time={"duration": 1000.0, "max_dt": 100.0})
    recording = carom.run(scene, tmp_path / "suns.rrd")
    assert recording.impacts()["energy_lost"].to_pylist() == [np.inf]
    (impact,) = impacts_of(recording).to_pylist()
    assert impact == impacts_of(recording, replay=True).to_pylist()[0] and 3.5e38 < impact["energy_lost"] < 8e41
    (contact,) = contacts_of(recording, impact["time"]).to_pylist()
    assert contact["energy_lost"] == impact["energy_lost"]
    clip(recording.path, tmp_path / "clip.rrd", 0.0, 1e3, [0, 1], exact=False)
    part = Recording.open(tmp_path / "clip.rrd")  # it cannot be run again
    assert part.impacts()["energy_lost"].to_pylist() == [np.inf]
    assert part.contacts(impact["time"])["energy_lost"].to_pylist() == [np.inf]


def planned(plan: ImpactPlan, frames: list[Frame]) -> Kept:
    """Return how many impacts of each frame a plan keeps."""
    contacts, position = BatchContacts(frames), np.stack([frame.position for frame in frames])
    return plan.choose(position, contacts.edges, contacts.contacts, contacts.impacts, contacts.hardest())


def kept(plan: ImpactPlan, frames: list[Frame]) -> list[NDArray[np.int64]]:
    """Return which impacts of each frame a plan keeps."""
    counts = planned(plan, frames).impacts
    return np.split(BatchContacts(frames).strongest_impacts(counts)[1], np.cumsum(counts)[:-1])


def plan_for(everything: bool = False) -> ImpactPlan:
    return ImpactPlan(everything=everything, oriented=True, turned=True)


def test_all_impacts_are_kept_while_they_are_cheap() -> None:
    assert all(len(rows) == 3 for rows in kept(plan_for(), frames_with_impacts(200, 3)))


def test_when_impacts_are_dear_the_largest_of_each_frame_are_kept_in_order_of_time() -> None:
    frames = frames_with_impacts(300, 400)
    plan = plan_for()
    chosen = [*kept(plan, frames[:7]), *kept(plan, frames[7:])]
    assert all(map(np.array_equal, chosen, kept(plan_for(), frames))), "however frames are batched"
    assert len(chosen[0]) == 400
    assert all(1 <= len(rows) < 400 for rows in chosen[10:])
    for frame, rows in zip(frames[10:], chosen[10:], strict=True):
        assert frame.impacts is not None
        impulses = frame.impacts["normal_impulse"]
        assert impulses[rows].min() > len(impulses) - len(rows)
        assert np.all(np.diff(rows) > 0)


def harder(frame: Frame, times: float) -> Frame:
    """Return a frame whose impacts are some times as hard."""
    assert frame.impacts is not None
    frame.impacts["normal_impulse"] *= times
    return frame


def test_a_much_harder_impact_gets_a_frame_of_its_instant_after_the_first_ones_spent_the_budget() -> None:
    frames = frames_with_impacts(200, 50)
    late = {120: 2.0, 150: 2.1, 180: 20.0}  # how much harder the impacts before these frames are
    for place, times in late.items():
        harder(frames[place], times)
    scenes = planned(plan_for(), frames).scenes
    assert scenes[0] > 10 and scenes[1] == 0, "the budget is spent at once"
    assert np.flatnonzero(scenes[1:]).tolist() == [119, 179], "the one in the middle is hardly harder than the first"
    plan = plan_for()
    batches = [planned(plan, frames[:121]).scenes, planned(plan, frames[121:]).scenes]
    assert np.concatenate(batches).tolist() == scenes.tolist(), "however frames are batched"


def test_impacts_that_grow_steadily_get_few_frames_beyond_the_budget() -> None:
    growth = 1.05
    frames = [harder(frame, growth**k) for k, frame in enumerate(frames_with_impacts(200, 50))]
    scenes = planned(plan_for(), frames).scenes
    most = np.log(growth**200) / np.log(1.25)  # each is 1.25 times as hard as the one before
    assert most / 2 < np.count_nonzero(scenes[1:]) <= most


def test_everything_is_kept_if_the_scene_says_so() -> None:
    assert all(len(rows) == 400 for rows in kept(plan_for(everything=True), frames_with_impacts(50, 400)))


def test_of_impacts_that_are_equally_hard_the_first_are_kept() -> None:
    (frame,) = frames_with_impacts(1, 9)
    assert frame.impacts is not None
    frame.impacts["normal_impulse"] = [1, 3, 2, 2, 0, 2, 3, 0, 2]
    for count in range(10):
        _, chosen = BatchContacts([frame]).strongest_impacts(np.array([count]))
        expected = np.sort(np.argsort(-frame.impacts["normal_impulse"], kind="stable")[:count])
        assert chosen.tolist() == expected.tolist()


def test_after_many_steps_a_frame_is_found_by_its_own_time(
    recording: Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    steps = pa.table({"time": [0.0, 157525020.0, 157788000.0], "dt": [0.0, 1.0, 1.0]})  # one step a second
    monkeypatch.setattr(Recording, "steps", lambda self, name: steps)
    assert [frame_of(recording, time) for time in steps["time"].to_pylist()] == [0, 1, 2]
    assert frame_of(recording, 157787000.0) is None


def test_the_force_on_the_floor_is_the_weight_of_what_rests_on_it(tmp_path: Path) -> None:
    mass, field, radius = (2.0, 3.0), 9.81, 0.3
    ball = {"velocity": [0.0, 0.0, 0.0], "radius": radius}
    bodies = [{"mass": m, "position": [0.0, 0.0, (1 + 2 * k) * radius], **ball} for k, m in enumerate(mass)]
    tower = scene_of(
        bodies,
        gravity={"constant": 0.0, "uniform": [0.0, 0.0, -field]},
        contact={"restitution": 0.0, "static_friction": 0.0},
        plane=[{"name": "floor", "point": [0.0, 0.0, 0.0]}],
        time={"duration": 0.2, "fixed_dt": 0.01},
        record={"every": 0.1},
    )
    recording = carom.run(tower, tmp_path / "tower.rrd")
    weights = {(0, 1): mass[1] * field, (0, 2): sum(mass) * field}
    for again, precision in ((False, SINGLE), (True, 1e-9)):  # 1e-9: of the solver, which iterates over two contacts
        rows = contacts_of(recording, 0.1, replay=again).to_pylist()
        forces = {(row["i"], row["j"]): row["normal_force"] for row in rows}
        assert forces == pytest.approx(weights, rel=precision)
        assert {row["mode"] for row in rows} == {"resting"} and {row["tangential_force"] for row in rows} == {0.0}


def test_an_impact_has_an_impulse_and_no_force(recording: Recording) -> None:
    rows = contacts_of(recording, recording.impacts()["time"][0].as_py()).to_pylist()
    assert [row["normal_force"] for row in rows if row["mode"] == "impact"] == [None]
    assert recording.impacts()["normal_force"].null_count == recording.impacts().num_rows
