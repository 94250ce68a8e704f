"""A recording of a run without physics, as fixtures: whole, and as a copy that may be changed."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from carom.recording.write.recorder import FrameRecorder
from scripted_run import ScriptedRun

IMPACT: dict[str, float | str] = {"value": 3.0, "step": 40, "time": 2.0, "bodies": "1,2"}


@pytest.fixture
def scripted() -> ScriptedRun:
    return ScriptedRun()


@pytest.fixture(scope="session")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of 60 bodies and 100 frames, 0.05 s apart: not to be written to."""
    path, scripted = tmp_path_factory.mktemp("recorded") / "run.rrd", ScriptedRun()
    moments = {f"moments.impact.{key}": value for key, value in IMPACT.items()}
    with FrameRecorder(path, scripted.header) as recorder:
        for frame in scripted.frames(100):
            recorder.put(frame)
        recorder.finish("completed", {"contacts.total": 1234, "profile.gravity": 0.5, **moments})
    return path


@pytest.fixture
def run_file(recorded: Path, tmp_path: Path) -> Path:
    """A copy of it, which a test may change."""
    return Path(shutil.copy(recorded, tmp_path))
