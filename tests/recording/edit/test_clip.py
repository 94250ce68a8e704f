import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from carom.errors import RecordingError
from carom.recording.edit.clip import clip
from carom.recording.read.recording import Recording
from carom.recording.schema import paths
from carom.recording.write.recorder import FrameRecorder
from carom.state.frame import Frame
from scripted_run import ScriptedRun

FIRST, LAST = 45, 73  # steps of the clip that most tests make: frame 45 lies inside a phase, and at no checkpoint
START, END = 45 * 0.05, 73 * 0.05  # s


def rows(path: Path, entity: str) -> dict[int, dict[str, Any]]:
    """Read an entity's rows, by step."""
    recording = Recording.open(path)
    found = {}
    for chunk in recording.chunks(e for e in recording.store.entries if e.entity_path == entity and not e.is_static):
        for row in chunk.batch.to_pylist():
            found[row["step"]] = {name: row[name] for name in chunk.components}
    return found


def static(path: Path, entity: str) -> dict[str, list[Any]]:
    recording = Recording.open(path)
    entries = [e for e in recording.store.entries if e.entity_path == entity and e.is_static]
    return {name: chunk.batch[name][0].as_py() for chunk in recording.chunks(entries) for name in chunk.components}


def layout(path: Path) -> list[tuple[str, str, str]]:
    chunks = Recording.open(path).layout()
    return [(c.entity_path, name, str(c.batch[name].to_pylist())) for c in chunks for name in c.components]


def temporal(path: Path) -> set[str]:
    return {e.entity_path for e in Recording.open(path).store.entries if not e.is_static}


@pytest.fixture
def cut(recorded: Path, tmp_path: Path) -> Path:
    clip(recorded, tmp_path / "clip.rrd", START, END)
    return tmp_path / "clip.rrd"


def test_a_clip_has_the_rows_of_its_frames_and_no_others(recorded: Path, cut: Path) -> None:
    assert temporal(cut) == temporal(recorded)
    for entity in temporal(recorded) - {paths.PHASE, paths.DT_LIMIT}:
        inside = {step: row for step, row in rows(recorded, entity).items() if FIRST <= step <= LAST}
        assert repr(rows(cut, entity)) == repr(inside), entity  # NaN is NaN, here
    assert Recording.open(cut).fingerprints()["step"].to_pylist() == list(range(FIRST, LAST + 1))


def test_a_state_from_before_the_cut_holds_from_its_first_frame_on(recorded: Path, cut: Path) -> None:
    phases = Recording.open(cut).phases()
    assert phases["step"].to_pylist()[0] == FIRST
    assert phases["sim_time"].to_pylist()[0] == Recording.open(cut).fingerprints()["sim_time"].to_pylist()[0]
    assert phases["state"].to_pylist() == ["colliding"]
    limits = {row["StateChange:state"][0] for step, row in rows(recorded, paths.DT_LIMIT).items() if step <= FIRST}
    assert rows(cut, paths.DT_LIMIT)[FIRST]["StateChange:state"][0] in limits


def test_the_exact_state_before_the_cut_comes_with_it_whole(recorded: Path, cut: Path) -> None:
    before = max(step for step in rows(recorded, paths.CHECKPOINT) if step <= FIRST)
    assert before < FIRST
    start = static(cut, paths.START)
    assert start.pop("step") == [before]
    assert start == rows(recorded, paths.CHECKPOINT)[before]


def test_a_checkpoint_at_the_first_frame_is_the_start(recorded: Path, tmp_path: Path) -> None:
    step = next(step for step in Recording.open(recorded).checkpoint_steps if step)
    made = clip(recorded, tmp_path / "clip.rrd", step * 0.05 - 1e-9)
    assert made.first_step == made.replays_from == step
    assert static(tmp_path / "clip.rrd", paths.START)["step"] == [step]


def test_statics_properties_layout_and_name_are_kept(recorded: Path, cut: Path) -> None:
    whole, piece = Recording.open(recorded), Recording.open(cut)
    for entity in {e.entity_path for e in whole.store.entries if e.is_static}:
        assert static(cut, entity) == static(recorded, entity), entity
    assert piece.properties == whole.properties and piece.info == whole.info and piece.closing == whole.closing
    assert piece.store.application_id == whole.store.application_id
    assert piece.store.store_id != whole.store.store_id
    assert piece.finished
    assert layout(cut) == layout(recorded) != []
    assert piece.clip == {"source": "run.rrd", "recording_id": whole.store.store_id, "from": START, "to": END}


def test_the_summary_of_a_clip_is_about_the_clip(cut: Path, recorded: Path, tmp_path: Path) -> None:
    summary = Recording.open(cut).summary()
    assert (summary["frames"], summary["steps"], summary["clip"]["first_step"]) == (29, LAST, FIRST)
    assert summary["clip"]["bodies"] == list(range(60))
    assert summary["contacts"]["total"] < 1234, "that many had the whole run"
    assert summary["moments"] == {} and summary["profile"] == {}
    assert START <= Recording.open(cut).moment() <= END
    clip(recorded, tmp_path / "with.rrd", 1.0, 3.0)
    assert Recording.open(tmp_path / "with.rrd").summary()["moments"]["impact"]["step"] == 40
    assert Recording.open(tmp_path / "with.rrd").moment() == 2.0


def test_a_clip_of_a_clip_is_a_clip_of_the_run(recorded: Path, cut: Path, tmp_path: Path) -> None:
    clip(cut, tmp_path / "again.rrd", 48 * 0.05, 52 * 0.05)
    clip(recorded, tmp_path / "direct.rrd", 48 * 0.05, 52 * 0.05)
    again, direct = tmp_path / "again.rrd", tmp_path / "direct.rrd"
    assert Recording.open(again).clip["source"] == "clip.rrd"
    for entity in temporal(direct):
        assert repr(rows(again, entity)) == repr(rows(direct, entity)), entity
    assert static(again, paths.START) == static(direct, paths.START)


def frames_of(scripted: ScriptedRun) -> dict[int, Frame]:
    return {frame.step: frame for frame in scripted.frames(100)}


@pytest.mark.parametrize("box", [None, np.full(3, 11.0)])
def test_a_clip_of_a_few_bodies_shows_them_and_the_contacts_among_them(tmp_path: Path, box: Any) -> None:
    scripted, kept = ScriptedRun(60, box=box), list(range(0, 60, 2))
    frames = frames_of(scripted)
    with FrameRecorder(tmp_path / "run.rrd", scripted.header) as recorder:
        for frame in frames.values():
            recorder.put(frame)
        recorder.finish("completed")
    made = clip(tmp_path / "run.rrd", tmp_path / "few.rrd", START, END, bodies=kept)
    few = tmp_path / "few.rrd"
    assert made.bodies == kept == Recording.open(few).shown
    whole = rows(tmp_path / "run.rrd", paths.BODIES)
    for step, row in rows(few, paths.BODIES).items():
        for name, values in row.items():
            assert values == [whole[step][name][body] for body in kept]
    assert static(few, paths.BODIES)["Ellipsoids3D:labels"] == [scripted.header.names[body] for body in kept]
    assert len(static(few, paths.BODIES)["Ellipsoids3D:fill_mode"]) == 1
    edges = rows(few, paths.CONTACTS)
    for step in range(FIRST, LAST + 1):
        among = int(np.sum(np.all(np.isin(frames[step].contacts.pairs, kept), axis=1)))
        assert len(edges[step]["LineStrips3D:strips"]) == len(edges[step]["LineStrips3D:colors"]) == among
    assert any(row["LineStrips3D:strips"] for row in edges.values())
    arrows = rows(few, paths.TORQUE)
    for step in range(FIRST, LAST + 1):
        torque = frames[step].torque
        assert torque is not None
        assert arrows[step]["body"] == [body for body in kept if np.any(torque[body])]
        assert len(arrows[step]["Arrows3D:vectors"]) == len(arrows[step]["body"])


def test_contacts_with_planes_are_those_of_the_body(tmp_path: Path) -> None:
    scripted = ScriptedRun(20)

    def touching_a_plane(frame: Frame) -> Frame:
        graph = frame.contacts
        pairs = np.concatenate([graph.pairs, [[3, 20], [4, 20]]])
        normals = np.concatenate([graph.normals, [[0.0, 0.0, -1.0]] * 2])
        overlaps, colours = np.append(graph.overlaps, [0.01, 0.01]), np.append(graph.colours, [0, 0])
        return replace(frame, contacts=replace(graph, pairs=pairs, normals=normals, overlaps=overlaps, colours=colours))

    with FrameRecorder(tmp_path / "run.rrd", scripted.header) as recorder:
        for frame in scripted.frames(10):  # so early nobody touches another
            recorder.put(touching_a_plane(frame))
        recorder.finish("completed")
    clip(tmp_path / "run.rrd", tmp_path / "few.rrd", bodies=[3, 7])
    centres, lines = (rows(tmp_path / "few.rrd", path) for path in (paths.BODIES, paths.CONTACTS))
    for step in range(10):
        (line,) = lines[step]["LineStrips3D:strips"]
        assert line[0] == centres[step]["Ellipsoids3D:centers"][0]


def test_the_exact_states_of_a_clip_of_a_few_bodies_are_those_of_all(recorded: Path, tmp_path: Path) -> None:
    clip(recorded, tmp_path / "few.rrd", START, END, bodies=[3, 17])
    assert len(static(tmp_path / "few.rrd", paths.START)["position"]) == 3 * 60
    assert len(Recording.open(tmp_path / "few.rrd").bodies.name) == 60
    few = Recording.open(tmp_path / "few.rrd")
    assert all(len(state.position) == 60 for state in few.checkpoints())


def test_fewer_bodies_can_be_cut_out_of_a_few_by_their_own_numbers(recorded: Path, tmp_path: Path) -> None:
    clip(recorded, tmp_path / "few.rrd", START, END, bodies=[3, 17, 20])
    clip(tmp_path / "few.rrd", tmp_path / "one.rrd", bodies=[17])
    assert static(tmp_path / "one.rrd", paths.BODIES)["Ellipsoids3D:labels"] == ["body-17"]
    with pytest.raises(RecordingError, match=r"no body 5: it shows body 3 .*, body 17 .* and body 20 "):
        clip(tmp_path / "few.rrd", tmp_path / "none.rrd", bodies=[5])
    assert not (tmp_path / "none.rrd").exists()


@pytest.mark.parametrize(("start", "end"), [(100.0, 200.0), (-5.0, -1.0), (2.26, 2.29)])
def test_an_interval_without_a_frame_is_told_with_what_there_is(
    recorded: Path, tmp_path: Path, start: float, end: float
) -> None:
    with pytest.raises(RecordingError, match=r"no frame between .* it covers 0 to 4\.95 s with 100 frames"):
        clip(recorded, tmp_path / "clip.rrd", start, end)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_a_full_disk_leaves_the_clip_that_was_there(recorded: Path, tmp_path: Path) -> None:
    (tmp_path / "clip.rrd").write_bytes(b"the one before")
    code = f"""
import resource
from carom.recording.edit.clip import clip
from carom.errors import RecordingError
resource.setrlimit(resource.RLIMIT_FSIZE, (150_000, 150_000))
try:
    clip({str(recorded)!r}, {str(tmp_path / "clip.rrd")!r})
except RecordingError as error:
    print(error)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True)
    assert "cannot write" in done.stdout
    assert [path.read_bytes() for path in tmp_path.iterdir()] == [b"the one before"]


def test_a_run_that_was_killed_can_be_clipped(run_file: Path, tmp_path: Path) -> None:
    content = run_file.read_bytes()
    entry = Recording.open(run_file).store.entries[-1]
    run_file.write_bytes(content[: entry.offset + entry.length])  # without footer, and without layout
    made = clip(run_file, tmp_path / "clip.rrd", START, END)
    assert made.frames == 29 and Recording.open(tmp_path / "clip.rrd").finished


@pytest.mark.slow
def test_a_clip_of_one_per_cent_of_400_mb_takes_less_than_300_mb_of_memory(tmp_path: Path) -> None:
    scripted = ScriptedRun(2000)
    some = list(scripted.frames(24))
    with FrameRecorder(tmp_path / "long.rrd", scripted.header) as recorder:
        for step in range(7200):
            recorder.put(replace(some[step % 24], step=step, time=0.05 * step, events=()))
        recorder.finish("completed")
    assert (tmp_path / "long.rrd").stat().st_size > 400e6
    command = [sys.executable, "-m", "carom", "clip", "long.rrd", "--from", "150", "--to", "153.6"]
    # an intermediate process with this only child: the system reports the peak of the largest child
    code = f"import resource, subprocess; subprocess.run({command!r}, check=True, stdout=subprocess.DEVNULL)"
    code += "; print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)"
    between = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, check=True, capture_output=True, text=True)
    assert Recording.open(tmp_path / "long-clip.rrd").frames == 73, "both ends, though 0.05 s are rounded"
    assert int(between.stdout) < 300e3  # kB
