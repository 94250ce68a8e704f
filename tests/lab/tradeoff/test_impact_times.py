"""How late an impact is, against the exact course: of first order in dt at the end of a step, of second within it."""

from __future__ import annotations

import math

import numpy as np
import pytest

from carom.lab.compared_run import follow, sample_times
from carom.lab.tradeoff.event_driven_reference import solve
from carom.physics.space import Space
from carom.scene.load import Scene
from published.test_two_body_bounce import BOUNCES
from small_scenes import scene_of

END = 16.0  # s
PHASES = 40  # of the moment within a step: the error swings with it


def rolling_pair(dt: float, timing: str, integrator: str = "leapfrog") -> Scene:
    """Two unequal spheres that fall on each other slightly askew, and bounce twice."""
    bodies = [
        {"position": [x, 0.3 * k, 0], "velocity": [0, v, 0], "radius": 2.0, "mass": 1.0 + k}
        for k, (x, v) in enumerate(((-3, 0.02), (3, -0.02)))
    ]
    return scene_of(
        bodies,
        gravity={"constant": 1.0},
        contact={"restitution": 0.7, "timing": timing},
        time={"duration": END, "fixed_dt": dt, "integrator": integrator},
        record={"every": 1.0},
    )


def moments_of(scene: Scene) -> list[float]:
    """Times of all impacts in s."""
    space, moments = Space(scene), []
    while space.time < scene.time.duration:
        before, count = space.time, space.extremes.impacts
        space.compute_dynamics(space.step + 1)
        if space.extremes.impacts > count:
            into_step = space.contacts.into_step
            moments.append(before + (space.dt if into_step is None else float(into_step[0])))
    return moments


@pytest.mark.slow
@pytest.mark.parametrize(
    ("timing", "integrator", "order"),
    [("end-of-step", "leapfrog", 1), ("time-of-impact", "leapfrog", 2), ("time-of-impact", "euler", 1)],
)
def test_impact_times_have_their_order(timing: str, integrator: str, order: int) -> None:
    # Rms over both bounces and steps of slightly different length; the slope is fitted over a factor of eight.
    exact = np.array(solve(Space(rolling_pair(0.1, timing)), np.array([END])).time)
    assert len(exact) == 2
    steps, errors = [], []
    for dt in 0.16 / 2.0 ** np.arange(4):
        squares = [
            (np.array(moments_of(rolling_pair(dt * factor, timing, integrator))[:2]) - exact) ** 2
            for factor in np.linspace(0.9, 1.1, PHASES)
        ]
        steps.append(dt)
        errors.append(math.sqrt(np.mean(squares)))
    slope = np.polyfit(np.log(steps), np.log(errors), 1)[0]
    assert slope == pytest.approx(order, abs=0.1)


def test_bounces_come_when_kepler_says_to_second_order() -> None:
    # the published pair of test_two_body_bounce.py; the path of a drift is off by a τ (dt - τ)/2, at most a dt²/8,
    # and so is each flight, at speeds from 0.9 to 0.06 m/s: 1e-5 s a flight at dt = 0.01 s
    bodies = [{"position": [x, 0, 0], "radius": 2.0, "mass": 1.0} for x in (-10, 10)]
    scene = scene_of(
        bodies,
        gravity={"constant": 1.0},
        contact={"restitution": 0.5, "timing": "time-of-impact"},
        time={"duration": 83.0, "fixed_dt": 0.01},
        record={"every": 10.0},
    )
    assert moments_of(scene)[:4] == pytest.approx(BOUNCES, abs=5e-5)


def test_a_trajectory_is_right_within_the_steps_of_impacts_too() -> None:
    # Newton's cradle at a step of half a collision, in which balls are struck twice: what is compared between the steps
    # is the exact course, each leg from its impact on
    overrides = ["contact.timing=time-of-impact", "time.fixed_dt=0.07"]
    scene = Scene.load("newtons-cradle", overrides)
    exact, run = solve(Space(scene), sample_times(scene)).trajectory, follow(Space(scene), sample_times(scene))
    assert np.array_equal(np.sort(exact.pair, axis=0), np.sort(run.pair, axis=0))
    late = {tuple(pair): met for pair, met in zip(run.pair.tolist(), run.met.tolist(), strict=True)}
    for pair, met in zip(exact.pair.tolist(), exact.met.tolist(), strict=True):
        assert late[tuple(pair)] == pytest.approx(met, abs=1e-12)
    assert np.abs(run.position - exact.position).max() <= 1e-13


@pytest.mark.parametrize("dt", [0.01, 0.0025])
def test_what_touches_at_the_start_has_no_first_contact_at_any_step(dt: float) -> None:
    # the end of the first step would come earlier in a finer reference, an error of dt that no motion has
    overrides = [f"time.fixed_dt={dt}", "time.duration=0.25"]
    scene = Scene.load("billiards", overrides)
    run = follow(Space(scene), sample_times(scene))
    assert run.pair.tolist() == [[0, 1]], "the balls meet; both have touched the cloth from the start"
    assert run.met[0] == pytest.approx(0.175254, abs=1e-6)


def test_a_trajectory_is_right_within_the_step_of_an_impact_in_a_medium() -> None:
    """Equal balls, e = 1, head on in a wind: they exchange velocities, so each goes on as the other would have."""
    tau, wind = 0.7, 0.4
    scene = scene_of(
        [{"position": [x, 0, 0], "velocity": [v, 0, 0], "radius": 0.1, "mass": 1.0} for x, v in ((0, 2), (1, -1))],
        contact={"restitution": 1.0},
        drag={"relaxation_time": tau, "medium_velocity": [wind, 0, 0]},
        time={"duration": 1.0, "fixed_dt": 0.5},
        record={"every": 0.5},
    )
    times = sample_times(scene)
    run = follow(Space(scene), times)
    starts, velocities = np.array([[0.0, 1.0]]), np.array([[2.0, -1.0]])
    flown = tau * -np.expm1(-times[:, None] / tau)
    free = starts + wind * times[:, None] + (velocities - wind) * flown
    late = flown[:, 0] > 0.8 / 3.0  # the paths close at 3 m/s in that measure, from a gap of 0.8 m
    exact = np.where(late[:, None], free[:, ::-1] + [-0.2, 0.2], free)
    # the goal for an impact in a medium; errors of 4e-11 m are left by the series of its time
    assert np.abs(run.position[:, :, 0] - exact).max() <= 1e-9
