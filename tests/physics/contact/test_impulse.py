"""One collision: the kernel does what the readable form says, and what mechanics says."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from carom.physics.bodies import Bodies
from carom.physics.diagnostics.ledger import FRICTION, RESTITUTION, STABILISATION
from carom.physics.reference_api import BodyProxy, CollisionContext
from carom.physics.space import Space
from seeds import examples
from small_scenes import angular_momentum_of, kinetic_energy_of, momentum_of, random_bodies, scene_of, solver_of

FloatArray = NDArray[np.float64]

PAIR = np.array([[0, 1]])
ALONG_X = np.array([1.0, 0.0, 0.0])


def touching_pair(seed: int, overlap: float = 0.1, spins: bool = True) -> Bodies:
    """Two bodies of unequal mass and radius in contact, in any motion."""
    bodies = random_bodies(2, seed, spins)
    direction = np.random.default_rng(seed).standard_normal(3)
    direction /= np.linalg.norm(direction)
    bodies.position[0] = 0.0
    bodies.position[1] = direction * (bodies.radius.sum() - overlap * bodies.radius.min())
    return bodies


def resolve(
    bodies: Bodies,
    restitution: float = 0.5,
    static_friction: float = 0.0,
    kinetic_friction: float = 0.0,
    bias_rate: float = 0.0,
    rest_speed: float = 0.0,
) -> FloatArray:
    """Resolve the contact of a pair in one pass of the kernel; return its ledger."""
    solver = solver_of(bodies, PAIR, [restitution, static_friction, kinetic_friction])
    solver.rest_speed[:] = solver.load_speed[:] = rest_speed
    solver.resolve_impacts(bias_rate, max_iterations=1, impacts_only=False)
    return np.asarray(solver.ledger[0])


def closing(bodies: Bodies) -> bool:
    separation = bodies.position[1] - bodies.position[0]
    return bool((bodies.velocity[1] - bodies.velocity[0]) @ separation < 0)


coefficients = st.tuples(st.floats(0, 1), st.floats(0, 2), st.floats(0, 1)).map(lambda c: (c[0], c[1], c[1] * c[2]))


@examples(200)
@given(seed=st.integers(0, 10**6), e_mu=coefficients, bias=st.floats(0, 2))
def test_the_kernel_does_what_the_readable_form_says(seed: int, e_mu: tuple[float, float, float], bias: float) -> None:
    e, mu_s, mu_k = e_mu
    fast, readable = touching_pair(seed), touching_pair(seed)
    context = CollisionContext.from_bodies(BodyProxy(readable, 0), BodyProxy(readable, 1))
    assert context is not None
    rate = bias / context.overlap
    resolve(fast, e if closing(fast) else 0.0, mu_s, mu_k, bias_rate=rate)
    context.resolve(e if closing(readable) else 0.0, mu_s, mu_k, bias=rate * context.overlap)
    # The same few dozen operations in another order, on numbers of order 10.
    assert np.allclose(fast.velocity, readable.velocity, rtol=0, atol=1e-13)
    assert np.allclose(fast.angular_velocity, readable.angular_velocity, rtol=0, atol=1e-13)


@examples(200)
@given(seed=st.integers(0, 10**6), e_mu=coefficients, overlap=st.floats(0, 1))
def test_momentum_and_angular_momentum_are_kept_however_deep_the_overlap(
    seed: int, e_mu: tuple[float, float, float], overlap: float
) -> None:
    bodies = touching_pair(seed, overlap)
    p, L = momentum_of(bodies), angular_momentum_of(bodies)
    resolve(bodies, *e_mu)
    assert np.allclose(momentum_of(bodies), p, rtol=0, atol=1e-13)
    assert np.allclose(angular_momentum_of(bodies), L, rtol=0, atol=1e-13)


@examples(200)
@given(seed=st.integers(0, 10**6), e_mu=coefficients, bias=st.floats(0, 5))
def test_the_ledger_is_the_change_of_the_energy(seed: int, e_mu: tuple[float, float, float], bias: float) -> None:
    bodies = touching_pair(seed)
    before = kinetic_energy_of(bodies)
    ledger = resolve(bodies, *e_mu, bias_rate=bias)
    change = ledger[STABILISATION] - ledger[RESTITUTION] - ledger[FRICTION]
    assert kinetic_energy_of(bodies) - before == pytest.approx(change, abs=1e-13 * max(before, 1.0))
    assert ledger[RESTITUTION] >= 0.0
    assert ledger[STABILISATION] >= -1e-15 * max(before, 1.0)
    if bias == 0.0:
        assert kinetic_energy_of(bodies) <= before * (1 + 1e-14)


@examples(100)
@given(seed=st.integers(0, 10**6), e=st.floats(0, 1))
def test_the_rebound_is_the_approach_times_the_restitution(seed: int, e: float) -> None:
    bodies = touching_pair(seed, spins=False)
    normal = bodies.position[1] / np.linalg.norm(bodies.position[1])
    approach = (bodies.velocity[1] - bodies.velocity[0]) @ normal
    resolve(bodies, restitution=e)
    rebound = (bodies.velocity[1] - bodies.velocity[0]) @ normal
    assert rebound == pytest.approx(-e * approach if approach < 0 else approach, abs=1e-14)


def test_an_equal_sphere_at_rest_takes_over_all_the_velocity() -> None:
    # Jolt once let both move at half speed here (its issue 1403).
    bodies = touching_pair(0, spins=False)
    bodies.mass[:] = 2.0
    bodies.ends.inverse_mass[:] = 0.5
    bodies.position[1] = [bodies.radius.sum(), 0.0, 0.0]
    bodies.velocity[:] = [[3.0, 0.0, 0.0], [0.0, 0.0, 0.0]]
    resolve(bodies, restitution=1.0)
    assert np.array_equal(bodies.velocity, [[0.0, 0.0, 0.0], [3.0, 0.0, 0.0]])


def test_a_separating_contact_is_left_alone() -> None:
    bodies = touching_pair(0)
    bodies.position[1] = [bodies.radius.sum() * 0.99, 0.0, 0.0]
    bodies.velocity[:] = [[-1.0, 2.0, 0.0], [1.0, 0.0, 0.0]]
    before = bodies.velocity.copy(), bodies.angular_velocity.copy()
    resolve(bodies, 0.5, 0.9, 0.9)
    assert np.array_equal(bodies.velocity, before[0]) and np.array_equal(bodies.angular_velocity, before[1])


def test_an_approach_slower_than_the_rest_speed_does_not_bounce() -> None:
    bodies = touching_pair(0, spins=False)
    bodies.position[1] = [bodies.radius.sum(), 0.0, 0.0]
    bodies.velocity[:] = [[0.1, 0.0, 0.0], [0.0, 0.0, 0.0]]
    resolve(bodies, restitution=1.0, rest_speed=0.1)
    assert bodies.velocity[1, 0] == pytest.approx(bodies.velocity[0, 0], abs=1e-16)


@examples(100)
@given(seed=st.integers(0, 10**6))
def test_enough_static_friction_stops_the_slip_at_the_contact_point(seed: int) -> None:
    bodies = touching_pair(seed)
    normal = bodies.position[1] / np.linalg.norm(bodies.position[1])
    closing_speed = (bodies.velocity[0] - bodies.velocity[1]) @ normal
    bodies.velocity[1] -= (3.0 - closing_speed) * normal
    resolve(bodies, 0.5, 1e6, 1e6)
    context = CollisionContext.from_bodies(BodyProxy(bodies, 0), BodyProxy(bodies, 1))
    assert context is not None
    slip = context.v_rel - (context.v_rel @ context.n_vec) * context.n_vec
    assert np.abs(slip).max() <= 1e-13


def test_a_sliding_contact_feels_the_kinetic_coefficient_times_the_normal_impulse() -> None:
    bodies = touching_pair(0)
    bodies.angular_velocity[:] = 0.0
    bodies.position[1] = [bodies.radius.sum(), 0.0, 0.0]
    bodies.velocity[:] = [[1.0, 50.0, 0.0], [0.0, 0.0, 0.0]]
    before = momentum_of(bodies)[1]
    bodies_before = bodies.velocity.copy()
    resolve(bodies, 0.5, 0.3, 0.2)
    normal = bodies.mass[1] * bodies.velocity[1, 0]
    tangential = bodies.mass[1] * bodies.velocity[1, 1]
    assert tangential == pytest.approx(0.2 * normal, rel=1e-14)
    assert bodies.velocity[0, 1] < bodies_before[0, 1]
    assert momentum_of(bodies)[1] == pytest.approx(before, rel=1e-15)


def test_friction_turns_both_bodies_the_same_way_round() -> None:
    bodies = touching_pair(0)
    bodies.angular_velocity[:] = 0.0
    bodies.position[1] = [bodies.radius.sum(), 0.0, 0.0]
    bodies.velocity[:] = [[1.0, 1.0, 0.0], [0.0, 0.0, 0.0]]
    resolve(bodies, 0.5, 0.5, 0.5)
    assert bodies.angular_velocity[0, 2] < 0 and bodies.angular_velocity[1, 2] < 0


def test_bodies_that_do_not_touch_have_no_collision() -> None:
    bodies = touching_pair(0)
    bodies.position[1] *= 1.5
    assert CollisionContext.from_bodies(BodyProxy(bodies, 0), BodyProxy(bodies, 1)) is None


def test_an_impulse_off_centre_turns_and_moves_the_body() -> None:
    bodies = random_bodies(1, 0)
    body = BodyProxy(bodies, 0)
    bodies.velocity[:], bodies.angular_velocity[:] = 0.0, 0.0
    body.apply_impulse(np.array([0.0, 2.0, 0.0]), np.array([0.5, 0.0, 0.0]))
    assert np.allclose(body.velocity, [0, 2.0 / body.mass, 0])
    assert np.allclose(body.angular_velocity, [0, 0, 1.0 / body.inertia])


@pytest.mark.parametrize("restitution", [1.0, 0.5])
@pytest.mark.parametrize("order", [[0, 1, 2, 3, 4], [4, 3, 2, 1, 0], [2, 0, 4, 1, 3]])
def test_a_row_struck_at_its_end_has_one_impact_for_each_contact_in_any_order_of_the_balls(
    order: list[int], restitution: float
) -> None:
    row: list[dict[str, Any]] = [{"position": [3.0 + 2.0 * k, 0, 0], "mass": 1.0} for k in range(4)]
    row.append({"position": [0, 0, 0], "velocity": [1.0, 0, 0], "mass": 1.0})
    late = {"timing": "end-of-step", "restitution": restitution}
    # Steps are parts of 1 s that are powers of two: the striker touches exactly at the end of the sixteenth.
    time = {"duration": 1.0, "fixed_dt": 0.0625}
    space = Space(scene_of([row[k] for k in order], gravity={"constant": 0.0}, contact=late, time=time))
    for _ in space.run():
        pass
    assert space.extremes.impacts == 4
    assert space.extremes.impact is not None and space.extremes.impact.value == 0.25, "½ μ v²: the first blow"


def test_the_hardest_impact_may_be_one_that_a_neighbour_passed_on() -> None:
    # A ball of 3 kg throws one of 1 kg at 1.5 times its speed against the next of 1 kg: ½ ½ 1.5² J and ½ ¾ 1² J.
    masses = zip((0.0, 3.0, 5.0), (3.0, 1.0, 1.0), strict=True)
    bodies = [{"position": [x, 0, 0], "mass": mass, "velocity": [float(x == 0), 0, 0]} for x, mass in masses]
    for order in ([0, 1, 2], [2, 1, 0], [1, 0, 2]):
        late = {"timing": "end-of-step", "restitution": 1.0}
        time = {"duration": 1.0, "fixed_dt": 0.0625}
        scene = scene_of([bodies[k] for k in order], gravity={"constant": 0.0}, contact=late, time=time)
        space = Space(scene)
        for _ in space.run():
            pass
        assert space.extremes.impacts == 2, "the third blow is of the first pair again, in the same step"
        assert space.extremes.impact is not None and space.extremes.impact.value == 0.5625
        assert set(space.extremes.impact.bodies) == {order.index(1), order.index(2)}


def test_a_heavy_ball_at_rest_is_no_harder_an_impact_than_a_light_one_that_falls() -> None:
    """In a step the field moves 1000 t at rest towards the floor with more energy than 1 kg has after its fall."""
    heavy = {"position": [0.0, 0.0, 1.0], "radius": 1.0, "mass": 1e6}
    light = {"position": [5.0, 0.0, 1.5], "radius": 1.0, "mass": 1.0}
    field = {"constant": 0.0, "uniform": [0.0, 0.0, -9.81]}
    late = {"timing": "end-of-step", "restitution": 0.0}
    time = {"duration": 1.0, "fixed_dt": 0.02}
    space = Space(scene_of([heavy, light], plane=[{}], gravity=field, time=time, contact=late))
    for _ in space.run():
        pass
    hardest = space.extremes.impact
    assert hardest is not None and hardest.bodies == (1, 2)
    assert hardest.value == pytest.approx(1.0 * 9.81 * 0.5, rel=0.1)  # m g h; a step late at most
