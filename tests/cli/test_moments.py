"""A moment that is asked for must be in the recording."""

from __future__ import annotations

from pathlib import Path

import pytest

from command import carom


@pytest.mark.parametrize("command", ["picture", "view", "report"])
def test_a_moment_outside_the_recording_is_refused_with_what_it_covers(
    run_file: Path, tmp_path: Path, command: str
) -> None:
    done = carom(command, "run.rrd", "--at", "5.2", cwd=tmp_path)
    assert done.returncode == 2 and done.stderr == "carom: run.rrd goes from 0 to 4.95 s, 5.2 s is not in it\n"
    assert list(tmp_path.iterdir()) == [run_file]


@pytest.mark.parametrize(
    "arguments",
    [
        ["picture", "--at", "nan"],
        ["report", "--at", "soon"],
        ["clip", "--around", "nan", "--window", "1"],
        ["replay", "--from", "nan"],
        ["resume", "--until", "nan"],
    ],
)
def test_an_argument_that_is_not_a_time_is_refused(run_file: Path, tmp_path: Path, arguments: list[str]) -> None:
    command, *options = arguments
    done = carom(command, "run.rrd", *options, cwd=tmp_path)
    assert done.returncode == 2 and "expected a time" in " ".join(done.stderr.split())
    assert list(tmp_path.iterdir()) == [run_file]
