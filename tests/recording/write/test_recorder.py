import signal
import subprocess
import sys
import textwrap
import threading
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import rerun as rr
from rerun.chunk import RrdReader

import scripted_run
from carom.errors import DroppedRunWarning, RecordingError
from carom.physics.space import Space
from carom.recording.read.recording import Recording
from carom.recording.rrd.container import Container
from carom.recording.schema.header import TimeScale
from carom.recording.write import stream
from carom.recording.write.recorder import FrameRecorder
from carom.recording.write.rows import Index, Rows, plain_column
from carom.recording.write.stream import Stream
from carom.recording.write.whole_file import Claim, killed_run_of
from carom.runs.run import header_of
from carom.scene.load import Scene
from scripted_run import ScriptedRun

SUPPORT = str(Path(scripted_run.__file__).parent)


def record(path: Path, scripted: ScriptedRun, frames: int, outcome: str = "completed") -> FrameRecorder:
    with FrameRecorder(path, scripted.header) as recorder:
        for frame in scripted.frames(frames):
            recorder.put(frame)
        recorder.finish(outcome, {"contacts.total": 1234, "expect.energy_error": True})
    return recorder


def entities(path: Path) -> set[str]:
    return {chunk.entity_path for chunk in RrdReader(path).store().stream()}


def test_a_recording_holds_the_header_and_the_frames_that_were_put(tmp_path: Path, scripted: ScriptedRun) -> None:
    frames = list(scripted.frames(150))
    record(tmp_path / "run.rrd", scripted, 150)
    recording = Recording.open(tmp_path / "run.rrd")
    assert recording.frames == 150
    assert recording.title == scripted.header.title
    assert recording.scene_toml == scripted.header.scene_toml
    assert recording.properties == scripted.header.properties
    assert recording.outcome == "completed"
    bodies = recording.bodies
    assert bodies.name == scripted.header.names
    assert bodies.mass.tobytes() == scripted.header.mass.tobytes()
    prints = recording.fingerprints()
    assert prints["fingerprint"].to_pylist() == [frame.fingerprint for frame in frames]
    assert prints["time"].to_pylist() == [frame.time for frame in frames]
    energy = recording.energy()
    assert energy["total"].to_pylist() == [frame.energy.total for frame in frames]
    assert energy["friction"].to_pylist() == [frame.energy.ledger.friction for frame in frames]
    steps = recording.steps()
    assert steps["contacts"].to_pylist() == [len(frame.contacts.pairs) for frame in frames]
    assert steps["dt"].to_pylist() == [frame.dt for frame in frames]
    assert np.array_equal(np.stack(recording.momentum()["momentum"].to_numpy()), [f.momentum for f in frames])
    texts = recording.events()["text"].to_pylist()
    assert texts == [event.text for frame in frames for event in frame.events] + ["end: completed"]


def test_phases_have_rows_only_where_they_change(tmp_path: Path, scripted: ScriptedRun) -> None:
    record(tmp_path / "run.rrd", scripted, 150)
    phases = Recording.open(tmp_path / "run.rrd").phases()
    assert phases["step"].to_pylist() == [0, 20, 80, 100]
    assert phases["state"].to_pylist() == ["free", "colliding", "free", "colliding"]


def test_a_frame_without_contacts_clears_the_lines_of_the_one_before(tmp_path: Path, scripted: ScriptedRun) -> None:
    record(tmp_path / "run.rrd", scripted, 120)
    rows: dict[int, int] = {}
    for chunk in RrdReader(tmp_path / "run.rrd").store().stream().filter(content="/world/contacts", is_static=False):
        batch = chunk.to_record_batch()
        rows |= dict(zip(batch["step"].to_pylist(), map(len, batch["LineStrips3D:strips"]), strict=True))
    assert rows == {frame.step: len(frame.contacts.pairs) for frame in scripted.frames(120)}
    assert 0 in rows.values()


def test_across_a_periodic_boundary_lines_take_the_short_way(tmp_path: Path) -> None:
    scripted = ScriptedRun(30, box=np.full(3, 4.0))
    record(tmp_path / "run.rrd", scripted, 60)
    for chunk in RrdReader(tmp_path / "run.rrd").store().stream().filter(content="/world/contacts", is_static=False):
        for row in chunk.to_record_batch()["LineStrips3D:strips"].to_pylist():
            lines = np.array(row).reshape(-1, 2, 3)
            assert np.all(np.abs(lines[:, 1] - lines[:, 0]) <= 2.0001)


def test_a_part_that_a_scene_does_not_require_has_no_entity(tmp_path: Path) -> None:
    record(tmp_path / "all.rrd", ScriptedRun(5), 30)
    record(tmp_path / "few.rrd", ScriptedRun(5, spins=False, collides=False, forces=frozenset()), 30)
    missing = entities(tmp_path / "all.rrd") - entities(tmp_path / "few.rrd")
    assert missing >= {
        "/world/torque",
        "/world/angular_acceleration",
        "/world/contacts",
        "/energy/rotational",
        "/energy/gravitational",
        "/energy/ledger/friction",
        "/energy/ledger/restitution",
        "/energy/ledger/stabilisation",
        "/step/contacts",
    }
    assert not any(path.startswith("/energy/field") for path in entities(tmp_path / "all.rrd"))
    record(tmp_path / "none.rrd", ScriptedRun(5, stabilises=False), 30)
    assert entities(tmp_path / "all.rrd") - entities(tmp_path / "none.rrd") == {"/energy/ledger/stabilisation"}


@pytest.mark.parametrize(("bodies", "spins", "expected"), [(2001, True, "InstancePoses3D"), (2001, False, "Points3D")])
def test_many_bodies_are_drawn_as_what_a_viewer_can_afford(
    tmp_path: Path, bodies: int, spins: bool, expected: str
) -> None:
    record(tmp_path / "run.rrd", ScriptedRun(bodies, spins=spins), 3)
    stream = RrdReader(tmp_path / "run.rrd").store().stream().filter(content="/world/bodies", is_static=False)
    for chunk in stream:
        assert any(name.startswith(expected) for name in chunk.to_record_batch().schema.names)


def test_body_colours_follow_the_graph_where_the_scene_colours_bodies(tmp_path: Path) -> None:
    scripted = ScriptedRun(30, body_colouring=True)
    record(tmp_path / "run.rrd", scripted, 60)
    stream = RrdReader(tmp_path / "run.rrd").store().stream().filter(content="/world/bodies", is_static=False)
    colours = [row for chunk in stream for row in chunk.to_record_batch()["Ellipsoids3D:colors"].to_pylist()]
    assert len(set(colours[0])) == 1
    assert len(set(colours[-1])) > 1


def test_the_file_is_at_most_a_fifth_larger_than_what_is_in_it(tmp_path: Path) -> None:
    recorder = record(tmp_path / "run.rrd", ScriptedRun(300), 300)
    assert (tmp_path / "run.rrd").stat().st_size <= 1.2 * recorder.payload_bytes


def test_a_scene_of_billions_of_years_says_how_time_is_scaled(tmp_path: Path) -> None:
    scripted = ScriptedRun(5, duration=1e17)
    frames = [replace(frame, time=frame.time * 2e16) for frame in scripted.frames(20)]
    with FrameRecorder(tmp_path / "run.rrd", scripted.header) as recorder:
        for frame in frames:
            recorder.put(replace(frame, events=()))
        recorder.finish("completed")
    recording = Recording.open(tmp_path / "run.rrd")
    assert recording.info["time_scale"] == 1e8
    assert recording.fingerprints()["time"].to_pylist() == [frame.time for frame in frames]


def test_leaving_before_the_end_says_so_in_the_file(tmp_path: Path, scripted: ScriptedRun) -> None:
    with pytest.raises(ZeroDivisionError), FrameRecorder(tmp_path / "run.rrd", scripted.header) as recorder:
        for frame in scripted.frames(10):
            recorder.put(frame)
        raise ZeroDivisionError("the physics fell over")
    recording = Recording.open(tmp_path / "run.rrd")
    assert recording.frames == 10
    assert recording.outcome == "interrupted: ZeroDivisionError: the physics fell over"


def test_a_run_without_a_frame_is_still_a_recording(tmp_path: Path, scripted: ScriptedRun) -> None:
    with FrameRecorder(tmp_path / "run.rrd", scripted.header) as recorder:
        recorder.finish("failed before the first step")
    recording = Recording.open(tmp_path / "run.rrd")
    assert recording.frames == 0
    assert recording.outcome == "failed before the first step"


def test_a_folder_that_is_not_there_is_told_at_once(tmp_path: Path, scripted: ScriptedRun) -> None:
    with pytest.raises(RecordingError, match=r"cannot write .*No such file"):
        FrameRecorder(tmp_path / "missing" / "run.rrd", scripted.header)


def test_a_bad_frame_stops_the_physics_and_the_file_says_why(tmp_path: Path, scripted: ScriptedRun) -> None:
    frames = list(scripted.frames(3))
    bad = replace(frames[2], time=float("nan"))
    with FrameRecorder(tmp_path / "run.rrd", scripted.header) as recorder:
        recorder.put(frames[0])
        recorder.put(frames[1])
        recorder.put(bad)
        with pytest.raises(RecordingError, match="does not fit the timeline"):
            recorder.finish("completed")
        with pytest.raises(RecordingError):
            recorder.put(frames[2])
    assert "does not fit the timeline" in Recording.open(tmp_path / "run.rrd").outcome


def test_a_full_queue_holds_the_physics_and_drops_nothing(tmp_path: Path, scripted: ScriptedRun) -> None:
    with FrameRecorder(tmp_path / "run.rrd", scripted.header, queue_size=1) as recorder:
        producers = [threading.Thread(target=recorder.put, args=(frame,)) for frame in scripted.frames(40)]
        for producer in producers:
            producer.start()
        for producer in producers:
            producer.join()
        recorder.finish("completed")
    assert Recording.open(tmp_path / "run.rrd").frames == 40


def test_a_slow_recorder_with_three_slots_overwrites_no_frame_that_waits(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Stream, "flush", lambda self: time.sleep(0.005))
    scene = Scene.load("two-spheres", ["time.duration=0.1", "time.fixed_dt=0.01", "record.every=step"])
    space = Space(scene, threads=1)
    with FrameRecorder(tmp_path / "run.rrd", replace(header_of(space), exact=True), queue_size=1) as recorder:
        store = recorder.store_for(space.state)
        for frame in space.run(store=store):
            recorder.put(frame)
        recorder.finish("completed")
    assert store.slots == 3
    recording = Recording.open(tmp_path / "run.rrd")
    assert recording.frames == 11
    assert [state.step for state in recording.checkpoints()] == list(range(11)), "each has the fingerprint of its frame"


def test_joined_batches_hold_what_separate_ones_do(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def rows(path: Path) -> dict[tuple[str, str], list[tuple[int, str]]]:
        read: dict[tuple[str, str], list[tuple[int, str]]] = {}
        for chunk in RrdReader(path).store().stream().filter(is_static=False):
            batch = chunk.to_record_batch()
            for name in batch.schema.names:
                if not name.startswith("rerun.controls") and "step" in batch.schema.names:
                    values = zip(batch["step"].to_pylist(), map(str, batch[name].to_pylist()), strict=True)
                    read.setdefault((chunk.entity_path, name), []).extend(values)
        return {key: sorted(values, key=lambda row: row[0]) for key, values in read.items()}

    def chunks(path: Path) -> int:
        return sum(entry.rows > 0 and not entry.is_static for entry in Recording.open(path).store.entries)

    scripted = ScriptedRun(20)
    for name, prompt in {"joined": 2, "separate": 1000}.items():
        monkeypatch.setattr(stream, "PROMPT_BATCHES", prompt)
        monkeypatch.setattr(stream, "OF_TIME", 1e9)  # all that waits is written at the end
        with FrameRecorder(tmp_path / f"{name}.rrd", scripted.header, queue_size=10) as recorder:  # 5 frames a batch
            for frame in scripted.frames(120):
                recorder.put(frame)
            recorder.finish("completed")
    assert rows(tmp_path / "joined.rrd") == rows(tmp_path / "separate.rrd")
    assert chunks(tmp_path / "joined.rrd") < chunks(tmp_path / "separate.rrd") / 4, "24 batches, of which 22 are joined"


def test_batches_grow_in_number_with_the_logarithm_of_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    now, scripted, clock = 0, ScriptedRun(3), TimeScale()
    monkeypatch.setattr(stream, "monotonic", lambda: float(now))
    record = Stream(tmp_path / "run.rrd", scripted.header, batch_bytes=1000, live=None)
    for now in range(3000):  # s
        values = plain_column(rr.Scalars.descriptor_scalars(), np.array([float(now)]))
        record.send(Rows("energy/total", Index(np.array([now]), np.array([float(now)])), [values]), clock)
        record.flush()
    record.close()
    rows = [entry.rows for entry in Container.open(tmp_path / "run.rrd").stores[0].entries if not entry.is_static]
    assert sum(rows) == 3000
    # 100 as they come; then one for each hundredth of the time so far, within a batch
    assert len(rows) <= 100 + 100 * np.log(3000 / 100)
    assert max(rows) <= 0.01 * 3000 + 1


def test_rows_that_wait_are_written_though_no_frame_follows(
    tmp_path: Path, scripted: ScriptedRun, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(stream, "PROMPT_BATCHES", 0)
    monkeypatch.setattr(stream, "OF_TIME", 0.5)
    with FrameRecorder(tmp_path / "run.rrd", scripted.header) as recorder:
        recorder.put(next(iter(scripted.frames(1))))
        deadline = time.monotonic() + 30.0
        while not (frames := _frames_so_far(tmp_path / "run.rrd")) and time.monotonic() < deadline:
            time.sleep(0.1)
        recorder.finish("completed")
    assert frames == 1, "before the end"


def _frames_so_far(path: Path) -> int:
    try:
        return Recording.open(path).frames
    except RecordingError:  # a message is being written
        return 0


def test_an_earlier_recording_stays_until_the_new_one_is_whole(tmp_path: Path, scripted: ScriptedRun) -> None:
    path = tmp_path / "run.rrd"
    record(path, scripted, 5)
    path.chmod(0o600)
    before = path.read_bytes()
    with FrameRecorder(path, scripted.header) as recorder:
        for frame in scripted.frames(9):
            recorder.put(frame)
        assert path.read_bytes() == before
        recorder.finish("completed")
    assert Recording.open(path).frames == 9
    assert path.stat().st_mode & 0o777 == 0o600
    assert [file.name for file in tmp_path.iterdir()] == ["run.rrd"]


@pytest.mark.slow
def test_a_run_that_is_killed_leaves_the_recording_that_it_would_have_replaced(
    tmp_path: Path, scripted: ScriptedRun
) -> None:
    path = tmp_path / "run.rrd"
    record(path, scripted, 5)
    before = path.read_bytes()
    killed = child(path, each="if recorder.frames >= 400: time.sleep(1.0); os.kill(os.getpid(), 9)")
    assert killed.returncode == -signal.SIGKILL
    assert path.read_bytes() == before
    left = tmp_path / ".run.new.rrd"
    assert Recording.open(left).frames >= 100 and killed_run_of(path) == left
    with Claim(path):  # as a process that still writes it holds
        assert killed_run_of(path) is None
    with pytest.warns(DroppedRunWarning, match=r"^\.run\.new\.rrd, .* is replaced"):
        record(path, scripted, 6)
    assert [file.name for file in tmp_path.iterdir()] == ["run.rrd"]


def test_a_link_keeps_pointing_at_the_recording_that_was_replaced(tmp_path: Path, scripted: ScriptedRun) -> None:
    (tmp_path / "disk").mkdir()
    path, link = tmp_path / "disk" / "run.rrd", tmp_path / "link.rrd"
    record(path, scripted, 5)
    link.symlink_to(path)
    record(link, scripted, 7)
    assert link.is_symlink() and Recording.open(path).frames == 7


FORKED = """
import os, sys
from pathlib import Path
sys.path.insert(0, {tests!r})
from scripted_run import ScriptedRun
from carom.recording.read.recording import Recording
from carom.recording.write.recorder import FrameRecorder

def record(path):
    scripted = ScriptedRun(5)
    with FrameRecorder(path, scripted.header) as recorder:
        for frame in scripted.frames(50):
            recorder.put(frame)
        recorder.finish("completed")

folder = Path({folder!r})
record(folder / "parent.rrd")
if os.fork() == 0:
    record(folder / "child.rrd")
    os._exit(0)
sys.exit(os.waitstatus_to_exitcode(os.wait()[1]))
"""


@pytest.mark.slow
def test_a_program_that_forks_after_a_recording_records_in_the_child(tmp_path: Path) -> None:
    script = FORKED.format(tests=SUPPORT, folder=str(tmp_path))
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr
    assert Recording.open(tmp_path / "child.rrd").frames == 50


CHILD = """
import os, sys, time
from pathlib import Path
sys.path.insert(0, {tests!r})
from scripted_run import ScriptedRun
from carom.recording.write.recorder import FrameRecorder
from carom.errors import RecordingError
scripted = ScriptedRun(200)
path = Path({path!r})
{before}
recorder = FrameRecorder(path, scripted.header)
try:
    for frame in scripted.frames(2000):
        recorder.put(frame)
        {each}
except RecordingError as error:
    print("stopped at", frame.step, error, flush=True)
    try:
        recorder.finish("completed")
    except RecordingError:
        sys.exit(1)
"""


def child(path: Path, before: str = "", each: str = "pass") -> "subprocess.CompletedProcess[str]":
    script = textwrap.dedent(CHILD).format(tests=SUPPORT, path=str(path), before=before, each=each)
    return subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=60, check=False)


@pytest.mark.slow
def test_a_killed_run_leaves_what_was_written(tmp_path: Path) -> None:
    path = tmp_path / "run.rrd"
    # Frames count before they are in the file: it gets a moment for those, since one torn in a message needs repair.
    kill = "if recorder.frames >= 400: time.sleep(1.0); os.kill(os.getpid(), 9)"
    assert child(path, each=kill).returncode == -signal.SIGKILL
    recording = Recording.open(path)
    assert not recording.finished
    assert recording.frames >= 100
    assert recording.outcome.startswith("unfinished")
    assert recording.energy().num_rows == recording.frames
    assert 0 in recording.checkpoint_steps
    assert len(recording.bodies.name) == 200
    assert recording.summary()["outcome"].startswith("unfinished")


def assert_ended_by_a_full_disk(run: "subprocess.CompletedProcess[str]", path: Path) -> None:
    assert run.returncode == 1, run.stderr
    assert "no space left on the disk" in run.stdout
    recording = Recording.open(path)
    assert recording.finished
    assert "no space left on the disk" in recording.outcome
    assert recording.frames > 10
    assert recording.checkpoint(recording.checkpoint_steps[-1]).step == recording.frames - 1
    assert recording.events()["text"].to_pylist()[-1].startswith("end: disk: cannot write more")


@pytest.mark.slow  # not for its time: mounting a disk needs root, which CI is; the limit below is for everybody
def test_a_full_disk_leaves_a_readable_file(tmp_path: Path) -> None:
    subprocess.run(["mount", "-t", "tmpfs", "-o", "size=12m", "tmpfs", tmp_path], check=True)
    try:
        path = tmp_path / "run.rrd"
        assert_ended_by_a_full_disk(child(path), path)
    finally:
        subprocess.run(["umount", tmp_path], check=True)


@pytest.mark.slow
def test_a_limit_on_the_size_of_files_leaves_a_readable_file(tmp_path: Path) -> None:
    path = tmp_path / "run.rrd"
    limit = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (9_000_000, 9_000_000))"
    assert_ended_by_a_full_disk(child(path, before=limit), path)


@pytest.mark.slow
def test_a_disk_that_fails_in_the_middle_of_a_message_leaves_whole_messages(tmp_path: Path) -> None:
    path = tmp_path / "run.rrd"
    fail = """
import errno
from carom.recording.write import durable_sink
write = os.write
def fails(descriptor, data):
    if len(data) > 100_000 and os.fstat(descriptor).st_size > 5_000_000:
        write(descriptor, data[:50_000])
        raise OSError(errno.EIO, "Input/output error")
    return write(descriptor, data)
durable_sink.os.write = fails
"""
    run = child(path, before=fail)
    assert run.returncode == 1, run.stderr
    assert "Input/output error" in run.stdout
    assert Recording.open(path).frames > 10


def test_recordings_that_are_closed_keep_no_threads(tmp_path: Path, scripted: ScriptedRun) -> None:
    if not Path("/proc/self/task").exists():
        pytest.skip("threads that are not Python's are counted in /proc")
    counts = []
    for number in range(6):
        record(tmp_path / f"{number}.rrd", scripted, 20)
        counts.append(len(list(Path("/proc/self/task").iterdir())))
    assert counts[-1] == counts[1]  # the streams of the one before may still be there
