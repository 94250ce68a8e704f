"""Other engines run carom's scenes, and are measured by the same reference."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest

from carom.engines.adapters.rebound import shortest_period
from carom.engines.engine import EngineSimulation, engine_called, problem_of, watch
from carom.engines.source import Model, Plane, State
from carom.errors import ExperimentError
from carom.lab.compared_run import sample_times
from carom.lab.tradeoff.tradeoff import Study
from carom.recording.read.recording import Recording
from carom.scene.load import Scene

STAR = {"mass": 1.0, "radius": 0.01, "position": [0.0, 0.0, 0.0]}
ROUND = (1.0 + 1e-6) ** 0.5  # m/s, the speed on a circle of radius 1 about both masses
PLANET = {"mass": 1e-6, "radius": 0.01, "position": [1.0, 0.0, 0.0], "velocity": [0.0, ROUND, 0.0]}


def orbit(**sections: object) -> Scene:
    """A planet on a circle of period 2π; the planet is written first."""
    return Scene.from_dict(
        {
            "title": "a planet",
            "time": {"duration": 10.0, "fixed_dt": 0.01},
            "gravity": {"constant": 1.0},
            "contact": {"enabled": False},
            "body": [PLANET, STAR],
            **sections,
        }
    )


@pytest.mark.needs("rebound")
def test_rebound_keeps_the_order_of_the_bodies_and_follows_the_circle() -> None:
    scene, rebound = orbit(), engine_called("rebound")
    exact = next(setting for setting in rebound.settings(scene) if setting.name == "rebound ias15")
    run = rebound.follow(scene, exact, sample_times(scene))
    apart = run.position[:, 0] - run.position[:, 1]
    angle = ROUND * run.time
    circle = np.stack((np.cos(angle), np.sin(angle), 0.0 * angle), axis=1)
    assert np.abs(apart - circle).max() < 1e-12  # a few hundred roundings
    assert run.energy_error < 1e-13  # a few hundred roundings


@pytest.mark.needs("rebound")
def test_steps_of_maps_for_a_dominant_body_are_parts_of_the_shortest_period() -> None:
    assert shortest_period(orbit()) == pytest.approx(2.0 * np.pi, rel=1e-6)
    assert shortest_period(orbit(body=[PLANET, {**STAR, "mass": 1e-5}])) == 0.0
    names = [setting.name for setting in engine_called("rebound").settings(orbit())]
    assert "rebound whfast, dt = 0.3142 s" in names


@pytest.mark.slow
@pytest.mark.needs("rebound")
def test_rebound_resolves_impacts_of_one_step_in_the_same_order_in_each_run() -> None:
    scene, rebound = Scene.load("crosscheck/rebound-many-at-once"), engine_called("rebound")
    setting, times = rebound.examined(scene)[0], sample_times(scene)
    ends = {rebound.follow(scene, setting, times).position[-1].tobytes() for _ in range(8)}
    assert len(ends) == 1


@pytest.mark.needs("rebound")
def test_each_halving_of_leapfrogs_step_in_rebound_quarters_its_error(tmp_path: Path) -> None:
    scene = orbit()
    leapfrog = [s for s in engine_called("rebound").settings(scene) if "leapfrog" in s.name]
    study = Study(scene, tmp_path, threads=1)
    study.measure(leapfrog, 1, lambda text: None)
    errors = [result.errors.position for result in study.results if result.errors]
    assert len(errors) == 4
    assert np.allclose(np.array(errors[:-1]) / errors[1:], 4.0, rtol=0.02)  # second order; the fourth is 1e-4 of it
    kept = json.loads((tmp_path / "tradeoff.json").read_text(encoding="utf-8"))["settings"]
    assert {entry["engine"] for entry in kept} == {"rebound"} and all(entry["costs"] for entry in kept)
    assert Study(scene, tmp_path).results[0].complete, "a study with engines can be resumed"


@pytest.mark.needs("rebound")
@pytest.mark.parametrize(
    ("sections", "lack"),
    [
        ({"contact": {"enabled": True}}, "friction"),
        ({"contact": {"enabled": True}, "plane": [{"point": [0.0, 0.0, -5.0]}]}, "planes"),
        ({"gravity": {"constant": 1.0, "uniform": [0.0, 0.0, -1.0]}}, "a uniform field"),
        ({"drag": {"relaxation_time": 1.0}}, "drag"),
        ({"body": [PLANET, {**STAR, "fixed": True}]}, "fixed bodies"),
    ],
)
def test_a_scene_that_rebound_lacks_something_for_is_refused_by_what_it_lacks(
    sections: dict[str, object], lack: str
) -> None:
    with pytest.raises(ExperimentError, match=f"^rebound cannot represent this scene: .*{lack}"):
        engine_called("rebound").settings(orbit(**sections))


def test_an_engine_that_is_not_installed_or_unknown_is_refused_with_the_remedy(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with pytest.raises(ExperimentError, match='--engine mujoko: unknown; did you mean "mujoco"'):
        engine_called("mujoko")
    monkeypatch.setitem(sys.modules, "rebound", None)
    with pytest.raises(ExperimentError, match="pip install 'rebound>=5'"):
        engine_called("rebound").settings(orbit())


@pytest.mark.slow  # Warp starts in two seconds
@pytest.mark.needs("newton")
def test_newton_hands_velocity_from_sphere_to_equal_sphere_and_bounces_on_a_plane_by_its_own_coefficient() -> None:
    scene = Scene.from_dict(
        {
            "time": {"duration": 1.0, "fixed_dt": 0.005},
            "gravity": {"constant": 0.0},
            "contact": {"restitution": 1.0, "static_friction": 0.0, "kinetic_friction": 0.0},
            "body": [
                {"mass": 2.0, "radius": 0.1, "position": [0.0, 0.0, 0.0], "velocity": [1.0, 0.0, 0.0]},
                {"mass": 2.0, "radius": 0.1, "position": [0.5, 0.0, 0.0]},
                {"mass": 1.0, "radius": 0.1, "position": [5.0, 5.0, 0.5], "velocity": [0.0, 0.0, -1.0]},
            ],
            "plane": [{"point": [0.0, 0.0, -0.2], "restitution": 0.5}],
        }
    )
    newton = engine_called("newton")
    # 200 steps take a second; Warp's compiling, half a minute on a new machine, is not charged to the run
    run = newton.follow(scene, newton.settings(scene)[0], sample_times(scene), limit=15.0)
    right = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.5]])
    assert np.abs(run.velocity[-1] - right).max() < 1e-5  # single precision


class Restarting:
    """A body whose engine begins anew after five steps, as MuJoCo does when it becomes unstable."""

    model = Model(engine="restarting 1.0", mass=[1.0], radius=[0.1], collides=False)
    steps = 0

    def step(self) -> None:
        self.steps = (self.steps + 1) % 6

    def state(self) -> State:
        return State(0.1 * self.steps, np.zeros((1, 3)), np.zeros((1, 3)))


@pytest.mark.needs("mujoco")
def test_mujoco_keeps_the_order_and_the_names_of_bodies_of_which_some_are_fixed(tmp_path: Path) -> None:
    balls = [{"name": name, "position": [3.0 * k, 0.0, 0.0], "mass": 1.0 + k} for k, name in enumerate("abcd")]
    for k, ball in enumerate(balls):
        ball.update({"fixed": True} if k in (0, 2) else {"velocity": [0.0, float(k), 0.0]})
    scene = Scene.from_dict({"time": {"duration": 1.0, "fixed_dt": 0.1}, "gravity": {"constant": 0.0}, "body": balls})
    engine, path = engine_called("mujoco"), tmp_path / "run.rrd"
    run = watch(engine.begin(scene, engine.settings(scene)[0]), scene, np.array([1.0]), path).trajectory
    assert run.position[0] == pytest.approx(np.array([[0, 0, 0], [3, 1, 0], [6, 0, 0], [9, 3, 0]]), abs=1e-9)
    bodies = Recording.open(path).bodies
    assert list(bodies.name) == ["a", "b", "c", "d"] and bodies.mass[[1, 3]].tolist() == [2.0, 4.0]


def ball_between_planes() -> Scene:
    return Scene.from_dict(
        {
            "time": {"duration": 1.0, "fixed_dt": 0.1},
            "gravity": {"constant": 0.0},
            "body": [{"name": "ball", "mass": 1.0, "radius": 0.1, "position": [0.0, 0.0, 1.0]}],
            "plane": [{"name": "floor"}, {"name": "wall", "normal": [1.0, 0.0, 0.0], "point": [-3.0, 0.0, 0.0]}],
        }
    )


@pytest.mark.needs("mujoco")
def test_mujoco_calls_planes_as_the_scene_does() -> None:
    found, scene = engine_called("mujoco"), ball_between_planes()
    source = found.begin(scene, found.settings(scene)[0]).source
    assert [plane.name for plane in source.model.planes] == ["floor", "wall"]


def test_an_engine_without_names_gets_those_of_the_scene() -> None:
    # PyBullet, which these tests do without, has none; its planes keep their normals and places.
    planes = [Plane((0.0, 0.0, 1.0), 0.0, "plane 0"), Plane((1.0, 0.0, 0.0), -3.0, "plane 1")]
    own = Model(engine="a", mass=[1.0], radius=[0.1], planes=planes)
    named = problem_of("a", ball_between_planes()).named(own)
    assert named.planes == [planes[0]._replace(name="floor"), planes[1]._replace(name="wall")]
    assert list(named.names or ()) == ["ball"]


def test_a_run_whose_clock_goes_back_ends_there_with_a_recording(tmp_path: Path) -> None:
    scene, engine = orbit(units="au, day, solar mass"), Restarting()
    simulation = EngineSimulation(engine, engine.step, 0.1)
    seen = watch(simulation, scene, sample_times(scene), tmp_path / "run.rrd")
    assert seen.outcome == "failed: the engine's time decreased from 0.5 day to 0 day."
    assert Recording.open(tmp_path / "run.rrd").outcome == seen.outcome


@pytest.mark.needs("mujoco")
def test_steps_of_engines_are_named_in_the_units_of_the_scene() -> None:
    scene = Scene.from_dict(
        {
            "title": "a ball",
            "units": "cm, ms, g",
            "time": {"duration": 10.0, "fixed_dt": 2.0},
            "contact": {"static_friction": 0.0},
            "gravity": {"constant": 0.0},
            "body": [STAR],
        }
    )
    names = [setting.name for setting in engine_called("mujoco").settings(scene)]
    assert names == ["mujoco, dt = 2 ms", "mujoco, dt = 0.5 ms"]
