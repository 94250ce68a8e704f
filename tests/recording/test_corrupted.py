import os
import subprocess
import sys
from pathlib import Path

import pytest

from carom.recording.write.recorder import Recorder
from merry import Merry

AT_ONCE = 100  # files a process: Rerun keeps some 2 MB of every stream that wrote one


@pytest.mark.parametrize(
    ("part", "count"), [(0, 20), *(pytest.param(part, AT_ONCE, marks=pytest.mark.slow) for part in range(10))]
)
def test_damaged_files_are_refused_or_saved_without_a_traceback_a_hang_or_a_gigabyte(
    part: int, count: int, seed: int, tmp_path: Path
) -> None:
    merry, seed = Merry(20), seed + part
    with Recorder(tmp_path / "run.rrd", merry.header) as recorder:
        for frame in merry.frames(100):
            recorder.put(frame)
        recorder.finish("completed")
    program = Path(__file__).with_name("corrupted.py")
    command = [sys.executable, str(program), str(tmp_path / "run.rrd"), str(tmp_path), str(seed), str(count)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    *told, end = done.stdout.splitlines()
    assert done.returncode == 0, f"seed {seed}, {end}: {done.stderr}"
    assert "panicked" not in done.stderr and "Traceback" not in done.stderr
    assert len(told) == count
    assert int(end.removeprefix("end ")) < 1000  # MB; 230 of it are the libraries


@pytest.mark.parametrize("count", [12, pytest.param(250, marks=pytest.mark.slow)])
def test_rows_of_another_kind_are_refused_or_shown_without_a_traceback_a_hang_or_a_gigabyte(
    count: int, seed: int, tmp_path: Path
) -> None:
    merry = Merry(20)
    moment = {f"moments.impact.{key}": value for key, value in {"value": 3.0, "step": 40, "time": 2.0}.items()}
    with Recorder(tmp_path / "run.rrd", merry.header) as recorder:
        for frame in merry.frames(100):
            recorder.put(frame)
        recorder.finish("completed", {"contacts.total": 1234, "profile.gravity": 0.5, **moment})
    program = Path(__file__).with_name("mutants.py")
    command = [sys.executable, str(program), str(tmp_path / "run.rrd"), str(tmp_path), str(seed), str(count)]
    environment = {**os.environ, "PYTHONPATH": str(program.parent.parent)}
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
    end = (done.stdout.splitlines() or ["nothing"])[-1]
    assert done.returncode == 0 and end.startswith("end"), f"seed {seed}, {end}: {done.stderr}"
    assert "panicked" not in done.stderr and "Traceback" not in done.stderr
    assert int(end.removeprefix("end ")) < 1000  # MB; 230 of it are the libraries
