import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from carom.errors import RecordingError
from carom.recording.edit.repair import new_layout, repair
from carom.recording.read.recording import Recording
from carom.recording.rrd.container import Container
from carom.recording.rrd.framing import END, MESSAGE_HEADER, messages
from carom.recording.schema import paths
from carom.recording.schema.header import TimeScale
from carom.recording.write.recorder import FrameRecorder
from carom.recording.write.stream import Stream
from carom.runs.replay import replay
from edited_recordings import changed, mapped
from scripted_run import ScriptedRun


def without_footer(path: Path) -> int:
    """Leave out the footer; return the size of the rest."""
    with path.open("rb") as file:
        end = next(message for message in messages(file) if message.kind == END)
    os.truncate(path, end.offset - MESSAGE_HEADER)
    return end.offset - MESSAGE_HEADER


def flip(path: Path, at: int, count: int = 8) -> None:
    content = bytearray(path.read_bytes())
    content[at : at + count] = bytes(byte ^ 0x5A for byte in content[at : at + count])
    path.write_bytes(content)


def entry(path: Path, entity: str) -> tuple[int, int]:
    """Find where the first chunk of an entity lies, and its length."""
    found = next(e for e in Container.open(path).stores[0].entries if e.entity_path == entity and not e.is_static)
    return found.offset, found.length


def test_a_whole_file_needs_no_repair(recorded: Path, tmp_path: Path) -> None:
    assert repair(recorded, tmp_path / "fixed.rrd").path is None
    assert list(tmp_path.iterdir()) == []


def test_a_file_without_its_footer_gets_one_and_loses_nothing(run_file: Path, recorded: Path, tmp_path: Path) -> None:
    without_footer(run_file)
    assert "carom repair" in Recording.open(run_file).outcome or Recording.open(run_file).closing
    done = repair(run_file, tmp_path / "fixed.rrd")
    assert (done.frames, done.last_step, done.lost, done.added) == (100, 99, [], ["footer"])
    fixed, whole = Recording.open(tmp_path / "fixed.rrd"), Recording.open(recorded)
    assert fixed.finished
    assert fixed.fingerprints().equals(whole.fingerprints())
    assert fixed.energy().equals(whole.energy()) and fixed.steps().equals(whole.steps())
    assert fixed.checkpoint_steps == whole.checkpoint_steps
    assert fixed.outcome == "completed; repaired, to t = 4.95 s (step 99)"
    assert fixed.closing["contacts.total"] == 1234
    assert len(fixed.layout()) == len(whole.layout()) > 0


@pytest.mark.parametrize("cut", [1, 31, 32, 500])
def test_a_file_that_lost_a_part_of_its_footer_loses_nothing_else(cut: int, run_file: Path, tmp_path: Path) -> None:
    os.truncate(run_file, run_file.stat().st_size - cut)
    done = repair(run_file, tmp_path / "fixed.rrd")
    assert (done.frames, done.lost, done.added) == (100, [], ["footer"])


@pytest.mark.parametrize("count", [1, 700])
def test_of_a_file_with_bytes_after_its_end_only_these_are_lost(count: int, run_file: Path, tmp_path: Path) -> None:
    run_file.write_bytes(run_file.read_bytes() + os.urandom(count))
    done = repair(run_file, tmp_path / "fixed.rrd")
    assert done.frames == 100
    (lost,) = done.lost
    assert lost.startswith(f"the last {count} byte") and lost.endswith("(bytes after its end)")


@pytest.mark.parametrize("part", [0.3, 0.6, 0.9])
def test_a_file_torn_inside_a_message_keeps_everything_before(
    part: float, run_file: Path, recorded: Path, tmp_path: Path
) -> None:
    size = without_footer(run_file)
    os.truncate(run_file, int(part * size))
    with pytest.raises(RecordingError, match=r"ends inside a message\); `carom repair .*run\.rrd` recovers"):
        Recording.open(run_file)
    done = repair(run_file, tmp_path / "fixed.rrd")
    assert [piece.split(" (")[1] for piece in done.lost] == ["it ends inside a message)"]
    fixed = Container.open(tmp_path / "fixed.rrd").stores[0]
    kept = [e for e in Container.open(recorded).stores[0].entries if e.offset + e.length <= int(part * size)]
    names = [e.entity_path for e in kept]
    assert [e.entity_path for e in fixed.entries][: len(names)] == names
    outcome = Recording.open(tmp_path / "fixed.rrd").outcome
    assert "1 piece lost: the last" in outcome
    whole = any(
        name == "__properties/outcome" for name in names
    )  # sent at the end, but now before the layout, now after it
    assert outcome.startswith(
        "completed; repaired, " if whole else "unfinished: the run was killed, or its end is lost; "
    )


def test_a_layout_is_made_where_there_was_none(run_file: Path, tmp_path: Path) -> None:
    layouts = Container.open(run_file).stores[1].entries
    content = run_file.read_bytes()
    cut = layouts[0].offset - MESSAGE_HEADER
    run_file.write_bytes(content[:cut])
    done = repair(run_file, tmp_path / "fixed.rrd")
    assert done.added == ["footer", "layout"]
    paths = {chunk.entity_path for chunk in Recording.open(tmp_path / "fixed.rrd").layout()}
    assert "viewport" in paths and sum(path.startswith("view/") for path in paths) > 10


def test_wrong_bytes_in_the_middle_cost_one_chunk_which_is_named(run_file: Path, tmp_path: Path) -> None:
    entries = Container.open(run_file).stores[0].entries
    gone = next(e for e in entries if e.entity_path == "energy/total" and not e.is_static)
    flip(run_file, gone.offset + gone.length // 2)
    done = repair(run_file, tmp_path / "fixed.rrd")
    assert done.lost == [f"/energy/total of steps 0 to {gone.last_step}"]
    fixed = Recording.open(tmp_path / "fixed.rrd")
    assert fixed.frames == 100 and fixed.steps().num_rows == 100
    assert f"1 piece lost: {done.lost[0]}" in fixed.outcome


def test_messages_after_a_wrong_length_are_found_again(run_file: Path, tmp_path: Path) -> None:
    offset, length = entry(run_file, "energy/total")
    without_footer(run_file)
    flip(run_file, offset - 8)
    done = repair(run_file, tmp_path / "fixed.rrd")
    assert len(done.lost) == 1 and done.lost[0].startswith(f"{length + MESSAGE_HEADER} bytes at byte")
    assert Recording.open(tmp_path / "fixed.rrd").frames == 100


def test_frames_of_which_a_piece_is_lost_are_left_out_of_the_table_and_not_misplaced(tmp_path: Path) -> None:
    scripted = ScriptedRun(5)
    frames = list(scripted.frames(9))
    with FrameRecorder(tmp_path / "run.rrd", scripted.header, queue_size=6) as recorder:  # 3 frames a batch
        for frame in frames:
            recorder.put(frame)
        recorder.finish("completed")
    entries = [e for e in Recording.open(tmp_path / "run.rrd").store.entries if e.entity_path == "energy/total"]
    gone = next(e for e in entries if not e.is_static and e.first_step)
    flip(tmp_path / "run.rrd", gone.offset + gone.length // 2)
    done = repair(tmp_path / "run.rrd", tmp_path / "fixed.rrd")
    assert done.lost == [f"/energy/total of steps {gone.first_step} to {gone.last_step}"]
    energy = Recording.open(tmp_path / "fixed.rrd").energy()
    assert 0 < energy.num_rows < 9
    for step, total, other in zip(energy["step"], energy["total"], energy["translational"], strict=True):
        assert total.as_py() == frames[step.as_py()].energy.total
        assert other.as_py() == frames[step.as_py()].energy.translational


@pytest.fixture
def batches(tmp_path: Path) -> Path:
    """A run of 5 bodies and 9 frames, 3 frames a batch."""
    scripted, path = ScriptedRun(5), tmp_path / "run.rrd"
    with FrameRecorder(path, scripted.header, queue_size=6) as recorder:
        for frame in scripted.frames(9):
            recorder.put(frame)
        recorder.finish("completed")
    return path


@pytest.mark.parametrize("footer", [False, True])
def test_wrong_times_of_a_few_frames_cost_no_others(batches: Path, tmp_path: Path, footer: bool) -> None:
    changed(batches, batches, paths.FINGERPRINT, mapped("time", lambda row: [np.nan]), every=False, footer=footer)
    done = repair(batches, tmp_path / "fixed.rrd")
    assert done.lost == ["/state/fingerprint of steps 6 to 8 (times that do not increase)"]
    assert (done.frames, done.last_step) == (6, 5)
    assert Recording.open(tmp_path / "fixed.rrd").fingerprints()["step"].to_pylist() == [0, 1, 2, 3, 4, 5]


def test_frames_whose_times_contradict_each_other_are_refused_and_leave_no_file(batches: Path, tmp_path: Path) -> None:
    changed(batches, batches, paths.FINGERPRINT, mapped("time", lambda row: [0.0]), every=False)
    with pytest.raises(RecordingError, match=r"nothing of .*run\.rrd can be recovered: its frames have times"):
        repair(batches, tmp_path / "fixed.rrd")
    assert not (tmp_path / "fixed.rrd").exists()


def test_a_repaired_file_needs_no_repair(run_file: Path, tmp_path: Path) -> None:
    without_footer(run_file)
    repair(run_file, tmp_path / "fixed.rrd")
    assert repair(tmp_path / "fixed.rrd", tmp_path / "again.rrd").path is None


@pytest.mark.parametrize("begun", [False, True])
def test_a_run_killed_before_its_first_frame_is_refused_or_repaired_into_what_can_be_inspected(
    begun: bool, tmp_path: Path
) -> None:
    torn, fixed = tmp_path / "torn.rrd", tmp_path / "fixed.rrd"
    stream = Stream(tmp_path / "run.rrd", ScriptedRun(5).header, batch_bytes=1000, live=None)
    if begun:
        stream.send_statics(TimeScale(), np.zeros(3), 1.0)
    stream.flush()
    shutil.copy(tmp_path / "run.rrd", torn)
    stream.close()
    if begun:
        assert repair(torn, fixed).frames == 0
        assert Recording.open(fixed).summary()["outcome"].endswith("repaired, without a frame")
        with pytest.raises(RecordingError, match=r"fixed\.rrd holds no frame"):
            replay(Recording.open(fixed))
    else:
        with pytest.raises(RecordingError, match=r"torn\.rrd has nothing to save: its run ended before"):
            repair(torn, fixed)
        assert not fixed.exists()


@pytest.mark.parametrize("content", [b"", b"title = 'a scene'\n" * 1000, b"RRF2" + bytes(500), b"\x8f" * 100_000])
def test_a_file_that_is_not_a_recording_cannot_be_repaired(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "scene.toml").write_bytes(content)
    with pytest.raises(RecordingError, match=r"nothing of .*scene\.toml can be read as a recording"):
        repair(tmp_path / "scene.toml", tmp_path / "fixed.rrd")
    assert not (tmp_path / "fixed.rrd").exists()


@pytest.mark.slow
def test_a_file_full_of_beginnings_does_not_take_for_ever(tmp_path: Path) -> None:
    # Every 17 bytes something that looks like a message over half of the file: 100 000 candidates.
    size = 1_700_000
    message = (2).to_bytes(8, "little") + (size // 2).to_bytes(8, "little") + b"\n"
    (tmp_path / "trap.rrd").write_bytes(b"RRF2\x00)\x00\x00\x01\x02\x00\x00" + message * (size // len(message)))
    code = f"""
import resource
from carom.recording.edit.repair import repair
resource.setrlimit(resource.RLIMIT_CPU, (20, 20))  # 15 minutes, if every one of them were read
try:
    repair({str(tmp_path / "trap.rrd")!r}, {str(tmp_path / "fixed.rrd")!r})
except Exception as error:
    print(error)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "nothing of" in done.stdout


def test_a_layout_is_made_where_a_wrong_byte_has_renamed_the_centres(
    run_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(paths, "CENTRES", ("Ellipsoids3D:cent_rs",))
    assert new_layout(Recording.open(run_file)) is not None
