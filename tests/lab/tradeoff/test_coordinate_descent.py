"""The search for the cheapest setting ends at a setting that no change of a single key improves."""

from __future__ import annotations

import math
import re
from pathlib import Path

import pytest

from carom.lab.tradeoff.setting_runs import SettingRuns
from carom.lab.tradeoff.settings_grid import GridPoint, SettingResult, default_points, knobs, vary
from carom.lab.tradeoff.tradeoff import Study
from carom.lab.tradeoff.tune import Tuning, excess, tuned
from carom.plan.auto import integrator
from carom.scene.load import Scene
from small_scenes import cloud

PRICES = {  # of a step; costs are computed from them, so that a search is the same each time
    "time.integrator=yoshida4": 3.0,
    "time.integrator=gauss-radau15": 100.0,
    "contact.sweeps=2": 0.7,
    "contact.solver=staged": 0.6,
    "contact.timing=time-of-impact": 1.7,
    "gravity.method=tree": 1.5,
}


@pytest.fixture(autouse=True)
def priced(monkeypatch: pytest.MonkeyPatch) -> None:
    def cost(runs: SettingRuns, result: SettingResult) -> float:
        chosen = {*result.setting.overrides, f"time.integrator={integrator(result.setting.apply(runs.scene)).name}"}
        return math.prod(PRICES.get(override, 1.0) for override in chosen) * result.steps

    monkeypatch.setattr(SettingRuns, "cost", cost)


def search(scene: Scene, folder: Path, choices: list[str] | None = None, **limits: float) -> Tuning:
    settings = None if choices is None else vary(scene, choices)
    return tuned(Study(scene, folder, threads=1), limits, 1, lambda text: None, settings)


def eight(**time: float) -> Scene:
    keys = [f"time.{key}={value}" for key, value in ({"duration": 1.0, "fixed_dt": 0.005} | time).items()]
    return Scene.load("figure-eight", [*keys, "record.every=0.25"])


@pytest.mark.slow
def test_the_step_is_searched_beyond_the_settings_that_a_study_begins_with(tmp_path: Path) -> None:
    tuning = search(eight(), tmp_path, energy=1e-4)
    assert tuning.best is not None and tuning.best.errors is not None
    assert tuning.best.errors.energy <= 1e-4
    begun = {point.setting(tuning.study.scene).overrides for point in default_points(tuning.study.scene)}
    assert tuning.best.setting.overrides not in begun
    assert tuning.best.cost < min(
        r.cost for r in tuning.tried if r.setting.overrides in begun and not misses(tuning, r)
    )
    assert tuning.speed == tuning.written.cost / tuning.best.cost > 4.0


@pytest.mark.slow
def test_keys_are_combined_until_no_change_of_one_is_an_improvement(tmp_path: Path) -> None:
    scene = cloud(25, time={"duration": 0.2}, record={"every": 0.1})
    tuning = search(scene, tmp_path, overlap=0.5, energy=0.1)
    assert tuning.best is not None
    point = point_of(tuning.best, scene)
    assert len(point.values) >= 2 and point.step > 1.0, "two keys and the step"
    near = [point.times(2.0), *(point.having(k, v) for k, values in knobs(scene).items() for v in (None, *values))]
    for result in tuning.study.measure([other.setting(scene) for other in near], 1, lambda text: None):
        assert misses(tuning, result) or not result.cost < tuning.best.cost


@pytest.mark.slow
def test_a_scene_that_misses_a_limit_gets_shorter_steps_until_it_is_kept(tmp_path: Path) -> None:
    tuning = search(eight(fixed_dt=0.05), tmp_path, position=1e-9)
    assert tuning.best is not None and tuning.misses(tuning.written)
    assert not tuning.misses(tuning.best) and tuning.speed < 1.0


@pytest.mark.slow
def test_a_limit_that_no_step_keeps_ends_the_search(tmp_path: Path) -> None:
    tuning = search(eight(fixed_dt=0.1), tmp_path, position=1e-17)  # below rounding, whatever the order
    assert tuning.best is None and len(tuning.tried) < 60
    assert tuning.why_none().startswith("position (rms) below 1e-13 is within rounding")


@pytest.mark.slow
def test_an_integrator_that_cannot_win_gets_no_shorter_steps(tmp_path: Path) -> None:
    """Euler errs by 10⁵ times the limit: to be of use its steps would have to be about as many times shorter."""
    tuning = search(eight(), tmp_path, position=1e-8)
    assert tuning.best is not None
    by_euler = [point_of(each, tuning.study.scene).step for each in tuning.tried if "euler" in each.setting.name]
    assert by_euler and min(by_euler) >= 1.0


@pytest.mark.slow
def test_a_step_that_would_lose_frames_is_not_taken(tmp_path: Path) -> None:
    scene = Scene.load("figure-eight", ["time.duration=1", "time.fixed_dt=0.005", "record.every=0.02"])
    tuning = search(scene, tmp_path, energy=1e-3)
    assert tuning.written.frames == 51
    assert tuning.best is not None and tuning.best.frames >= 0.95 * 51
    longer = [result for result in tuning.tried if result.frames < 0.95 * 51]
    assert longer and all(" frames of 51" in tuning.misses(result)[-1] for result in longer)


@pytest.mark.nightly
@pytest.mark.slow
def test_a_scene_that_records_every_step_keeps_enough_of_them_to_be_looked_at(tmp_path: Path) -> None:
    # one step of 3 s keeps this limit: it ends before the balls meet, and shows two frames
    tuning = search(Scene.load("newtons-cradle", ["time.max_dt=0.004"]), tmp_path, overlap=0.01)
    assert tuning.written.frames == 751
    assert tuning.best is not None and tuning.best.frames >= 0.95 * 600


@pytest.mark.slow
def test_errors_that_the_best_setting_raises_are_told_with_both_values(tmp_path: Path) -> None:
    tuning = search(eight(), tmp_path, energy=1e-4)
    best, written = tuning.best, tuning.written
    assert best is not None and best.errors is not None and written.errors is not None
    assert tuning.worse()["position"] == (written.errors.position, best.errors.position)
    assert all(after > before for before, after in tuning.worse().values())


def misses(tuning: Tuning, result: SettingResult) -> bool:
    return excess(tuning.study, tuning.written, result, tuning.limits) > 0.0


def point_of(result: SettingResult, scene: Scene) -> GridPoint:
    """Find the coordinates of a result, which keeps its overrides alone."""
    values = dict(text.split("=", 1) for text in result.setting.overrides)
    keys = {key: value for key, value in values.items() if value in knobs(scene).get(key, ())}
    factors = re.findall(r"max_dt × ([\d.]+)|steps ([\d.]+) times as (long|short)", result.setting.name)
    limit, factor, way = factors[0] if factors else ("1", "", "")
    step = float(limit or factor)
    return GridPoint(1.0 / step if way == "short" else step, tuple(sorted(keys.items())))


@pytest.mark.slow
def test_an_orbit_that_is_lost_keeps_no_limit_on_the_energy(tmp_path: Path) -> None:
    # e = 0.9999 in steps that jump over the pericentre: an error over the largest energy ever would be 3e-5
    lost = Scene.load("extremes/kepler-09999-lost")
    tuning = search(lost, tmp_path / "lost", ["time.integrator=leapfrog,yoshida4"], energy=1e-4)
    assert tuning.best is None
    assert all(result.errors and result.errors.energy > 0.1 for result in tuning.tried)
    adaptive = Scene.from_dict(
        {
            "time": {"duration": lost.time.duration},
            "gravity": {"constant": 1.0},
            "contact": {"enabled": False},
            "body": [body.model_dump(include={"position", "velocity", "radius", "mass"}) for body in lost.body],
        }
    )
    tuning = search(adaptive, tmp_path / "adaptive", ["step=1,4"], energy=1e-4)
    assert tuning.best is not None and tuning.best.errors is not None
    assert tuning.best.errors.position < 1e-2, "what keeps the energy is on its orbit"
