import os
import subprocess
import sys
from pathlib import Path

import pytest

import carom
import damage_bytes
import damage_rows
from carom.scene.load import Scene

AT_ONCE = 20  # files a process: Rerun keeps some 2 MB of every stream that wrote one


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of every kind of data: impacts, contacts, forces, and bodies drawn at impacts."""
    document = {
        "seed": 3,
        "time": {"duration": 4.0, "max_dt": 0.02},
        "gravity": {"constant": 0.0, "uniform": [0.0, 0.0, -9.81]},
        "contact": {"restitution": 0.5},
        "domain": {"boundary": "walls", "size": [6.0, 6.0, 8.0]},
        "record": {"every": 0.05},
        "group": [
            {
                "count": 20,
                "radius": {"min": 0.4, "max": 0.7},
                "region": {"shape": "box", "size": [4.0, 4.0, 6.0]},
                "velocity": {"dispersion": 2.0},
                "spin": {"dispersion": 2.0},
            }
        ],
    }
    path = tmp_path_factory.mktemp("recorded") / "run.rrd"
    carom.run(Scene.from_dict(document), path)
    return path


@pytest.mark.parametrize(("part", "count"), [(0, 3), pytest.param(1, AT_ONCE, marks=pytest.mark.slow)])
def test_damaged_files_are_refused_or_saved_without_a_traceback_a_hang_or_a_gigabyte(
    part: int, count: int, seed: int, recorded: Path, tmp_path: Path
) -> None:
    seed += part
    program = Path(damage_bytes.__file__)
    command = [sys.executable, str(program), str(recorded), str(tmp_path), str(seed), str(count)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    *told, end = done.stdout.splitlines()
    assert done.returncode == 0, f"seed {seed}, {end}: {done.stderr}"
    assert "panicked" not in done.stderr and "Traceback" not in done.stderr
    assert len(told) == count
    assert int(end.removeprefix("end ")) < 1000  # MB; 230 of it are the libraries


@pytest.mark.slow
@pytest.mark.parametrize("count", [4])
def test_rows_of_another_kind_are_refused_or_shown_without_a_traceback_a_hang_or_a_gigabyte(
    count: int, seed: int, recorded: Path, tmp_path: Path
) -> None:
    program = Path(damage_rows.__file__)
    command = [sys.executable, str(program), str(recorded), str(tmp_path), str(seed), str(count)]
    environment = {**os.environ, "PYTHONPATH": str(program.parent)}
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
    end = (done.stdout.splitlines() or ["nothing"])[-1]
    assert done.returncode == 0 and end.startswith("end"), f"seed {seed}, {end}: {done.stderr}"
    assert "panicked" not in done.stderr and "Traceback" not in done.stderr
    assert int(end.removeprefix("end ")) < 1000  # MB; 230 of it are the libraries
