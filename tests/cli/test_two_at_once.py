"""Two commands write one file: the second is refused at its start, and the first completes its file."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from carom.recording.read.recording import Recording
from carom_command import carom, carom_process

LONG = ("--set", "time.duration=1e5")


@contextmanager
def under_way(*arguments: str, cwd: Path, grows: str, size: int = 100_000) -> Iterator[subprocess.Popen[str]]:
    """Start the command and wait until a file that it writes has more than this number of bytes."""
    process = subprocess.Popen(
        [sys.executable, "-m", "carom", *arguments],
        cwd=cwd,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )
    deadline = time.monotonic() + 120
    while not ((cwd / grows).exists() and (cwd / grows).stat().st_size > size):
        assert process.poll() is None and time.monotonic() < deadline
        time.sleep(0.05)
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


@pytest.mark.slow
def test_a_second_run_into_the_file_of_a_first_is_refused_even_with_force(tmp_path: Path) -> None:
    with under_way("run", "elastic-gas", *LONG, "-o", "x.rrd", cwd=tmp_path, grows="x.rrd") as first:
        second = carom("run", "two-spheres", "-o", "x.rrd", "--force", cwd=tmp_path)
        assert second.returncode == 2
        assert (
            second.stderr
            == "carom: x.rrd: another carom process is writing it; wait for its end, or name another file\n"
        )
        first.send_signal(signal.SIGINT)
        first.communicate(timeout=60)
    recording = Recording.open(tmp_path / "x.rrd")
    assert recording.outcome.startswith("interrupted") and recording.info["bodies"] > 2
    assert [path.name for path in tmp_path.iterdir()] == ["x.rrd"]


@pytest.mark.slow
def test_of_two_runs_started_together_one_records_and_one_is_refused(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "carom", "run", "elastic-gas", "--set", "time.duration=2", "-o", "x.rrd"]
    pair = [
        subprocess.Popen(command, cwd=tmp_path, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL) for _ in range(2)
    ]
    said = [process.communicate(timeout=120)[1].decode() for process in pair]
    assert sorted(process.returncode for process in pair) == [0, 2], said
    assert Recording.open(tmp_path / "x.rrd").outcome == "completed"


@pytest.mark.slow
def test_a_resumed_recording_survives_a_second_resume_and_a_killed_one(tmp_path: Path) -> None:
    run = tmp_path / "x.rrd"
    assert carom("run", "elastic-gas", "--set", "time.duration=1", "-o", "x.rrd", cwd=tmp_path).returncode == 0
    before = run.read_bytes()
    with under_way("resume", "x.rrd", "--until", "1e5", cwd=tmp_path, grows="x.resumed.rrd"):
        second = carom("resume", "x.rrd", "--until", "2", cwd=tmp_path)
        assert second.returncode == 2 and "another carom process is writing it" in second.stderr
        clipped = carom("clip", "x.rrd", "--to", "0.5", "-o", "x.resumed.rrd", "--force", cwd=tmp_path)
        assert clipped.returncode == 2 and "another carom process is writing it" in clipped.stderr
    assert run.read_bytes() == before

    left = (tmp_path / "x.resumed.rrd").read_bytes()
    again = carom("resume", "x.rrd", "--until", "2", cwd=tmp_path)
    assert again.returncode == 2 and "x.resumed.rrd: exists; give --force" in again.stderr
    assert (tmp_path / "x.resumed.rrd").read_bytes() == left and run.read_bytes() == before
    assert carom("resume", "x.rrd", "--until", "2", "--force", cwd=tmp_path).returncode == 0
    assert Recording.open(run).summary()["sim_time"] == 2.0
    assert [path.name for path in tmp_path.iterdir()] == ["x.rrd"]


@pytest.mark.slow
def test_a_full_disk_during_a_resume_leaves_the_recording_as_it_was(tmp_path: Path) -> None:
    run = tmp_path / "x.rrd"
    assert carom("run", "elastic-gas", "--set", "time.duration=1", "-o", "x.rrd", cwd=tmp_path).returncode == 0
    before = run.read_bytes()
    done = carom_process("resume", "x.rrd", "--until", "1e5", cwd=tmp_path, limit=8_000_000)
    assert done.returncode == 1 and "x.rrd is unchanged, and x.resumed.rrd has the new frames" in done.stderr
    assert run.read_bytes() == before
    assert Recording.open(tmp_path / "x.resumed.rrd").frames > Recording.open(run).frames


def test_a_recording_is_not_resumed_onto_itself_under_its_temporary_name(tmp_path: Path) -> None:
    assert carom("run", "two-spheres", "-o", "x.resumed.rrd", cwd=tmp_path).returncode == 0
    before = (tmp_path / "x.resumed.rrd").read_bytes()
    done = carom("resume", "x.resumed.rrd", "--until", "5", "-o", "x.rrd", "--force", cwd=tmp_path)
    assert done.returncode == 2 and "name another file" in done.stderr
    assert (tmp_path / "x.resumed.rrd").read_bytes() == before


@pytest.mark.slow
def test_a_killed_run_with_force_is_mentioned_resumed_or_dropped_with_a_word(tmp_path: Path) -> None:
    run, left = tmp_path / "x.rrd", tmp_path / ".x.new.rrd"
    assert carom("run", "two-spheres", "-o", "x.rrd", cwd=tmp_path).returncode == 0
    before = run.read_bytes()
    again = ("run", "elastic-gas", *LONG, "--set", "record.every=step", "-o", "x.rrd", "--force")
    with under_way(*again, cwd=tmp_path, grows=left.name, size=9_000_000):  # after the first batch
        assert ".x.new.rrd" not in carom("inspect", "x.rrd", cwd=tmp_path).stderr  # it is not lost yet
    for asked in ("inspect", "repair", "resume"):
        told = carom(asked, "x.rrd", cwd=tmp_path).stderr
        assert told.startswith("carom: .x.new.rrd: a later run of x.rrd, which was killed; `carom resume ")
    assert run.read_bytes() == before
    kept = tmp_path / "kept.new.rrd"
    kept.write_bytes(left.read_bytes())
    done = carom("run", "two-spheres", "-o", "x.rrd", "--force", cwd=tmp_path)
    assert "carom: .x.new.rrd, the file of a run that was killed, is replaced" in done.stderr and not left.exists()
    left.write_bytes(kept.read_bytes())  # the advice that was given
    # The kill may have torn the last message, so the test reads a repaired copy.
    assert carom("repair", kept.name, "-o", "read.rrd", cwd=tmp_path).returncode == 0
    until = str(max(Recording.open(tmp_path / "read.rrd").fingerprints()["time"].to_pylist()) + 0.1)
    resumed = carom("resume", ".x.new.rrd", "--until", until, "-o", "x.rrd", "--force", cwd=tmp_path)
    assert resumed.returncode == 0 and Recording.open(run).info["bodies"] > 2, resumed.stderr
