"""Planes, walls and fixed bodies, and the bodies that meet them."""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from carom.physics.space import Space
from carom.scene.load import Scene
from carom.state.frame import Frame
from small_scenes import scene_of

FloatArray = NDArray[np.float64]

G = 9.81  # m/s²
FALLING = {"constant": 0.0, "uniform": [0.0, 0.0, -G]}
WEIGHTLESS = {"constant": 0.0}


def frames_of(scene: Scene) -> tuple[Space, list[Frame]]:
    space = Space(scene)
    return space, list(space.run())


def end_of(scene: Scene) -> Space:
    space = Space(scene)
    for _ in space.run():
        pass
    return space


def direction(x: float, y: float, z: float) -> FloatArray:
    return np.asarray(np.array([x, y, z]) / np.sqrt(x * x + y * y + z * z))


def across(normal: FloatArray) -> FloatArray:
    """Return a unit vector in a plane, one way or another."""
    tangent = np.cross(normal, [0.6, -0.8, 0.3])
    return np.asarray(tangent / np.linalg.norm(tangent))


def spinning_throw(normal: FloatArray) -> dict[str, Any]:
    """Return a ball that touches a plane through the origin, thrown against it obliquely and with spin."""
    return {
        "position": list(0.3 * normal),
        "velocity": list(-2.0 * normal + 1.5 * across(normal)),
        "angular_velocity": [3.0, -5.0, 2.0],
        "radius": 0.3,
        "mass": 2.0,
    }


@pytest.mark.parametrize("restitution", [0.0, 0.5, 0.9, 1.0])
def test_a_dropped_ball_bounces_to_e_squared_of_its_height(restitution: float) -> None:
    # The impact is found up to a step late, but the rebound makes up for the depth. The apex falls between two frames,
    # at most dt/2 from one, and is missed by g (dt/2)²/2.
    height, dt = 2.0, 1e-3
    ball = {"position": [0, 0, 1.0 + height], "mass": 1.0}
    contact = {"restitution": restitution, "static_friction": 0.0}
    time = {"duration": 1.6, "fixed_dt": dt}  # the fall takes 0.64 s, the longest way up as much again
    _, frames = frames_of(scene_of([ball], plane=[{}], gravity=FALLING, contact=contact, time=time))
    heights = [frame.position[0, 2] - 1.0 for frame in frames]
    struck = int(np.argmin(heights[:700]))
    assert max(heights[struck:]) == pytest.approx(restitution**2 * height, abs=G * (dt / 2) ** 2 / 2)


@pytest.mark.parametrize("normal", [(1.0, 0.0, 0.0), (0.3, -0.4, 1.2), (-1.0, -1.0, -1.0)])
def test_an_oblique_plane_turns_the_normal_velocity_round_and_leaves_the_rest(normal: tuple[float, ...]) -> None:
    n = direction(*normal)
    v = np.array([0.5, 1.0, -2.0])
    v -= (v @ n + 1.5) * n  # 1.5 m/s against the plane
    point = [0.1, 0.2, 0.3]
    ball = {"position": list(point + 0.7 * n), "velocity": list(v), "radius": 0.5}
    plane = {"point": point, "normal": list(7.0 * n)}  # the length of a normal says nothing
    contact = {"restitution": 0.8, "static_friction": 0.0}
    space = end_of(scene_of([ball], plane=[plane], gravity=WEIGHTLESS, contact=contact, time={"duration": 0.5}))
    assert space.extremes.impacts == 1
    assert np.allclose(space.state.velocity[0], v + 1.8 * 1.5 * n, rtol=0, atol=1e-14)  # round-off


def test_a_plane_has_contact_values_of_its_own_and_otherwise_those_of_the_scene() -> None:
    ball = {"position": [0, 0, 1.5], "velocity": [0, 0, -1], "angular_velocity": [0, 5, 0]}
    contact = {"restitution": 0.2, "static_friction": 0.6, "kinetic_friction": 0.4}
    rubber, clay = {"restitution": 0.9, "static_friction": 0.0}, {"name": "clay"}
    for plane, e, spin_kept in ((rubber, 0.9, True), (clay, 0.2, False)):
        space = end_of(scene_of([ball], plane=[plane], gravity=WEIGHTLESS, contact=contact, time={"duration": 1.0}))
        assert space.state.velocity[0, 2] == pytest.approx(e, abs=1e-15)
        assert bool(space.state.angular_velocity[0, 1] == 5.0) is spin_kept


def test_a_coefficient_that_a_plane_gives_alone_draws_the_other_along() -> None:
    contact = {"restitution": 0.3, "static_friction": 0.6, "kinetic_friction": 0.4}
    laws = {
        (0.3, 0.6, 0.4): {},
        (0.3, 0.1, 0.1): {"static_friction": 0.1},
        (0.3, 0.9, 0.9): {"kinetic_friction": 0.9},
        (1.0, 0.6, 0.2): {"restitution": 1.0, "kinetic_friction": 0.2},
    }
    scene = scene_of([{"position": [0, 0, 5]}], plane=list(laws.values()), contact=contact)
    assert [plane.completed(scene.contact.coefficients) for plane in scene.plane] == list(laws)


@pytest.mark.parametrize("restitution", [0.0, 0.7])
@pytest.mark.parametrize("friction", [0.0, 0.1, 1.0])
def test_a_plane_is_a_fixed_sphere_so_large_that_its_curvature_does_not_show(
    restitution: float, friction: float
) -> None:
    # The ball, of radius r, touches a globe of radius R at r from its top, where the normal leans by r/R. What an
    # impact at 2.5 m/s with a slip of at most 4 m/s makes of that is a few times (2.5 + 4) r/R, in m/s, and 1/r that in
    # rad/s.
    contact = {"restitution": restitution, "static_friction": friction, "kinetic_friction": friction}
    r = 0.3
    ball = spinning_throw(np.array([0.0, 0.0, 1.0]))
    time = {"fixed_dt": 1e-9, "duration": 1e-9}  # so that no overlap, 2 × 10⁻⁹ m, has a say
    plane = end_of(scene_of([ball], plane=[{}], gravity=WEIGHTLESS, contact=contact, time=time))
    for R in (1e2, 1e3, 1e4):
        globe = {"position": [-r, 0, r - np.sqrt((R + r) ** 2 - r * r)], "radius": R, "fixed": True}
        sphere = end_of(scene_of([ball, globe], gravity=WEIGHTLESS, contact=contact, time=time))
        assert sphere.extremes.impacts == plane.extremes.impacts == 1
        dv = sphere.state.velocity[0] - plane.state.velocity[0]
        assert 0.0 < np.abs(dv).max() <= 3 * 6.5 * r / R
        if friction > 0.0:
            dw = sphere.state.angular_velocity[0] - plane.state.angular_velocity[0]
            assert np.abs(dw).max() <= 3 * 6.5 / R


def walled_gas(count: int, **contact: Any) -> Scene:
    return Scene.from_dict(
        {
            "seed": 3,
            "time": {"duration": 30.0, "max_dt": 0.05},
            "gravity": WEIGHTLESS,
            "contact": contact,
            "domain": {"boundary": "walls", "size": [6.0, 7.0, 8.0]},
            "record": {"every": 1.0, "check_every": 10},
            "group": [
                {
                    "count": count,
                    "radius": {"min": 0.3, "max": 0.5},
                    "region": {"shape": "box", "size": [6.0, 7.0, 8.0]},
                    "velocity": {"dispersion": 1.0},
                    "spin": {"dispersion": 1.0},
                }
            ],
        }
    )


@pytest.mark.parametrize("count", [1, 60])
def test_walls_keep_an_elastic_gas_inside_and_with_its_kinetic_energy(count: int) -> None:
    space, frames = frames_of(walled_gas(count, restitution=1.0, static_friction=0.0))
    assert space.extremes.impacts > 5 * count
    # cfl = 0.5: nothing is deeper in a wall than half its radius, so no centre is nearer than that.
    room = np.array([3.0, 3.5, 4.0]) - 0.5 * space.state.radius[:, None]
    assert all(np.all(np.abs(frame.position) <= room) for frame in frames)
    # Some 10⁴ impacts, each with a rounding of 10⁻¹⁶.
    assert frames[-1].energy.translational == pytest.approx(frames[0].energy.translational, rel=1e-12)


def test_rough_walls_take_from_a_gas_what_the_ledger_says() -> None:
    _, frames = frames_of(walled_gas(60, restitution=0.9, static_friction=0.3))
    first, after = frames[0].energy, frames[-1].energy
    lost = after.ledger.restitution + after.ledger.friction - after.ledger.stabilisation
    assert lost > 0.5 * first.total and after.ledger.friction > 0.0
    assert first.total - after.total == pytest.approx(lost, rel=1e-12)  # round-off of 10⁴ impacts


def test_a_ball_in_a_corner_comes_to_rest_on_three_walls() -> None:
    # The field points into a corner; bounces with e = 0.5 from 1 m and a speed of approach of 8 m/s are over in 3 s.
    scene = scene_of(
        [{"position": [0.1, -0.2, 0.3], "radius": 0.5, "velocity": [0.3, 0.2, 0.1]}],
        gravity={"constant": 0.0, "uniform": [5.0, -7.0, -9.0]},
        domain={"boundary": "walls", "size": [3.0, 4.0, 5.0]},
        time={"duration": 10.0, "max_dt": 0.01},
    )
    space = end_of(scene)
    assert np.allclose(space.state.position[0], [1.0, -1.5, -2.0], rtol=0, atol=1e-12)  # round-off
    energy = space.energy()
    assert energy.translational <= 1e-20 and energy.relative_error <= 1e-10
    assert np.array_equal(space.contacts.pairs, [[0, 2], [0, 3], [0, 5]]), "+x, -y and -z"
    assert [space.planes.name[j - 1] for j in (2, 3, 5)] == ["wall at +x", "wall at -y", "wall at -z"]


def test_nothing_moves_or_turns_a_fixed_body_and_it_still_pulls() -> None:
    bodies: list[dict[str, Any]] = [{"name": "post", "fixed": True, "mass": 50.0}]
    rng = np.random.default_rng(5)
    for corner in product((-3.0, 3.0), repeat=3):
        bodies.append(
            {
                "position": list(corner),
                "velocity": list(rng.standard_normal(3)),
                "angular_velocity": list(rng.standard_normal(3)),
                "mass": 1.0,
            }
        )
    scene = scene_of(
        bodies,
        gravity={"constant": 1.0, "uniform": [1.0, 2.0, -3.0]},
        contact={"timing": "end-of-step"},
        time={"duration": 4.0, "max_dt": 0.01},
    )
    _, frames = frames_of(scene)
    assert sum(bool(np.any(frame.contacts.pairs[:, 0] == 0)) for frame in frames) >= 3
    for frame in frames:
        assert frame.orientation is not None and frame.angular_velocity is not None
        assert not frame.position[0].any() and not frame.velocity[0].any() and not frame.angular_velocity[0].any()
        assert np.array_equal(frame.orientation[0], [0.0, 0.0, 0.0, 1.0])
        assert not frame.checkpoint.acceleration[0].any()
    # Far from all others, a body falls towards the post as towards any other: G M/d².
    lone = Space(scene_of([bodies[0], {"position": [10, 0, 0]}], gravity={"constant": 1.0}))
    assert np.allclose(lone.state.acceleration[1], [-0.5, 0, 0], rtol=1e-15)


def test_an_orbit_about_a_fixed_sun_closes() -> None:
    # Order 4 at T/1000: (2π/1000)⁴ = 1.6 × 10⁻⁹ of the orbit, times the 2π of its way.
    planet = {"position": [1.0, 0, 0], "velocity": [0, 1.0, 0], "radius": 0.01, "mass": 0.5}
    sun = {"fixed": True, "mass": 1.0, "radius": 0.1}
    time = {"duration": 2 * np.pi, "fixed_dt": 2 * np.pi / 1000, "integrator": "yoshida4"}
    space = end_of(scene_of([sun, planet], gravity={"constant": 1.0}, time=time))
    assert np.allclose(space.state.position[1], [1.0, 0, 0], rtol=0, atol=1e-8)
    assert space.energy().relative_error <= 1e-9


def test_fixed_bodies_that_overlap_are_nobodys_business() -> None:
    bodies: list[dict[str, Any]] = [{"fixed": True}, {"fixed": True, "position": [1.0, 0, 0]}]
    bodies.append({"position": [0.5, 0, 4.0], "velocity": [0, 0, -1.0], "mass": 1.0})
    space, frames = frames_of(
        scene_of(bodies, gravity={"constant": 1e-3}, contact={"allow_overlap": True}, time={"duration": 4.0})
    )
    assert not any([0, 1] in frame.contacts.pairs.tolist() for frame in frames)
    assert space.extremes.overlap is not None and space.extremes.overlap.bodies in ((0, 2), (1, 2))
    # A fixed body inside the ground is ignored, too.
    _, frames = frames_of(
        scene_of(bodies[:1], plane=[{}], gravity=FALLING, contact={"allow_overlap": True}, time={"duration": 0.1})
    )
    assert all(len(frame.contacts) == 0 for frame in frames)


def test_momentum_is_not_compared_where_something_takes_it() -> None:
    ball = {"position": [0, 0, 1.5], "velocity": [0, 0, -1]}
    anchors: list[dict[str, Any]] = [
        {"plane": [{}]},
        {"domain": {"boundary": "walls", "size": [9, 9, 5.5]}},
        {"body": [ball, {"fixed": True, "position": [0, 0, -1]}]},
    ]
    for anchor in anchors:
        space = end_of(Scene.from_dict({"body": [ball], "gravity": WEIGHTLESS, "time": {"duration": 4.0}, **anchor}))
        assert space.extremes.impacts == 1
        assert space.extremes.momentum_error is None and space.extremes.angular_momentum_error is None
        frame = space.frame()
        assert frame.momentum_error is None and frame.angular_momentum_error is None


@pytest.mark.nightly
@pytest.mark.slow
@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 10**6), e=st.floats(0, 1), mu=st.floats(0, 1.5), k=st.floats(0, 1))
def test_the_ledger_closes_for_whatever_is_thrown_on_a_rough_plane(seed: int, e: float, mu: float, k: float) -> None:
    rng = np.random.default_rng(seed)
    n = direction(*rng.standard_normal(3))
    bodies = [
        {
            "position": list((1.0 + 2.2 * i) * n),
            "velocity": list(rng.standard_normal(3)),
            "angular_velocity": list(5 * rng.standard_normal(3)),
            "mass": float(rng.uniform(0.1, 10)),
        }
        for i in range(3)
    ]
    scene = scene_of(
        bodies,
        plane=[{"normal": list(n), "static_friction": mu, "kinetic_friction": k * mu, "restitution": e}],
        gravity={"constant": 0.0, "uniform": list(-G * n)},
        time={"duration": 1.5, "max_dt": 0.01},
    )
    _, frames = frames_of(scene)
    # Leapfrog is exact in a uniform field, so that nothing but round-off is left to the integrator: 10⁻¹⁶ for each of
    # some 10³ impulses.
    assert max(abs(frame.energy.integration_error) for frame in frames) <= 1e-12 * frames[-1].energy.scale


def test_the_step_counts_speeds_from_what_stands_still() -> None:
    # Two balls fly abreast. By themselves they are at rest in their frame; a plane makes their speed count.
    balls = [{"position": [0, y, 50.0], "velocity": [0, 0, -10.0], "radius": 1.0} for y in (-5.0, 5.0)]
    time = {"max_dt": 1.0, "cfl": 0.5}
    free = Space(scene_of(balls, gravity=WEIGHTLESS, time=time, contact={"allow_overlap": True}))
    above = Space(scene_of(balls, plane=[{}], gravity=WEIGHTLESS, time=time))
    assert free.first_dt == 1.0
    assert above.first_dt == pytest.approx(0.5 * 1.0 / 10.0, rel=1e-15)


def test_the_step_counts_the_field_where_it_does_not_pull_all_alike() -> None:
    ball = {"position": [0, 0, 50.0], "radius": 1.0}
    time = {"max_dt": 1.0, "target_dx": 0.01, "cfl": 1e9}
    free = Space(scene_of([ball], gravity=FALLING, time=time))
    above = Space(scene_of([ball], plane=[{}], gravity=FALLING, time=time))
    assert free.first_dt == 1.0
    assert above.first_dt == pytest.approx(np.sqrt(2 * 0.01 / G), rel=1e-15)


@pytest.mark.parametrize("colouring", ["contacts", pytest.param("bodies", marks=pytest.mark.slow)])
@pytest.mark.parametrize("stabilisation", ["split", "baumgarte", "none"])
@pytest.mark.parametrize("solver", ["lasting", "staged"])
def test_balls_poured_on_a_ramp_stay_above_it_with_every_switch(
    solver: str, stabilisation: str, colouring: str
) -> None:
    scene = Scene.from_dict(
        {
            "seed": 6,
            "time": {"duration": 2.0, "max_dt": 0.005},
            "gravity": FALLING,
            "contact": {"solver": solver, "stabilisation": stabilisation, "colouring": colouring},
            "domain": {"boundary": "walls", "size": [4.0, 4.0, 6.0]},
            "plane": [{"point": [0, 0, -2.0], "normal": [0.3, 0, 1]}],
            "body": [{"fixed": True, "radius": 0.5, "position": [0, 0, -0.5]}],
            "group": [
                {"count": 40, "radius": 0.3, "region": {"shape": "box", "size": [3.8, 3.8, 3.0], "centre": [0, 0, 1.4]}}
            ],
        }
    )
    space, frames = frames_of(scene)
    # A ball moves at most cfl = 0.5 of its radius in a step, so that it cannot be deeper in what does not move.
    assert space.planes.depth(space.state.position, space.state.radius)[1:].max() <= 0.5 * 0.3
    assert not space.state.position[0, :2].any() and space.state.position[0, 2] == -0.5
    energy = frames[-1].energy
    if stabilisation != "baumgarte":
        assert energy.total < frames[0].energy.total
    assert energy.relative_error <= 1e-3


def test_a_fall_of_all_alike_is_not_modelled_and_one_onto_something_is() -> None:
    still: list[dict[str, Any]] = [{"position": [0, 0, 5]}, {"position": [5, 0, 5]}]
    fixed: list[dict[str, Any]] = [still[0], {"position": [5, 0, 5], "fixed": True}]

    def touches(bodies: list[dict[str, Any]], **sections: Any) -> bool:
        return Space(scene_of(bodies, **sections)).requirements.contact.modelled

    assert not touches(still, gravity=FALLING)
    assert touches(fixed, gravity=FALLING)
    assert not touches(fixed, gravity=WEIGHTLESS)
    assert touches(still[:1], gravity=FALLING, plane=[{}])
    assert not touches(still[:1], gravity=WEIGHTLESS, plane=[{}])
    assert touches([{**still[0], "velocity": [0, 0, -1]}], gravity=WEIGHTLESS, plane=[{}])
    assert not touches(still[:1], gravity=FALLING)
