"""The sink writes whole messages, and drains its pipe whatever happens to the file."""

from __future__ import annotations

import errno
import fcntl
import subprocess
import sys
from pathlib import Path

import pytest

from carom.recording.read.recording import Recording
from carom.recording.rrd.framing import MESSAGE_HEADER, STREAM_HEADER
from carom.recording.write.durable_sink import DurableSink

LIMITED = """
import os, resource, sys
from pathlib import Path
from carom.recording.write.durable_sink import DurableSink
stream, size = Path(sys.argv[1]).read_bytes(), int(sys.argv[2])
resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))
sink = DurableSink(Path(sys.argv[3]), 0)
with open(sink.entry, "wb") as entry:
    sink.opened()
    entry.write(stream)
sink.close()
print(sink.error.strerror)
"""


def test_a_user_whose_pipes_may_grow_no_more_records_through_a_small_one(
    run_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*given: object) -> int:
        raise PermissionError(errno.EPERM, "too many pages in pipes")

    monkeypatch.setattr(fcntl, "fcntl", refuse)
    sink = DurableSink(tmp_path / "x.rrd", 0)
    with Path(sink.entry).open("wb") as entry:
        sink.opened()
        entry.write(run_file.read_bytes())
    sink.close()
    assert sink.error is None and (tmp_path / "x.rrd").read_bytes() == run_file.read_bytes()


@pytest.mark.parametrize("limit", [5_000, 1_500_000])
def test_after_a_write_that_failed_the_rest_of_the_pipe_is_drained(run_file: Path, tmp_path: Path, limit: int) -> None:
    content, entry = run_file.read_bytes(), Recording.open(run_file).store.entries[-1]
    message = content[entry.offset - MESSAGE_HEADER : entry.offset + entry.length]
    stream = tmp_path / "stream"
    stream.write_bytes(content[:STREAM_HEADER] + message * (5_000_000 // len(message)))  # the pipe holds 1 MB
    command = [sys.executable, "-c", LIMITED, str(stream), str(limit), str(tmp_path / "x.rrd")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "File too large\n", "")
    size = (tmp_path / "x.rrd").stat().st_size
    assert size <= limit and (size - STREAM_HEADER) % len(message) == 0, "whole messages"


CROWDED = """
import os, resource, sys
from pathlib import Path
from carom.recording.write.durable_sink import DurableSink
resource.setrlimit(resource.RLIMIT_NOFILE, (1200, 1200))
crowd = [os.open(os.devnull, os.O_RDONLY) for _ in range(1100)]
sink = DurableSink(Path(sys.argv[2]), 0)
with open(sink.entry, "wb") as entry:
    sink.opened()
    entry.write(Path(sys.argv[1]).read_bytes())
sink.close()
print(sink.error)
"""


def test_a_program_with_more_than_1024_open_files_records(run_file: Path, tmp_path: Path) -> None:
    command = [sys.executable, "-c", CROWDED, str(run_file), str(tmp_path / "x.rrd")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "None\n", "")
    assert (tmp_path / "x.rrd").read_bytes() == run_file.read_bytes()
