"""What a run says before its first step."""

from __future__ import annotations

from typing import Any

import pytest

from carom.cli.progress import Progress
from carom.scene.schema import Scene


@pytest.mark.parametrize(
    ("time", "said"),
    [
        ({"duration": 6e7}, "time.max_dt = 1 s, its default, makes at least 6e+07 steps; for fewer, raise it or"),
        ({"duration": 6e7, "max_dt": 2.0}, "time.max_dt = 2 s makes at least 3e+07 steps; for fewer, raise it or"),
        ({"duration": 6e7, "max_dt": 100.0}, ""),
        ({"duration": 6e7, "integrator": "gauss-radau15"}, ""),
        ({"duration": 6e7, "fixed_dt": 1.0}, ""),
    ],
)
def test_a_largest_step_that_makes_a_run_long_is_named_before_the_run(
    time: dict[str, Any], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with Progress(Scene.from_dict({"time": time, "body": [{"radius": 1.0}]})):
        pass
    shown = " ".join(capsys.readouterr().err.split())
    assert said in shown and ("max_dt" in shown) == bool(said)
