"""`carom fork`: the common part of a branch and its recording, allowed changes, and the spread of many branches."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import carom
from carom.display.forecast import shades
from carom.errors import ExperimentError
from carom.lab.fork.branch import Branch, PerturbedResult, PerturbedTask, by_seed, execute, outcome_of, start_of
from carom.lab.fork.fork import Chance, Ensemble, chances, ensemble, fork, inevitable, judge, text_of, write_ensemble
from carom.plan.auto import frame_interval, integrator
from carom.recording.read.recording import Recording
from carom.scene.load import Scene
from small_scenes import cloud, two_planets


def box_of_balls(duration: float) -> Scene:
    """Balls between walls, which double a difference every few steps."""
    group = {
        "count": 12,
        "radius": 0.3,
        "region": {"shape": "box", "size": [2.2] * 3},
        "velocity": {"dispersion": 1.0},
    }
    return Scene.from_dict(
        {
            "seed": 5,
            "group": [group],
            "domain": {"boundary": "walls", "size": [3.0] * 3},
            "gravity": {"constant": 0.0},
            "contact": {"restitution": 1.0, "timing": "time-of-impact", "static_friction": 0, "kinetic_friction": 0},
            "time": {"duration": duration, "fixed_dt": 0.02},
            "record": {"every": 0.1},
        }
    )


@pytest.fixture(scope="module")
def gas(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("gas") / "gas.rrd"
    carom.run(box_of_balls(14.0), path)
    return path


def here(tasks: Iterable[PerturbedTask]) -> Iterator[PerturbedResult]:
    """Run branches in this process."""
    return map(execute, tasks)


def many(path: Path, at: float, seeds: int, outcome: str | None = None) -> Ensemble:
    branch = Branch(path, at)
    start = start_of(branch)
    expression = None if outcome is None else outcome_of(start, outcome)
    return ensemble(start, branch, seeds, 1, here, expression)


@pytest.mark.slow
@pytest.mark.parametrize("override", ["contact.restitution=0.5", "gravity.constant=1.0", "record.check_every=3"])
def test_a_fork_that_changes_nothing_has_the_bits_of_the_recording(override: str, tmp_path: Path) -> None:
    scene = cloud(10, time={"duration": 2.0}, contact={"restitution": 0.5})
    recording = carom.run(scene, tmp_path / "run.rrd")
    start = start_of(Branch(recording.path, 1.1, (override,)))
    _, found = fork(start, tmp_path / "both.rrd", None, 0)
    assert found.verdict.kind == "same"
    assert found.frames[1] < 0.6 * found.frames[0]  # the price of the suffix


def test_other_parameters_act_from_the_fork_on(gas: Path, tmp_path: Path) -> None:
    start = start_of(Branch(gas, 2.0, ("gravity.uniform=[0, 0, -1]",)))
    space = start.space(1)
    assert space.state.acceleration[:, 2] == pytest.approx(-1.0)
    outcome, found = fork(start, tmp_path / "both.rrd", None, 0)
    assert outcome.status == "completed" and found.scene["gravity.uniform"][1] == [0.0, 0.0, -1.0]
    assert not found.curve.differs[0] and found.curve.differs[-1]
    assert Recording.open(tmp_path / "both.rrd").is_overlay


def test_rounding_of_drawn_positions_before_a_fork_parts_is_not_taken_for_growth(tmp_path: Path) -> None:
    ball = {"radius": 0.5, "position": [0, 0, 20.5], "velocity": [1, 0, 0]}
    thrown = {"body": [ball], "plane": [{}], "gravity": {"constant": 0.0, "uniform": [0, 0, -9.81]}}
    scene = Scene.from_dict({**thrown, "contact": {"restitution": 0.9}, "time": {"duration": 5.0}})
    recording = carom.run(scene, tmp_path / "run.rrd")
    start = start_of(Branch(recording.path, 1.0, ("contact.restitution=0.5",)))  # it bounces at 2 s, once
    found = fork(start, tmp_path / "both.rrd", None, 0)[1]
    assert found.divergence is None or not found.divergence.is_exponential, "the velocities differ by a constant"
    assert found.curve.differs.any() and not found.curve.differs.all()
    assert (found.curve.rms <= found.curve.floor)[~found.curve.differs].all(), "their bits are the same"


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("group.0.count=3", "a fork uses the bodies"),
        ("seed=8", "a fork uses the bodies"),
        ("domain.size=[9, 9, 9]", "cannot change in the middle of a run"),
        ("contact.static_friction=0.2;contact.kinetic_friction=0.2", "changes whether bodies spin"),
        ("time.integrator=yoshida4", "changes the integrator"),
        ("time.duration=1.0", "would have no time left"),
    ],
)
def test_a_fork_refuses_overrides_of_what_a_checkpoint_holds(gas: Path, override: str, message: str) -> None:
    with pytest.raises(ExperimentError, match=message):
        start_of(Branch(gas, 2.0, tuple(override.split(";"))))


@pytest.fixture
def orbits(tmp_path: Path) -> Path:
    return carom.run(two_planets(), tmp_path / "orbits.rrd").path


def test_a_fork_with_a_later_end_keeps_the_integrator_and_the_interval_between_frames(orbits: Path) -> None:
    scene = start_of(Branch(orbits, 20.0, ("time.duration=7000",))).scene
    assert integrator(scene).name == "gauss-radau15"
    assert frame_interval(scene) == 60.0 / 600


def test_a_distance_at_the_end_that_interpolation_explains_is_not_stated_as_one(orbits: Path, tmp_path: Path) -> None:
    start = start_of(Branch(orbits, 20.0, ("time.duration=70", "record.every=0.5", "gravity.softening=1e-9")))
    _, found = fork(start, tmp_path / "both.rrd", None, 0)
    assert 1e-3 < found.curve.rms[-1] < found.curve.floor[-1] < 0.1
    assert "at t = 60 s counterparts are less than" in text_of(start, found)  # where the recording ends


@pytest.mark.parametrize(("at", "samples"), [(2.22, [2.3, 2.37]), (2.34, [2.37])])
def test_branches_are_compared_at_their_end_whatever_the_interval_of_frames(
    gas: Path, at: float, samples: list[float]
) -> None:
    branch = Branch(gas, at, ("time.duration=2.37",))
    found = ensemble(start_of(branch), branch, 2, 1, here)
    assert found.time[-len(samples) :] == pytest.approx(samples)
    assert np.isfinite(found.rms).all() and (found.rms[:, -1] > 0.0).all()


def test_a_perturbed_start_differs_by_one_unit_in_the_last_place_of_each_coordinate(gas: Path) -> None:
    start = start_of(Branch(gas, 2.0))
    here, there = start.space(1).state.position, start.space(1, shift=3).state.position
    assert (np.abs(there - here) == np.spacing(np.abs(here))).mean() > 0.9  # less below a power of two
    assert np.array_equal(there, start.space(1, shift=3).state.position)
    assert not np.array_equal(there, start.space(1, shift=4).state.position)


def test_the_band_and_the_spread_grow_and_outcomes_are_counted(gas: Path, tmp_path: Path) -> None:
    found = many(gas, 2.0, 5, "x_0 > -9 and contacts.impacts > 3")
    assert found.rms.shape == (5, 120) and found.time[0] == pytest.approx(2.1) and found.time[-1] == pytest.approx(14.0)
    assert (np.diff(found.band, axis=0) >= 0.0).all()
    assert found.band[1, 0] < 1e-14 and found.band[1, -1] > 1e6 * found.band[1, 0]
    assert found.outcomes == [True] * 5 and found.reference_outcome
    squares = (found.spread.astype(np.float64) ** 2).mean(axis=1)
    assert squares == pytest.approx((found.rms**2).mean(axis=0), rel=1e-5)  # distances come as float32
    start = start_of(Branch(gas, 2.0))
    write_ensemble(start, replace(found, chances=[Chance(2.0, 5, 5), Chance(8.0, 3, 5)]), "text", tmp_path / "many.rrd")
    written = Recording.open(tmp_path / "many.rrd")
    assert written.is_overlay
    assert {"outcome/low", "outcome/probability", "outcome/high"} <= {e.entity_path for e in written.store.entries}


@pytest.mark.slow
def test_the_growth_of_forks_is_the_growth_that_diff_finds(gas: Path, tmp_path: Path) -> None:
    found = many(gas, 0.1, 12)
    assert found.growth is not None and found.growth.is_exponential
    one = fork(start_of(Branch(gas, 0.1)), tmp_path / "both.rrd", 99, 1)[1].divergence
    assert one is not None
    error = np.hypot(found.rate_error, one.standard_error)
    assert abs(one.rate - np.median(found.rates)) < 3.0 * error  # errors are standard deviations of single branches
    assert found.rate_error < 0.5 * float(np.median(found.rates))


def test_an_unknown_name_in_an_outcome_is_refused_before_a_branch_is_run(
    gas: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("carom.lab.fork.fork.path_of", None)
    with pytest.raises(ExperimentError, match=r'--outcome contacts\.impact > 1: .* did you mean "contacts\.impacts"'):
        many(gas, 7.8, 1, "contacts.impact > 1")


def test_bodies_are_shaded_by_decades_of_their_spread_over_their_radius() -> None:
    found = shades(np.array([0.0, 1e-9, 2e-4, 5e-3, 50.0]), np.ones(5))
    assert found[0] == found[1] and len(set(found.tolist())) == 4


def test_the_probability_of_an_outcome_is_measured_at_each_time_of_the_fork() -> None:
    def draw(time: float) -> Iterator[bool]:
        return iter([True] * int(time) + [False] * (10 - int(time)))

    found = list(chances(draw, 0.0, 8.0, 4))
    assert [(chance.time, chance.probability) for chance in found] == [(2.0, 0.2), (4.0, 0.4), (6.0, 0.6)]
    assert [chance.time for chance in chances(draw, 0.0, 8.0, 4, last_step=5.0)] == [2.0, 4.0]
    assert found[1].band == pytest.approx((0.168, 0.687), abs=1e-3)  # Wilson's interval of 4 of 10
    assert Chance(0.0, 20, 20).band == pytest.approx((0.839, 1.0), abs=1e-3)


def test_results_come_in_the_order_of_seeds_whatever_the_workers_do() -> None:
    results = [PerturbedResult(seed, np.zeros((1, 1), np.float32), None) for seed in (3, 1, 2, 5, 4)]
    assert [result.seed for result in by_seed(results)] == [1, 2, 3, 4, 5]


def test_the_moment_of_inevitability_is_found_by_bisection() -> None:
    rng = np.random.default_rng(1)

    def draw(time: float) -> Iterator[bool]:
        while True:
            yield bool(rng.random() < (1.0 if time >= 3.7 else 0.5))

    found = inevitable(draw, 0.0, 8.0)
    assert found.earliest < 3.7 <= found.latest and found.latest - found.earliest == pytest.approx(8.0 / 256)
    assert not found.always and len(found.tested) == 9
    assert all(tested.forks == 31 for tested in found.tested if tested.inevitable)
    assert inevitable(draw, 4.0, 8.0).always


def test_the_sequential_test_errs_rarely() -> None:
    rng = np.random.default_rng(2)

    def draw(probability: float) -> Iterator[bool]:
        while True:
            yield bool(rng.random() < probability)

    wrong = sum(judge(draw, 0.9).inevitable for _ in range(400)) + sum(
        not judge(draw, 0.99).inevitable for _ in range(400)
    )
    assert wrong <= 0.05 * 800 + 3.0 * np.sqrt(0.05 * 0.95 * 800)  # errors of 5 %, within three deviations
