"""Plots of single bodies: which are asked for, and whether their values are those of the run."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from carom.display.supplement import QUANTITIES, BodyPlots, asked_quantities, body_series, needs_replay
from carom.errors import RecordingError
from carom.physics.space import Space
from carom.recording.layout.canvas import Area
from carom.recording.read.recording import Recording
from carom.runs.run import simulate
from small_scenes import scene_of

BODIES = [
    {"name": "top", "position": [0, 0, 5], "velocity": [3, 0, 4], "angular_velocity": [0, 3, 4], "radius": 0.1},
    {"position": [9, 0, 5], "radius": 0.1},
    {"name": "no. 1", "position": [0, 9, 5], "radius": 0.1},
]


@pytest.fixture(scope="module")
def thrown(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    """Three balls under gravity that never touch, one of which spins."""
    path = tmp_path_factory.mktemp("thrown") / "thrown.rrd"
    gravity = {"method": "none", "uniform": [0, 0, -10]}
    scene = scene_of(BODIES, gravity=gravity, time={"duration": 0.5, "fixed_dt": 0.01}, plane=[{}])
    simulate(Space(scene), path)
    return Recording.open(path)


def test_bodies_are_asked_for_by_name_or_number_also_with_dots_in_the_name(thrown: Recording) -> None:
    asked = asked_quantities(thrown, "top.z, 1.speed,no. 1.vx,top.omega")
    assert [(body, quantity.name) for body, quantity in asked] == [(0, "z"), (1, "speed"), (2, "vx"), (0, "omega")]


def test_names_with_commas_are_asked_for_as_they_are(tmp_path: Path) -> None:
    bodies = [{"name": name, "position": [3 * k, 0, 0]} for k, name in enumerate(("Ceres, dwarf", "Vesta"))]
    simulate(Space(scene_of(bodies, time={"duration": 0.1})), tmp_path / "run.rrd")
    asked = asked_quantities(Recording.open(tmp_path / "run.rrd"), "Ceres, dwarf.x,Vesta.z, Ceres, dwarf.speed")
    assert [(body, quantity.name) for body, quantity in asked] == [(0, "x"), (1, "z"), (0, "speed")]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("top.height", 'no quantity "height"; there are x, y, z (m), vx, vy, vz, speed (m/s) and wx, wy, wz, omega'),
        ("bottom.z", 'no body "bottom"; its bodies are 0 to 2, called "top", "no. 1"'),
        ("tpo.z", 'did you mean "top"?'),
        ("no.z", 'did you mean "no. 1"?'),
        ("7.z", 'no body "7"'),
        ("top", 'expected BODY.QUANTITY, such as 0.speed; "top" is not'),
        ("top.z,", 'expected BODY.QUANTITY, such as 0.speed; "" is not'),
        (",".join(f"{body}.{name}" for body in (0, 1) for name in QUANTITIES), "22 curves are more than 12"),
    ],
)
def test_a_plot_of_a_missing_body_or_quantity_is_refused_in_one_sentence(
    thrown: Recording, text: str, said: str
) -> None:
    with pytest.raises(RecordingError) as raised:
        asked_quantities(thrown, text)
    assert said in str(raised.value)
    assert "\n" not in str(raised.value)


def test_spins_of_bodies_that_do_not_spin_are_refused(tmp_path: Path) -> None:
    simulate(Space(scene_of([{}], time={"duration": 0.1, "fixed_dt": 0.05})), tmp_path / "one.rrd")
    with pytest.raises(RecordingError, match=r"^plot 0\.omega: the bodies of .*one\.rrd do not spin"):
        asked_quantities(Recording.open(tmp_path / "one.rrd"), "0.omega")


def test_velocities_and_spins_are_those_of_the_run(thrown: Recording) -> None:
    asked = asked_quantities(thrown, "top.vz,top.speed,top.omega,top.z,1.speed")
    assert needs_replay(asked)
    vz, speed, omega, z, other = body_series(thrown, asked)
    t = vz.time
    assert len(t) == thrown.frames and np.array_equal(t, thrown.fingerprints()["time"].to_numpy())
    # free fall is exact but for rounding: 50 steps of a few ulp
    assert vz.value == pytest.approx(4.0 - 10.0 * t, abs=1e-12)
    assert speed.value == pytest.approx(np.hypot(3.0, 4.0 - 10.0 * t), abs=1e-12)
    assert omega.value == pytest.approx(np.full(len(t), 5.0), abs=1e-12)
    assert z.value == pytest.approx(5.0 + 4.0 * t - 5.0 * t * t, abs=1e-12)
    assert other.value == pytest.approx(10.0 * t, abs=1e-12)


def test_positions_are_read_without_running_again(thrown: Recording, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("carom.display.supplement._replayed", None)
    asked = asked_quantities(thrown, "top.x,top.z")
    assert not needs_replay(asked)
    x, z = body_series(thrown, asked)
    assert x.value == pytest.approx(3.0 * x.time, abs=1e-5)  # float32 of some metres
    assert z.value == pytest.approx(5.0 + 4.0 * z.time - 5.0 * z.time**2, abs=1e-5)


def test_each_unit_has_a_plot_of_its_own_and_each_curve_of_a_plot_a_colour(thrown: Recording) -> None:
    asked = asked_quantities(thrown, "top.z,1.z,no. 1.z,top.speed,top.omega")
    plots = BodyPlots(body_series(thrown, asked))
    assert plots.units == ["m", "m/s", "rad/s"]
    views = plots.views(Area(1600, 200))
    assert [view.name for view in views] == ["Position (m)", "top speed (m/s)", "top omega (rad/s)"]
    styles = dict(plots.statics())
    assert len(styles) == 5
    heights = [path for path in styles if path.endswith("/z")]
    colours = {str(styles[path]) for path in heights}
    assert len(colours) == 3


@pytest.mark.parametrize("text", ["top.speed", "top.speed,1.vx"])
def test_a_plot_that_fills_a_picture_says_in_its_legend_what_it_shows(thrown: Recording, text: str) -> None:
    plots = BodyPlots(body_series(thrown, asked_quantities(thrown, text)), alone=True)
    assert "top speed (m/s)" in str(dict(plots.statics())["plot/body0/speed"])
    assert "visible=[True]" in str(plots.views(Area(1600, 1000))[0].properties["PlotLegend"])
