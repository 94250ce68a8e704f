"""One program writes a file at a time."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from carom.errors import RecordingError
from carom.recording.write.chunk_writer import Writer
from carom.recording.write.whole_file import Claim


def test_a_second_claim_of_a_file_is_refused_until_the_first_is_released(tmp_path: Path) -> None:
    with Claim(tmp_path / "x.rrd"), pytest.raises(RecordingError, match=r"x\.rrd: another carom process is writing it"):
        Claim(tmp_path / "x.rrd")
    with Claim(tmp_path / "x.rrd"):
        pass
    assert list(tmp_path.iterdir()) == []


def test_a_file_has_one_claim_under_all_its_paths(tmp_path: Path) -> None:
    (tmp_path / "link.rrd").symlink_to("x.rrd")
    with Claim(tmp_path / "x.rrd"), pytest.raises(RecordingError, match="another carom"):
        Claim(tmp_path / "link.rrd")


def test_a_killed_process_leaves_no_claim(tmp_path: Path) -> None:
    code = f"""
import time; from pathlib import Path; from carom.recording.write.whole_file import Claim
with Claim(Path({str(tmp_path / "x.rrd")!r})):
    print("claimed", flush=True); time.sleep(100)
"""
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None and process.stdout.readline() == "claimed\n"
    with pytest.raises(RecordingError, match="another carom"):
        Claim(tmp_path / "x.rrd")
    process.send_signal(signal.SIGKILL)
    process.communicate()
    with Claim(tmp_path / "x.rrd"):
        pass
    assert list(tmp_path.iterdir()) == []


def test_of_many_that_claim_at_once_no_two_have_it(tmp_path: Path) -> None:
    inside, most, done = 0, 0, 0
    turn = threading.Lock()

    def claim_often() -> None:
        nonlocal inside, most, done
        for _ in range(300):
            try:
                with Claim(tmp_path / "x.rrd"):
                    with turn:
                        inside += 1
                        most, done = max(most, inside), done + 1
                    with turn:
                        inside -= 1
            except RecordingError:
                pass

    threads = [threading.Thread(target=claim_often) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert most == 1 and done > 0


def test_a_clip_onto_a_file_that_is_being_written_is_refused(tmp_path: Path) -> None:
    with Claim(tmp_path / "x.rrd"), pytest.raises(RecordingError, match="another carom"):
        Writer(tmp_path / "x.rrd", "carom-1", "id")
    with pytest.raises(RecordingError, match="cannot write"):
        Writer(tmp_path / "nowhere" / "x.rrd", "carom-1", "id")
    assert list(tmp_path.iterdir()) == []
