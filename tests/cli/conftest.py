"""Recordings that the commands on files are tried on."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

import carom as library
from carom.recording.write.recorder import FrameRecorder
from scripted_run import ScriptedRun
from small_scenes import pair


@pytest.fixture(scope="session")
def _recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path, scripted = tmp_path_factory.mktemp("recorded") / "run.rrd", ScriptedRun(20)
    with FrameRecorder(path, scripted.header) as recorder:
        for frame in scripted.frames(100):
            recorder.put(frame)
        recorder.finish("completed", {"contacts.total": 1234})
    return path


@pytest.fixture
def run_file(_recorded: Path, tmp_path: Path) -> Path:
    """A run of 20 bodies and 100 frames, 0.05 s apart, as `run.rrd` in a folder of its own."""
    return Path(shutil.copy(_recorded, tmp_path))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the recording of two spheres that collide once, at 1 s."""
    folder = tmp_path_factory.mktemp("run")
    scene = pair(time={"duration": 2.0, "fixed_dt": 0.1}, record={"every": "step"})
    library.run(scene, folder / "run.rrd")
    return folder
