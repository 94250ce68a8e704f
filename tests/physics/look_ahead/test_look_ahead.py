"""The look ahead of an accuracy: what it promises where a mode changes, and how its budget ends."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from carom.errors import SceneError
from carom.physics.look_ahead.error_growth import UNSEEN, onward
from carom.physics.look_ahead.find_step import with_promise
from carom.physics.look_ahead.trial_run import WorkBudget
from carom.physics.schedule import at
from carom.physics.space import Space
from carom.runs.run import shortfall_text
from carom.scene.load import Scene
from carom.scene.schema import Promise
from small_scenes import scene_of

FloatArray = NDArray[np.float64]

LEAST = "carom.physics.look_ahead.trial_run.LEAST"


def sliding_ball(accuracy: float, speed: float = 2.0) -> Scene:
    """Return a ball that slides on a plane with a friction of 0.2, and rolls from 2 v / (7 μ g) on."""
    return scene_of(
        [{"radius": 0.03, "mass": 1.0, "position": [0.0, 0.0, 0.03], "velocity": [speed, 0.0, 0.0]}],
        time={"duration": 2.0, "accuracy": accuracy},
        gravity={"constant": 0.0, "uniform": [0.0, 0.0, -9.81]},
        contact={"restitution": 0.0, "static_friction": 0.2, "kinetic_friction": 0.2},
        plane=[{}],
        record={"check_every": 1000},
    )


def way(time: float, speed: float) -> float:
    """Return how far the ball has come."""
    slows = 0.2 * 9.81
    rolls = 2.0 * speed / (7.0 * slows)
    slid = min(time, rolls)
    return speed * slid - 0.5 * slows * slid * slid + 5.0 / 7.0 * speed * (time - slid)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("accuracy", "speed"),
    [
        (1e-5, 2.0),
        *(pytest.param(10.0**-digits, 2.0, marks=pytest.mark.nightly) for digits in (2, 4, 8)),
        *((3e-6, speed) for speed in (1.7, 4.7)),
    ],
)
def test_a_ball_that_slides_and_then_rolls_keeps_the_accuracy_and_the_expected_error(
    accuracy: float, speed: float
) -> None:
    space = Space(sliding_ball(accuracy, speed), 1)
    promise = space.scene.promise
    assert promise is not None
    for time in np.linspace(0.0, promise.kept_until, 41)[1:]:
        for _ in space.run(float(time), schedule=at(())):
            pass
        error = abs(space.state.position[0, 0] - way(space.time, speed)) / 0.03  # the size of a single body: its radius
        assert error <= accuracy
        # the error comes within a step and is interpolated between 64 times; the sum of the steps is rounded, and the
        # expected error, extrapolated from other steps, is known to a hundredth
        assert error <= 1.01 * promise.error_at(space.time + 2.0 / 64) + 1e-10
    if accuracy >= 1e-6 and speed == 2.0:  # elsewhere the promise may end where the ball begins to roll
        assert promise.horizon is None


def test_a_rolling_ball_that_any_step_computes_exactly_gets_the_longest_ones_after_one_comparison() -> None:
    """It rolls down with 5/7 g sin α, so that trial runs agree to rounding."""
    slope, across = 0.5, math.sqrt(0.75)
    ball = {"radius": 0.1, "mass": 1.0, "position": [0.1 * slope, 0.0, 0.1 * across]}
    scene = scene_of(
        [ball],
        time={"duration": 1.0, "accuracy": 1e-4},
        gravity={"constant": 0.0, "uniform": [0.0, 0.0, -9.81]},
        contact={"restitution": 0.0, "static_friction": 0.5, "kinetic_friction": 0.5},
        plane=[{"normal": [slope, 0.0, across]}],
        record={"check_every": 1000},
    )
    budgets: list[WorkBudget] = []
    space = Space(scene, 1, watch_look_ahead=budgets.append)
    promise = space.scene.promise
    assert promise is not None and promise.horizon is None and promise.refinement == 1.0
    # two runs and a twin, whose steps take 0.27 to 0.39 times the work of the run's own
    assert budgets[-1].spent < 1.5 * budgets[-1].own
    start = space.state.position[0].copy()
    space.reach(1.0)
    rolled = 0.5 * 5.0 / 7.0 * 9.81 * slope
    exact = start + rolled * np.array([across, 0.0, -slope])
    assert np.linalg.norm(space.state.position[0] - exact) / np.linalg.norm(start) < 1e-9, "far below the request"


def test_comparisons_that_end_where_nothing_is_kept_give_the_same_promise(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = tumbling()
    assert with_promise(scene, 1).promise == whole_promise(scene, monkeypatch)


def tumbling() -> Scene:
    """Return three balls that bounce in a narrow box, where a medium brakes them: errors grow tenfold in 0.2 s."""
    bodies = [
        {"position": [x, y, 0.0], "velocity": [1.0 - x, 2.0 * y, 0.3 + x], "radius": 0.3}
        for x, y in ((-0.5, -0.45), (0.45, -0.5), (0.0, 0.5))
    ]
    return scene_of(
        bodies,
        time={"duration": 4.0, "accuracy": 1e-5},
        domain={"boundary": "walls", "size": [2.0, 2.0, 1.0]},
        gravity={"constant": 0.0},
        drag={"relaxation_time": 50.0},
        contact={"restitution": 1.0, "static_friction": 0.0},
    )


def whole_promise(scene: Scene, monkeypatch: pytest.MonkeyPatch) -> Promise | None:
    """Return the promise of comparisons that go on until the distance is the size of the system."""
    monkeypatch.setattr("carom.physics.look_ahead.find_step.largest_useful", lambda *_: 1.0)
    return with_promise(scene, 1).promise


def test_an_accuracy_takes_no_more_steps_than_the_default_where_drag_makes_these_exact() -> None:
    def falling(**time: Any) -> Scene:
        return scene_of(
            [{"position": [0.0, 0.0, 5.0], "radius": 0.1}],
            time={"duration": 10.0, **time},
            gravity={"constant": 0.0, "uniform": [0.0, 0.0, -9.81]},
            drag={"relaxation_time": 2.0},
        )

    usual, accurate = Space(falling(), 1), Space(falling(accuracy=1e-8), 1)
    for space in (usual, accurate):
        space.reach(10.0)
    assert accurate.step <= usual.step
    terminal = 9.81 * 2.0
    fallen = terminal * (10.0 - 2.0 * (1.0 - math.exp(-5.0)))
    assert abs(accurate.state.position[0, 2] - 5.0 + fallen) / 5.0 < 1e-12


def test_the_promise_for_an_orbit_of_eccentricity_09999_lasts_while_rounding_is_small() -> None:
    """At the pericentre, 10⁻⁴ from the centre, errors in time are errors of position times 141."""
    e, duration = 0.9999, 80.0 * math.pi  # 40 orbits
    speed = 0.5 * math.sqrt((1.0 - e) / (1.0 + e))
    scene = scene_of(
        [
            {"mass": 0.5, "radius": 1e-6, "position": [0.5 * side * (1.0 + e), 0, 0], "velocity": [0, side * speed, 0]}
            for side in (-1.0, 1.0)
        ],
        time={"duration": duration, "accuracy": 1e-6, "max_dt": 1e3},
        gravity={"constant": 1.0},
        contact={"enabled": False},
    )
    promise = with_promise(scene, 1).promise
    assert promise is not None and promise.horizon is None


def asteroids(count: int, **time: Any) -> Scene:
    """Return bodies that pull each other by a tree."""
    return scene_of(
        [],
        group=[
            {
                "count": count,
                "radius": 1e-6,
                "mass": 1.0 / count,
                "region": {"shape": "ball", "radius": 1.0},
                "velocity": {"dispersion": 0.3},
            }
        ],
        time={"duration": 3.0, "accuracy": 1e-4, **time},
        gravity={"constant": 1.0, "method": "tree", "opening_angle": 0.5, "softening": 0.05},
        contact={"enabled": False},
    )


def test_a_look_ahead_ends_with_its_budget_and_says_how_far_it_came() -> None:
    spent: list[float] = []

    def watch(budget: WorkBudget) -> None:
        spent.append(budget.spent / budget.total)

    scene = with_promise(asteroids(300), 1, watch=watch)
    promise = scene.promise
    assert promise is not None and promise.looked is not None and promise.horizon is None
    assert promise.looked < 3.0
    assert promise.error_at(promise.looked) < promise.error_at(3.0) <= 1e-4, "extrapolated, and growing"
    assert max(spent) < 1.5, "each run ahead ends with its share"
    assert shortfall_text(scene) == ""


def test_a_promise_ends_where_an_extrapolated_error_grows_to_the_accuracy() -> None:
    scene = with_promise(asteroids(300, duration=60.0), 1)
    promise = scene.promise
    assert promise is not None and promise.looked is not None and promise.horizon is not None
    assert promise.looked < promise.horizon < 60.0
    assert promise.error_at(0.99 * promise.horizon) <= 1e-4 < promise.error_at(1.01 * promise.horizon)
    text = shortfall_text(scene)
    assert "cannot promise accuracy = 0.0001 to the end: its error, extrapolated from t = " in text
    assert "on, grows beyond this accuracy; it is kept up to t = " in text


@pytest.mark.parametrize(("power", "rate"), [(2.0, 0.0), (3.0, 0.0), (2.0, 1.5), (2.5, 4.0)])
def test_an_error_is_extrapolated_by_the_law_that_it_has_followed(power: float, rate: float) -> None:
    times, later = np.linspace(0.0, 2.0, 65)[1:], np.array([3.0, 10.0])
    grown = onward(times, 1e-9 * times**power * np.exp(rate * times), later)
    expected = (later / 2.0) ** power * np.exp(rate * (later - 2.0))
    assert grown / UNSEEN == pytest.approx(expected, rel=1e-6)  # rounding, magnified by the exponent of 32


def test_nothing_is_promised_beyond_the_trial_runs_where_bodies_may_touch(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("carom.physics.look_ahead.trial_run.LEAST_OF_CONTACTS", 0.01)
    scene = with_promise(cluster(60, 1e-3, touches=True), 1)
    promise = scene.promise
    assert promise is not None and promise.looked is not None and promise.horizon is not None
    assert 0.0 < promise.horizon <= promise.looked < 1.0
    assert promise.error_at(1.1 * promise.looked) == 1.0, "nothing is known beyond"
    assert "the budget of the trial runs ended at t = " in shortfall_text(scene)


def cluster(count: int, accuracy: float, touches: bool = False) -> Scene:
    """Return bodies of equal masses in a ball, for about half of the time in which one crosses it."""
    ball = {"shape": "ball", "radius": 1.0}
    members = {"count": count, "radius": 1e-3, "mass": 1.0 / count, "region": ball, "velocity": {"dispersion": 0.4}}
    return scene_of(
        [],
        group=[members],
        time={"duration": 1.0, "accuracy": accuracy},
        gravity={"constant": 1.0, "softening": 0.05},
        contact={"enabled": touches},
    )


@pytest.mark.parametrize(("accuracy", "chosen"), [(1e-3, "leapfrog"), (1e-9, None)])
def test_a_cluster_gets_the_cheapest_integrator_that_keeps_the_accuracy(accuracy: float, chosen: str | None) -> None:
    """Gauss–Radau steps, the default, err by 10⁻¹³ and cost four times as much as leapfrog's longest useful steps."""
    budgets: list[WorkBudget] = []
    promise = with_promise(cluster(200, accuracy), 1, watch=budgets.append).promise
    assert promise is not None and promise.integrator == chosen and promise.horizon is None
    # a call of a kernel goes on for some milliseconds after the budget of 0.2 s is spent
    assert max(each.spent for each in budgets) < 0.25


@pytest.mark.slow
@pytest.mark.parametrize("accuracy", [1e-2, 1e-4, 1e-8])
def test_a_cluster_keeps_the_accuracy_beside_an_integrator_of_its_own(accuracy: float) -> None:
    """DOP853 with a tolerance of 10⁻¹² shares no code with the engine."""
    scene = cluster(150, accuracy)
    space = Space(scene, 1)
    start, mass, n, softened = space.state.position.copy(), space.state.mass.copy(), 150, 0.05**2

    def slope(_: float, state: FloatArray) -> FloatArray:
        x = state[: 3 * n].reshape(n, 3)
        apart = x[np.newaxis] - x[:, np.newaxis]
        pull = mass / (np.sum(apart * apart, axis=2) + softened) ** 1.5
        return np.concatenate((state[3 * n :], np.einsum("ij,ijk->ik", pull, apart).ravel()))

    state = np.concatenate((start.ravel(), space.state.velocity.ravel()))
    exact = solve_ivp(slope, (0.0, 1.0), state, method="DOP853", rtol=1e-12, atol=1e-14).y[: 3 * n, -1]
    space.reach(1.0)
    assert space.scene.promise is not None and space.scene.promise.horizon is None
    away = space.state.position - exact.reshape(n, 3)
    size = math.sqrt(float(np.mean(np.sum((start - start.mean(axis=0)) ** 2, axis=1))))
    assert math.sqrt(float(np.mean(np.sum(away * away, axis=1)))) / size <= accuracy


@pytest.mark.slow
def test_the_promise_of_a_budget_does_not_depend_on_threads_or_on_the_clock(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(LEAST, 0.2)
    one = with_promise(asteroids(300), 1).promise
    monkeypatch.setattr("time.perf_counter", lambda: 0.0)
    assert with_promise(asteroids(300), 2).promise == one


def test_an_accuracy_of_which_nothing_can_be_promised_is_refused_with_what_could_be(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(LEAST, 1e-4)
    monkeypatch.setattr("carom.physics.look_ahead.trial_run.LEAST_STEPS", 0)
    monkeypatch.setattr("carom.physics.look_ahead.trial_run.PART_OF_RUN", 1e-4)
    with pytest.raises(SceneError, match=r"accuracy = 0\.0001 cannot be promised: .*; not even 0\.01 could be"):
        with_promise(asteroids(300), 1)


@pytest.mark.parametrize("integrator", ["gauss-radau15", "leapfrog"])
def test_the_budget_bounds_a_look_ahead_over_a_long_time(integrator: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Ten bodies for an hour of close encounters: the first comparison would take thousands of times the budget."""
    monkeypatch.setattr(LEAST, 0.1)
    monkeypatch.setattr("carom.physics.look_ahead.trial_run.PART_OF_RUN", 1e-4)
    rng = np.random.default_rng(5)
    scene = scene_of(
        [
            {"position": place, "radius": 1e-6, "mass": 0.1}
            for place in rng.uniform(-1.0, 1.0, (10, 3)).round(3).tolist()
        ],
        time={"duration": 36000.0, "accuracy": 1e-2, "integrator": integrator},
        gravity={"constant": 1.0, "softening": 0.05},
        contact={"enabled": False},
    )
    budgets: list[WorkBudget] = []
    with_promise(scene, 1, watch=budgets.append)
    assert budgets[-1].spent < 2.0 * budgets[-1].total + 0.1, "a call of a kernel goes on for 0.05 s"
