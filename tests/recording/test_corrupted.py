import subprocess
import sys
from pathlib import Path

import pytest

from carom.recording.recorder import Recorder
from merry import Merry

AT_ONCE = 100  # files a process: Rerun keeps some 2 MB of every stream that wrote one


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(1, 10))])
def test_damaged_files_are_refused_or_saved_without_a_traceback_a_hang_or_a_gigabyte(seed: int, tmp_path: Path) -> None:
    merry = Merry(20)
    with Recorder(tmp_path / "run.rrd", merry.header) as recorder:
        for frame in merry.frames(100):
            recorder.put(frame)
        recorder.finish("completed")
    program = Path(__file__).with_name("corrupted.py")
    command = [sys.executable, str(program), str(tmp_path / "run.rrd"), str(tmp_path), str(seed), str(AT_ONCE)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    *told, end = done.stdout.splitlines()
    assert done.returncode == 0, f"{end}: {done.stderr}"
    assert "panicked" not in done.stderr and "Traceback" not in done.stderr
    assert len(told) == AT_ONCE
    assert int(end.removeprefix("end ")) < 1000  # MB; 230 of it are the libraries
