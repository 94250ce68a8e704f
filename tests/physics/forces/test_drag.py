"""Stokes' drag: exact for a body alone, of second order with other forces, and every joule of it in the ledger."""

from __future__ import annotations

import math
from decimal import Decimal, localcontext
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from carom.errors import SceneError
from carom.physics.exponential import exponentials
from carom.physics.space import Space
from carom.plan.auto import integrator
from carom.plan.checks import refuse_impossible
from carom.plan.features import require
from carom.scene.load import Scene
from carom.state.frame import Frame
from seeds import examples
from small_scenes import scene_of

Sections = dict[str, Any]
EPS = np.finfo(float).eps
FLOOR: Sections = {"plane": [{}], "gravity": {"constant": 0.0, "uniform": [0.0, 0.0, -9.81]}}


def run(scene: Scene, threads: int = 1) -> tuple[Space, Frame]:
    space = Space(scene, threads)
    return space, list(space.run())[-1]


def cloud(steps: int, **sections: Any) -> Scene:
    """Sixty spheres that move and spin at random, for a second."""
    group = {"count": 60, "radius": 0.1, "region": {"radius": 1.5}, "velocity": {"dispersion": 1.0}}
    time = {"duration": 1.0, "fixed_dt": 1.0 / steps}
    return Scene.from_dict({"seed": 3, "time": time, "group": [{**group, "spin": {"dispersion": 1.0}}], **sections})


@pytest.mark.parametrize("z", [0.0, 1e-300, 1e-12, 1e-3, 0.1, 0.5, 0.999, 1.0, 1.0001, 2.0, 5.0, 30.0, 300.0, 700.0])
def test_the_exponential_and_its_relatives_are_right_to_a_rounding_or_two(z: float) -> None:
    with localcontext() as context:
        context.prec = 700
        exact = (-Decimal(z)).exp()
        first = (1 - exact) / Decimal(z) if z else Decimal(1)
        second = (1 - first) / Decimal(z) if z else Decimal("0.5")
        for ours, theirs in zip(exponentials(z), (exact, first, second), strict=True):
            assert abs(Decimal(ours) - theirs) <= 2 * Decimal(EPS) * theirs
    assert exponentials(1e5)[0] == 0.0


coordinates = st.floats(-10.0, 10.0).map(lambda value: round(value, 6))
vectors = st.tuples(coordinates, coordinates, coordinates)


@examples(60)
@given(
    dt=st.floats(0.01, 10.0),
    tau=st.floats(0.01, 100.0),
    u=vectors,
    g=vectors,
    v=vectors,
    steps=st.integers(1, 20),
)
def test_a_body_alone_follows_the_exact_solution_at_any_step(
    dt: float, tau: float, u: tuple[float, ...], g: tuple[float, ...], v: tuple[float, ...], steps: int
) -> None:
    scene = scene_of(
        [{"velocity": list(v), "mass": 2.0}],
        time={"duration": steps * dt, "fixed_dt": dt, "max_dt": dt},
        gravity={"constant": 0.0, "uniform": list(g)},
        drag={"relaxation_time": tau, "medium_velocity": list(u)},
    )
    space, frame = run(scene)
    t, terminal = space.time, np.array(u) + np.array(g) * tau
    decay = -math.expm1(-t / tau)
    speeds = np.abs(v).max() + np.abs(terminal).max() + np.abs(u).max()
    # a rounding or two of each of the quantities that a step adds up, and the rounding of the clock
    tolerance = 20 * EPS * (steps + 2)
    exact = terminal * t + (np.array(v) - terminal) * tau * decay
    assert frame.position[0] == pytest.approx(exact, rel=0, abs=tolerance * speeds * t)
    assert frame.velocity[0] == pytest.approx(np.array(v) + (terminal - v) * decay, rel=0, abs=tolerance * speeds)
    energies = speeds * speeds + float(np.abs(g).max()) * speeds * t
    assert abs(frame.energy.integration_error) <= 10 * tolerance * 2.0 * energies
    assert frame.momentum_error is not None and frame.momentum_error <= 1e-12
    assert frame.angular_momentum_error is not None and frame.angular_momentum_error <= 1e-11


def test_a_body_falls_at_terminal_velocity_in_steps_longer_than_the_relaxation_time() -> None:
    _, frame = run(
        scene_of(
            [{"velocity": [5.0, 0.0, 0.0]}],
            time={"duration": 100.0, "fixed_dt": 10.0},
            gravity={"constant": 0.0, "uniform": [0.0, 0.0, -9.81]},
            drag={"relaxation_time": 0.5, "medium_velocity": [1.0, 0.0, 0.0]},
        )
    )
    assert frame.velocity[0] == pytest.approx([1.0, 0.0, -9.81 * 0.5], rel=1e-14)


def _rates(time: float, y: Any) -> Any:
    """A planet around a fixed sun, G M = 1, dragged along by a medium."""
    x, v = y[:3], y[3:]
    return np.concatenate((v, -x / np.dot(x, x) ** 1.5 - (v - [0.1, 0.0, 0.0]) / 1.5))


def test_gravity_with_drag_is_of_second_order() -> None:
    sun = {"mass": 1.0, "radius": 0.1, "fixed": True}
    planet = {"mass": 1e-3, "radius": 0.1, "position": [1, 0, 0], "velocity": [0, 1.0, 0.2]}

    def end(steps: int) -> Frame:
        return run(
            scene_of(
                [sun, planet],
                time={"duration": 2.0, "fixed_dt": 2.0 / steps},
                gravity={"constant": 1.0},
                contact={"enabled": False},
                drag={"relaxation_time": 1.5, "medium_velocity": [0.1, 0.0, 0.0]},
            )
        )[1]

    coarse, half = end(800), end(1600)
    exact = solve_ivp(_rates, (0.0, 2.0), [1, 0, 0, 0, 1.0, 0.2], method="DOP853", rtol=1e-12, atol=1e-12).y[:3, -1]
    errors = [np.linalg.norm(frame.position[1] - exact) for frame in (coarse, half)]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2.0, abs=0.05)
    energies = [abs(frame.energy.integration_error) for frame in (coarse, half)]
    assert np.log2(energies[0] / energies[1]) == pytest.approx(2.0, abs=0.1)


@pytest.mark.parametrize(
    ("timing", "steps", "tau"),
    [("end-of-step", 100, 0.5), ("time-of-impact", 100, 0.5), ("time-of-impact", 2, 0.25), ("time-of-impact", 2, 0.05)],
)
def test_the_ledger_of_a_dragged_gas_that_collides_closes_to_rounding(timing: str, steps: int, tau: float) -> None:
    # Without a force that changes along a step nothing is left to the integrator. In ten relaxation times a step, paths
    # are not the exact ones.
    medium = {"relaxation_time": tau, "medium_velocity": [1.0, 0.0, 0.0]}
    contact = {"timing": timing, "restitution": 0.9}
    space, frame = run(cloud(steps, gravity={"constant": 0.0}, contact=contact, drag=medium))
    losses = frame.energy.ledger.restitution, frame.energy.ledger.friction
    assert space.extremes.impacts >= 5 and min(losses) > 0.1  # of some 300 J
    assert frame.energy.relative_error <= 1e-13
    assert frame.momentum_error is not None and frame.momentum_error <= 1e-13
    assert frame.angular_momentum_error is not None and frame.angular_momentum_error <= 1e-13


def test_the_ledger_and_momenta_of_a_dragged_cloud_close_under_its_own_gravity() -> None:
    errors = []
    for steps in (100, 200):
        drag = {"relaxation_time": 0.5}
        gravity = {"constant": 1e-3, "softening": 0.1, "uniform": [0, 0, -1]}
        space, frame = run(cloud(steps, gravity=gravity, contact={"enabled": False}, drag=drag))
        errors.append(abs(frame.energy.integration_error))
        assert space.extremes.momentum_error is not None and space.extremes.momentum_error.value <= 1e-13
        assert space.extremes.angular_momentum_error is not None
        assert space.extremes.angular_momentum_error.value <= 1e-13
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2.0, abs=0.1)


@pytest.mark.parametrize("dt", [0.01, 0.1, 1.0])
@pytest.mark.parametrize("wind", [[0.0, 0.0, 0.0], [0.0, 0.0, -3.0]])
def test_a_ball_at_rest_on_a_floor_books_nothing(dt: float, wind: list[float]) -> None:
    # From a thirtieth of the relaxation time to three times it. 10 J are the scale: its weight times its radius.
    ball = {"radius": 1.0, "position": [0, 0, 1.0], "mass": 1.0}
    drag = {"relaxation_time": 0.3, "medium_velocity": wind}
    space, frame = run(scene_of([ball], **FLOOR, time={"duration": 100 * dt, "fixed_dt": dt}, drag=drag))
    ledger = frame.energy.ledger
    assert max(abs(ledger.restitution), abs(ledger.friction), abs(ledger.entry("drag"))) <= 1e-12
    assert abs(frame.velocity).max() <= 1e-14 and space.extremes.warned == ()


@pytest.mark.parametrize("tau", [0.1, 1.0])
def test_the_impulses_of_a_ball_at_rest_are_its_weight_over_the_kicks(tau: float) -> None:
    h, weight = 0.1, 20.0
    scene = scene_of(
        [{"position": [0.0, 0.0, 1.0], "radius": 1.0, "mass": 2.0}],
        plane=[{}],
        gravity={"constant": 0.0, "uniform": [0.0, 0.0, -10.0]},
        drag={"relaxation_time": tau},
        contact={"restitution": 0.0},
        time={"duration": 2.0, "fixed_dt": h},
    )
    space = Space(scene, record_contacts=True)
    frame = list(space.run())[-1]
    decay, phi1, phi2 = exponentials(h / tau)
    kicks = h * phi2 + h * (phi1 - decay * phi2 / phi1)
    assert frame.contact_rows is not None
    assert frame.contact_rows["normal_impulse"] == pytest.approx([weight * kicks], rel=1e-12)  # rounding of 20 steps


def test_a_wind_alone_presses_a_ball_to_a_floor() -> None:
    ball = {"radius": 1.0, "position": [0, 0, 1.0], "mass": 1.0}
    drag = {"relaxation_time": 0.3, "medium_velocity": [0.0, 0.0, -3.0]}
    time = {"duration": 1.0, "fixed_dt": 0.01}
    scene = scene_of([ball], plane=[{}], gravity={"constant": 0.0}, time=time, drag=drag)
    assert require(scene).resting.modelled and "drag presses" in require(scene).resting.why
    _, frame = run(scene)
    assert abs(frame.velocity).max() <= 1e-14 and frame.position[0, 2] == pytest.approx(1.0, abs=1e-12)


def test_friction_of_a_ball_that_a_wind_rolls_vanishes_with_the_square_of_the_step() -> None:
    ball = {"radius": 1.0, "position": [0, 0, 1.0], "mass": 1.0}
    drag = {"relaxation_time": 0.3, "medium_velocity": [0.1, 0.0, 0.0]}
    rubbed = []
    for dt in (0.02, 0.01):
        _, frame = run(scene_of([ball], **FLOOR, time={"duration": 2.0, "fixed_dt": dt}, drag=drag))
        rubbed.append(abs(frame.energy.ledger.friction))
        assert frame.velocity[0, 0] == pytest.approx(0.1, rel=0.02)
        assert frame.energy.relative_error <= 1e-13
    assert np.log2(rubbed[0] / rubbed[1]) == pytest.approx(2.0, abs=0.1)


def test_a_medium_that_moves_drives_bodies_and_raises_no_alarm() -> None:
    drag = {"relaxation_time": 0.2, "medium_velocity": [3.0, 0.0, 0.0]}
    space, frame = run(cloud(100, gravity={"constant": 0.0}, drag=drag))
    assert frame.energy.ledger.entry("drag") < 0.0, "it put more in than it took out"
    assert space.extremes.warned == () and space.extremes.energy_gain.value <= 1e-12


def test_a_wind_does_not_move_fixed_bodies() -> None:
    post = {"fixed": True, "position": [5.0, 0.0, 0.0]}
    drag = {"relaxation_time": 0.2, "medium_velocity": [3.0, 0.0, 0.0]}
    _, frame = run(scene_of([{}, post], gravity={"constant": 0.0}, time={"duration": 1.0}, drag=drag))
    assert np.array_equal(frame.position[1], [5.0, 0.0, 0.0]) and not frame.velocity[1].any()
    assert frame.position[0, 0] > 1.0


def test_a_run_with_drag_goes_on_from_a_checkpoint_with_the_same_bits_and_books() -> None:
    drag = {"relaxation_time": 0.5, "medium_velocity": [0.3, 0.0, 0.0]}
    scene = cloud(60, gravity={"constant": 0.0, "uniform": [0, 0, -1]}, plane=[{"point": [0, 0, -2]}], drag=drag)
    frames = list(Space(scene, 1).run())
    space = Space(scene, 2)
    space.restore(frames[len(frames) // 2].checkpoint)
    end = list(space.run())[-1]
    assert end.fingerprint == frames[-1].fingerprint
    assert end.energy == frames[-1].energy


def test_drag_is_a_part_of_the_model_with_its_reason() -> None:
    part = require(cloud(10, drag={"relaxation_time": 2.0})).forces["drag"]
    assert part.modelled and part.why == "drag.relaxation_time = 2 s"
    assert require(cloud(10)).forces["drag"].why == "no [drag]"
    with pytest.raises(SceneError, match=r"there is no medium; add \[drag\]"):
        require(cloud(10, model={"force": "drag"}))


def test_bodies_that_drag_and_pull_get_the_leapfrog_that_has_room_for_both() -> None:
    points: Sections = {"contact": {"enabled": False}, "gravity": {"constant": 1.0}}
    assert integrator(scene_of([{}, {"position": [9, 0, 0]}], **points)).name == "gauss-radau15"
    dragged = scene_of([{}, {"position": [9, 0, 0]}], **points, drag={"relaxation_time": 1.0})
    assert integrator(dragged).name == "leapfrog"
    assert "the only integrator that supports drag" in require(dragged).integrator.why


@pytest.mark.parametrize("name", ["euler", "leapfrog-dkd", "yoshida4"])
def test_other_integrators_are_refused_with_the_key_and_a_remedy(name: str) -> None:
    scene = cloud(
        10,
        contact={"enabled": False},
        drag={"relaxation_time": 1.0},
        time={"duration": 1.0, "integrator": name},
    )
    with pytest.raises(SceneError, match=rf'time\.integrator = "{name}" with \[drag\].*use "leapfrog"'):
        refuse_impossible(scene)


@pytest.mark.parametrize(
    ("section", "words"),
    [
        ({"relaxation_time": 0.0}, ["drag.relaxation_time = 0.0", "more than 0"]),
        ({"relaxation_time": -1.0}, ["drag.relaxation_time = -1.0", "more than 0"]),
        ({"relaxation_time": math.nan}, ["drag.relaxation_time = nan", "finite number"]),
        ({"relaxation_time": 1.0, "medium_velocity": [0.0, math.inf, 0.0]}, ["drag.medium_velocity", "finite number"]),
        ({"medium_velocity": [1.0, 0.0, 0.0]}, ["drag.relaxation_time is missing"]),
        ({"relaxation_time": 1e-60, "medium_velocity": [1e60, 0.0, 0.0]}, ["drag", "raise relaxation_time"]),
        ({"relaxation_time": 1.0, "tau": 2.0}, ["unknown key drag.tau"]),
    ],
)
def test_a_medium_that_cannot_be_is_refused_by_its_key(section: Sections, words: list[str]) -> None:
    with pytest.raises(SceneError) as refusal:
        scene_of([{}], drag=section)
    for word in words:
        assert word in str(refusal.value)
