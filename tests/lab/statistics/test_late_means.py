"""A sweep's table has the granular temperature and the stress of the second half of each run."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from carom.lab.statistics.late_means import late_means
from carom.runs.run import run
from carom.scene.load import Scene
from small_scenes import scene_of

BOX = {"boundary": "periodic", "size": [4.0, 4.0, 4.0]}
NO_FORCES = {"constant": 0.0}


def test_two_balls_that_fly_apart_have_the_temperature_of_their_speeds_and_a_pressure_along_their_path(
    tmp_path: Path,
) -> None:
    one = {"position": [0.0, -1.0, 0.0], "velocity": [3.0, 0.0, 0.0], "mass": 2.0, "radius": 0.2}
    other = one | {"position": [0.0, 1.0, 0.0], "velocity": [-3.0, 0.0, 0.0]}
    scene = scene_of([one, other], domain=BOX, gravity=NO_FORCES, time={"duration": 0.1})
    found = late_means(run(scene, tmp_path / "a.rrd"))
    kinetic = 2 * (2.0 * 3.0**2)  # J, Σ m c²
    assert found["granular.temperature"] == pytest.approx(kinetic / (3 * 2))
    assert found["granular.stress.xx"] == pytest.approx(kinetic / 4.0**3)
    assert found["granular.stress.yy"] == found["granular.stress.xy"] == 0.0
    assert found["granular.pressure"] == pytest.approx(kinetic / 4.0**3 / 3)


def test_a_column_at_rest_is_cold_and_carries_its_weight(tmp_path: Path) -> None:
    column: list[dict[str, object]] = [{"position": [0.0, 0.0, 0.5 + k], "radius": 0.5, "mass": 1.0} for k in range(3)]
    scene = scene_of(
        column,
        plane=[{}],
        gravity={"constant": 0.0, "uniform": [0.0, 0.0, -10.0]},
        contact={"restitution": 0.0},
        time={"duration": 0.5},
    )
    found = late_means(run(scene, tmp_path / "a.rrd"))
    assert found["granular.temperature"] == pytest.approx(0.0, abs=1e-12)
    # σ V = Σ m g z of the centres above the floor, (0.5 + 1.5 + 2.5) m, with the rounding of the solver
    assert found["granular.stress.zz"] == pytest.approx(45.0, rel=1e-3)
    assert np.isfinite(list(found.values())).all()


def test_a_single_ball_has_no_granular_temperature(tmp_path: Path) -> None:
    scene: Scene = scene_of([{"velocity": [1.0, 0.0, 0.0]}], time={"duration": 0.1})
    assert "granular.temperature" not in late_means(run(scene, tmp_path / "a.rrd"))
