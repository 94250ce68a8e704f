"""The data kept of a run for comparison: collecting them must not change the run, nor count in its cost."""

from __future__ import annotations

import math
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from carom.lab.compared_run import Trajectory, _Watch, follow, sample_times
from carom.lab.tradeoff.reference import ErrorScale, compare, make_reference, refined
from carom.lab.tradeoff.settings_grid import vary
from carom.physics.space import Space
from carom.scene.load import Scene
from scene_strategies import scene_from
from small_scenes import cloud, pair, scene_of


def test_following_a_run_changes_no_bit() -> None:
    scene = cloud(time={"duration": 1.0})
    plain, followed = Space(scene), Space(scene)
    for _ in plain.run():
        pass
    follow(followed, sample_times(scene))
    assert plain.fingerprint() == followed.fingerprint() and plain.step == followed.step


@pytest.mark.parametrize("name", ["bouncing", "figure-eight"])
def test_a_run_followed_over_many_steps_a_call_is_the_one_followed_step_by_step(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    bouncing = scene_of(
        [{"radius": 0.1, "density": 1000.0, "position": [0.0, 0.0, 0.12], "velocity": [0.1, 0.0, 0.0]}],
        plane=[{}],
        gravity={"constant": 0.0, "uniform": [0.0, 0.0, -9.81]},
        contact={"restitution": 0.5, "static_friction": 0.3, "kinetic_friction": 0.3},
        time={"duration": 0.25},
    )  # it comes to rest and rolls
    scene = bouncing if name == "bouncing" else Scene.load(name, ["time.duration=0.3"])
    times = sample_times(scene)[::20]
    together = follow(Space(scene, 1), times)
    monkeypatch.setattr(_Watch, "quiet", lambda self, step, time: (1, time))
    single = follow(Space(scene, 1), times)
    for field in fields(Trajectory):
        ones, others = getattr(together, field.name), getattr(single, field.name)
        assert np.array_equal(ones, others, equal_nan=True), field.name


@settings(deadline=None)
@given(st.floats(1e-100, 1e100), st.sampled_from([2, 30]))
@example(2 * math.pi * 9, 2)
@example(2 * math.pi * 18, 2)
@example(2 * math.pi * 36, 2)
@example(2 * math.pi * 39, 2)
@example(1e100, 2)
def test_samples_rise_to_the_duration_of_the_scene_and_end_exactly_there(duration: float, bodies: int) -> None:
    bodies_apart = [{"position": [3.0 * k, 0.0, 0.0]} for k in range(bodies)]
    times = sample_times(scene_from({"time": {"duration": duration}, "body": bodies_apart}))
    assert times[-1] == duration and times[0] > 0.0 and np.all(np.diff(times) > 0.0)


@pytest.mark.parametrize("turns", [9, 18, 36, 39])
def test_a_run_of_whole_turns_is_followed_to_its_end(turns: int) -> None:
    # 2 pi n * 600 / 600 is one unit in the last place past the end for these n
    scene = pair(speed=1e-3, time={"duration": 2 * math.pi * turns, "fixed_dt": 20.0})
    assert len(follow(Space(scene), sample_times(scene))) == 600


def test_a_flight_between_steps_is_exact() -> None:
    # no forces, so the polynomial is the flight itself; the impact at t = 1 is found at a step's end
    smooth = {"restitution": 1.0, "static_friction": 0.0, "timing": "end-of-step"}
    scene = pair(time={"duration": 2.0, "fixed_dt": 0.0371}, contact=smooth)
    run = follow(Space(scene), sample_times(scene))
    steps = np.arange(100) * 0.0371
    struck = steps[steps >= 1.0][0]
    before = run.time < struck
    assert np.allclose(run.position[before, 0, 0], -2.0 + run.time[before], rtol=0, atol=1e-14)
    late = run.time[~before]
    assert np.allclose(run.position[~before, 0, 0], -2.0 + struck - (late - struck), rtol=0, atol=1e-14)
    assert run.pair.tolist() == [[0, 1]] and run.met == pytest.approx([struck], abs=1e-12)


@pytest.mark.parametrize("timing", ["end-of-step", "time-of-impact"])
def test_a_ball_that_rolls_down_an_incline_is_exact_at_the_ends_of_steps_and_between(timing: str) -> None:
    angle = math.radians(20.0)
    scene = scene_of(
        [{"radius": 0.1, "density": 1000.0, "position": [0.0, 0.0, 0.1]}],
        plane=[{}],
        gravity={"constant": 0.0, "uniform": [9.81 * math.sin(angle), 0.0, -9.81 * math.cos(angle)]},
        contact={"restitution": 0.0, "static_friction": 0.3, "kinetic_friction": 0.3, "timing": timing},
        time={"duration": 0.5},
    )
    ends = [frame.time for frame in Space(scene).run(schedule=lambda step, before, time: True)]
    times = np.unique([*ends[1:], *sample_times(scene)])
    run = follow(Space(scene), times)
    still, rolled = np.zeros_like(times), 5.0 / 7.0 * 9.81 * math.sin(angle) * times
    # rounding of a thousand sums, each up to 1e-16 of 1.2 m/s and of 0.3 m
    assert np.abs(run.velocity[:, 0].T - [rolled, still, still]).max() <= 1e-13
    assert np.abs(run.position[:, 0].T - [rolled * times / 2.0, still, still + 0.1]).max() <= 1e-13


def test_a_body_that_leaves_a_periodic_box_is_followed_through_its_side() -> None:
    scene = Scene.from_dict(
        {
            "time": {"duration": 4.0, "fixed_dt": 0.3},
            "gravity": {"constant": 0.0},
            "domain": {"boundary": "periodic", "size": [4.0, 4.0, 4.0]},
            "body": [{"velocity": [1.0, 0, 0], "radius": 0.1}, {"position": [0, 1, 0], "radius": 0.1}],
        }
    )
    run = follow(Space(scene), sample_times(scene))
    x = run.position[:, 0, 0] - run.time
    assert np.allclose(x - 4.0 * np.round(x / 4.0), 0.0, rtol=0, atol=1e-13)
    box = np.array([4.0, 4.0, 4.0])
    apart, _ = ErrorScale.of(run, box).apart(run, run)
    assert not apart.any()


def test_a_trajectory_is_read_as_it_was_written(tmp_path: Path) -> None:
    scene = pair(time={"duration": 2.0, "fixed_dt": 0.05})
    run = follow(Space(scene), sample_times(scene))
    run.save(tmp_path / "run.npz")
    read = Trajectory.load(tmp_path / "run.npz")
    assert np.array_equal(read.position, run.position) and np.array_equal(read.pair, run.pair)
    assert (read.impacts, read.steps, read.overlap) == (run.impacts, run.steps, run.overlap)
    np.savez(tmp_path / "other.npz", time=np.zeros(3))
    with pytest.raises(ValueError, match="it contains no position"):
        Trajectory.load(tmp_path / "other.npz")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("integrator", "order"),
    [("euler", 1), ("leapfrog", 2), ("leapfrog-dkd", 2), pytest.param("yoshida4", 4, marks=pytest.mark.slow)],
)
def test_errors_against_the_reference_fall_with_the_order_of_the_integrator(integrator: str, order: int) -> None:
    scene = Scene.load("figure-eight")
    reference = make_reference(scene)
    factors = np.array([8.0, 4.0, 2.0, 1.0])
    errors = []
    for setting in vary(scene, [f"time.integrator={integrator}", "step=8,4,2,1"]):
        found = reference.errors(follow(Space(setting.apply(scene)), sample_times(scene)))
        errors.append((found.position, found.velocity))
    for kind in np.array(errors).T:
        assert np.polyfit(np.log(factors), np.log(kind), 1)[0] == pytest.approx(order, abs=0.1)


@pytest.mark.slow
def test_impacts_at_the_end_of_a_step_are_late_by_half_a_step_on_average() -> None:
    # gaps of 0.5 mm take a quarter of a step: the chain's contacts are late by anything up to dt each, and add up
    late = ["contact.timing=end-of-step"]
    scene = Scene.load("newtons-cradle", late)
    reference = make_reference(scene)
    errors = []
    for factor in (4.0, 0.25):
        setting = Scene.load("newtons-cradle", late + refined(scene, 1 / factor))
        errors.append(reference.errors(follow(Space(setting), sample_times(scene))))
    assert all(error.missed == 0.0 for error in errors)
    assert errors[0].impact <= 6 * 0.008 and errors[1].impact <= 6 * 0.0005
    assert errors[1].impact < errors[0].impact / 8, "first order"


@pytest.mark.slow
def test_a_pair_that_never_meets_counts_as_met_at_the_horizon() -> None:
    scene = pair(time={"duration": 2.0, "fixed_dt": 0.05})
    reference = make_reference(scene)
    missing = follow(
        Space(pair(time={"duration": 2.0, "fixed_dt": 0.05}, contact={"enabled": False})), sample_times(scene)
    )
    errors = compare(missing, reference.trajectory, reference.scale, reference.samples, True)
    assert errors.missed == 1.0 and errors.impact == pytest.approx(reference.horizon - 1.0, abs=1e-9)


@pytest.mark.parametrize("timing", ["end-of-step", "time-of-impact"])
@pytest.mark.parametrize("steps_left", [0.5, 1.5, 2.5])
def test_contacts_of_the_last_steps_are_noted(steps_left: float, timing: str) -> None:
    # no schedule requires the last step; the sample before it was once lost with it
    elastic = {"restitution": 1.0, "timing": timing}
    scene = pair(time={"fixed_dt": 0.01, "duration": 1.0 + 0.01 * steps_left}, contact=elastic)
    run = follow(Space(scene), sample_times(scene))
    assert run.pair.tolist() == [[0, 1]]
    assert 1.0 - 1e-12 <= run.met[0] <= 1.0 + 0.01 * min(steps_left, 1.0) + 1e-12


def test_a_body_that_came_to_rest_has_sunk_by_the_overlap_it_keeps() -> None:
    def sinking(how: str) -> float:
        stack = [{"position": [0.0, 0.0, 1.0 + 2.0 * k], "velocity": [0.0, 0.0, -0.5]} for k in range(3)]
        scene = scene_of(
            stack,
            plane=[{}],
            contact={"stabilisation": how, "restitution": 0.0, "static_friction": 0.0},
            gravity={"constant": 0.0, "uniform": [0.0, 0.0, -9.81]},
            time={"duration": 2.0, "fixed_dt": 0.01},
        )
        space = Space(scene)
        run = follow(space, sample_times(scene))
        kept = space.contacts.overlaps.mean()  # radii of 1: nothing moves any more, and all late samples are alike
        assert run.sinking == pytest.approx(kept, rel=1e-3, abs=1e-12)
        return run.sinking

    # the lowest lands at up to 0.6 m/s, and sinks by up to a step of that; pushes undo it to rounding
    assert 1e-4 < sinking("none") < 6e-3
    assert sinking("split") < 1e-14
    gas = pair(time={"duration": 2.0})
    assert np.isnan(follow(Space(gas), sample_times(gas)).sinking)


def test_an_error_over_time_has_an_rms_a_largest_value_and_one_at_the_end() -> None:
    scene = pair(time={"duration": 1.0, "fixed_dt": 0.1})
    exact = follow(Space(scene), sample_times(scene))
    shift = np.linspace(-0.3, 0.1, len(exact))
    moved = replace(exact, position=exact.position + shift[:, None, None] * [1.0, 0.0, 0.0])
    scale = ErrorScale(length=2.0, speed=1.0)
    errors = compare(moved, exact, scale, len(exact), whole=True)
    assert errors.position == pytest.approx(np.sqrt(np.mean(shift**2)) / 2.0)
    assert errors.position_max == pytest.approx(0.15) and errors.position_end == pytest.approx(0.05)
    assert errors.velocity_max == errors.velocity_end == 0.0
    cut = compare(moved, exact, scale, len(exact) // 2, whole=True)
    assert math.isnan(cut.position_end) and cut.position_max == pytest.approx(0.15), "known only so far"
