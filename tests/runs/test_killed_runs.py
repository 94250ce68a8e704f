"""A command that is killed between any two messages leaves a recording that replays, also once it is repaired."""

from __future__ import annotations

from pathlib import Path

import pytest

import carom
from carom.errors import RecordingError
from carom.recording.edit.clip import clip
from carom.recording.edit.repair import repair
from carom.recording.read.recording import Recording
from carom.recording.rrd.framing import END, messages
from carom.recording.write import recorder
from carom.runs.replay import Replay, replay
from carom.runs.resume import resume
from carom.scene.load import Scene


def judged(path: Path) -> Replay | str:
    """Replay a recording; for one without a frame or a state to begin with, say so."""
    try:
        recording = Recording.open(path)
        return replay(recording) if recording.frames else "no frame"
    except RecordingError as error:
        assert "checkpoint" in str(error) or "first frame" in str(error), str(error)
        return "no state"


def cuts_of(path: Path) -> list[int]:
    """Return the offsets between two messages of a recording, without those of its end."""
    with path.open("rb") as file:
        return [message.end for message in messages(file) if message.kind != END]


@pytest.fixture(scope="module")
def killed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[int]]:
    """A run of several batches with impacts, and the offsets between two messages, without those of its end."""
    path = tmp_path_factory.mktemp("killed") / "run.rrd"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(recorder, "_BATCH_FRAMES", 3)
        carom.run(Scene.load("rack-break", ["time.duration=0.03", "record.every=0.003"]), path)
    return path, cuts_of(path)


def derived(run: Path, kind: str) -> tuple[Path, list[int]]:
    """Return a recording made of another one, and the offsets between two of its messages."""
    path = run.with_name(f"{kind}.rrd")
    if not path.exists():
        match kind:
            case "clip":
                clip(run, path, 0.0, 0.02)
            case "clip-of-bodies":
                clip(run, path, 0.005, 0.02, [0, 3, 5])
            case "resumed":
                clip(run, run.with_name("start.rrd"), 0.0, 0.015)
                resume(run.with_name("start.rrd"), path=path)
            case _:
                content, cuts = run.read_bytes(), cuts_of(run)
                run.with_name("cut.rrd").write_bytes(content[: cuts[2 * len(cuts) // 3]])
                repair(run.with_name("cut.rrd"), path)
    return path, cuts_of(path)


def check(killed: tuple[Path, list[int]], places: range, folder: Path) -> None:
    content, cuts = killed[0].read_bytes(), killed[1]
    for place in places:
        path = folder / "cut.rrd"
        path.write_bytes(content[: cuts[place]])
        two: Replay | str = "no frame"
        one = judged(path)
        try:
            repair(path, folder / "fixed.rrd")
        except RecordingError as error:
            assert "nothing" in str(error), "not even the data of the first frame"
        else:
            two = judged(folder / "fixed.rrd")
            (folder / "fixed.rrd").unlink()
        for result in (one, two):
            assert isinstance(result, str) or result.same, f"cut after message {place}: {result.difference}"
        frames = [result if isinstance(result, str) else result.frames for result in (one, two)]
        assert frames[0] == frames[1], f"cut after message {place}"


def test_a_run_killed_within_its_last_batch_and_its_repaired_copy_are_not_called_altered(
    killed: tuple[Path, list[int]], tmp_path: Path
) -> None:
    check(killed, range(len(killed[1]) - 70, len(killed[1]), 25), tmp_path)


@pytest.mark.nightly
@pytest.mark.slow
def test_a_run_killed_after_any_message_and_its_repaired_copy_are_not_called_altered(
    killed: tuple[Path, list[int]], tmp_path: Path
) -> None:
    check(killed, range(len(killed[1])), tmp_path)


DERIVED = ("clip", "clip-of-bodies", "resumed", "repaired")


@pytest.mark.parametrize("kind", DERIVED)
def test_what_a_killed_command_copied_is_not_called_altered(
    killed: tuple[Path, list[int]], tmp_path: Path, kind: str
) -> None:
    made = derived(killed[0], kind)
    check(made, range(len(made[1]) - 1, 0, -40), tmp_path)


@pytest.mark.nightly
@pytest.mark.slow
@pytest.mark.parametrize("kind", DERIVED)
def test_what_a_command_killed_after_any_message_copied_is_not_called_altered(
    killed: tuple[Path, list[int]], tmp_path: Path, kind: str
) -> None:
    made = derived(killed[0], kind)
    check(made, range(len(made[1])), tmp_path)
