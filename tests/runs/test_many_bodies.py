"""What carom writes it reads: scenes of more bodies than fit into 4 MB of text."""

from __future__ import annotations

from pathlib import Path

import pytest

import carom
from carom.errors import SceneError
from carom.recording.read.recorded_scene import recorded_scene
from carom.runs.replay import replay
from carom.runs.resume import continue_run, resumable_run
from carom.scene.load import Scene
from carom.sharing.report import report


def row(bodies: int, name: str = "") -> Scene:
    """Return bodies in a row that nothing moves; the pull is off, and they do not touch."""
    return Scene.from_dict(
        {
            "gravity": {"constant": 0.0},
            "contact": {"enabled": False},
            "time": {"duration": 0.002, "fixed_dt": 1e-3},
            "body": [{"position": [3.0 * k, 0.0, 0.0], "name": f"{k}{name}"} for k in range(bodies)],
        }
    )


@pytest.mark.slow
@pytest.mark.nightly
def test_a_scene_of_more_than_4_mb_is_replayed_resumed_and_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recording = carom.run(row(5000, 800 * "x"), tmp_path / "x.rrd")
    assert len(recording.scene_toml) > 4_000_000
    assert recorded_scene(recording).toml == recording.scene_toml
    assert replay(recording).same
    run = resumable_run(recording, until=0.004)
    assert continue_run(run, run.space(), tmp_path / "longer.rrd").status == "completed"
    monkeypatch.setattr("carom.sharing.report.try_to_render", lambda *_: "not of interest here")
    assert "same bits" in report(recording, tmp_path / "x.zip").replayed


def test_a_text_that_is_too_long_for_its_bodies_is_refused_before_it_runs() -> None:
    with pytest.raises(SceneError, match="characters are too many for a scene of 1 bodies; at most 4001000"):
        row(1, 4_001_000 * "x")
