"""Materials: pairs combine by the stated rule, and every part of the contact model takes their coefficients."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from carom.contact_table import SLIDING, STICKING
from carom.lab.tradeoff.event_driven_reference import solve
from carom.physics.placement import place
from carom.physics.reference_api import BodyProxy, CollisionContext
from carom.physics.space import Space
from carom.plan.features import require
from carom.scene.load import Scene
from carom.scene.matter import PairCoefficients, kinds_of_contacts, pair_coefficients
from carom.scene.schema import Coefficients
from carom.scene.schema.contact import combined
from small_scenes import random_bodies, scene_of, solver_of

FloatArray = NDArray[np.float64]
Section = dict[str, Any]

G = 9.81  # m/s²
FALLING = {"constant": 0.0, "uniform": [0.0, 0.0, -G]}
WEIGHTLESS = {"constant": 0.0}
STEEL: Section = {"name": "steel", "restitution": 0.9, "static_friction": 0.9, "kinetic_friction": 0.4}
RUBBER: Section = {"name": "rubber", "restitution": 0.6, "static_friction": 0.1, "kinetic_friction": 0.1}
SMOOTH: Section = {"static_friction": 0.0}
TIMINGS = ["end-of-step", "time-of-impact"]


def end_of(scene: Scene) -> Space:
    space = Space(scene)
    for _ in space.run():
        pass
    return space


def ball(material: str, x: float = 0.0, **keys: Any) -> Section:
    return {"position": [x, 0.0, 0.0], "radius": 0.5, "mass": 1.0, "material": material, **keys}


def head_on(one: str, other: str, timing: str = "auto", **sections: Any) -> float:
    """Return the rebound speed over the approach speed of two balls."""
    bodies = [ball(one, -0.6, velocity=[1.0, 0.0, 0.0]), ball(other, 0.6, velocity=[-1.0, 0.0, 0.0])]
    sections.setdefault("material", [STEEL, RUBBER])
    contact = {"restitution": 0.3, **SMOOTH, "timing": timing}
    space = end_of(scene_of(bodies, gravity=WEIGHTLESS, contact=contact, time={"duration": 0.5}, **sections))
    assert space.extremes.impacts == 1
    v = space.state.velocity[:, 0]
    return float(v[1] - v[0]) / 2.0


@pytest.mark.parametrize("timing", TIMINGS)
def test_balls_of_three_materials_rebound_from_one_plane_to_their_own_heights(timing: str) -> None:
    # As in test_planes.py: the apex falls between two frames and is missed by at most g (dt/2)²/2.
    height, dt = 2.0, 2e-3
    cork = {"name": "cork", "restitution": 0.3}
    names = ["steel", "rubber", "cork"]
    balls = [ball(name, 3.0 * k, position=[3.0 * k, 0.0, 0.5 + height]) for k, name in enumerate(names)]
    space = Space(
        scene_of(
            balls,
            plane=[{"material": "steel"}],
            material=[STEEL, RUBBER, cork],
            gravity=FALLING,
            contact={**SMOOTH, "timing": timing},
            time={"duration": 1.6, "fixed_dt": dt},
        )
    )
    heights = np.array([frame.position[:, 2] - 0.5 for frame in space.run()])
    struck = np.argmin(heights[:350], axis=0)
    reached = [heights[row:, k].max() for k, row in enumerate(struck)]
    expected = [e**2 * height for e in (0.9, 0.6, 0.3)]
    assert reached == pytest.approx(expected, abs=G * (dt / 2) ** 2 / 2 + 1e-12)


@pytest.mark.parametrize("timing", TIMINGS)
def test_steel_and_rubber_rebound_by_the_smaller_restitution_in_either_order(timing: str) -> None:
    for one, other, e in (
        ("steel", "steel", 0.9),
        ("steel", "rubber", 0.6),
        ("rubber", "steel", 0.6),
        ("rubber", "rubber", 0.6),
        ("steel", "default", 0.3),
    ):
        assert head_on(one, other, timing) == pytest.approx(e, abs=1e-14)  # rounding of a few operations


def test_a_pair_takes_the_place_of_the_rule() -> None:
    pairs = [
        {"materials": ["rubber", "steel"], "restitution": 0.75},
        {"materials": ["steel", "steel"], "restitution": 1},
    ]
    assert head_on("steel", "rubber", pair=pairs) == pytest.approx(0.75, abs=1e-14)
    assert head_on("steel", "steel", pair=pairs) == pytest.approx(1.0, abs=1e-14)
    assert head_on("rubber", "rubber", pair=pairs) == pytest.approx(0.6, abs=1e-14)


def test_friction_is_the_geometric_mean_and_a_material_keeps_its_own() -> None:
    steel, rubber = Coefficients(0.9, 0.9, 0.4), Coefficients(0.6, 0.1, 0.1)
    assert combined(steel, rubber) == pytest.approx((0.6, 0.3, 0.2), rel=1e-15)
    assert combined(steel, rubber) == combined(rubber, steel)
    assert combined(steel, steel) == steel
    assert combined(steel, Coefficients(1.0, 0.0, 0.0)) == (0.9, 0.0, 0.0)


def test_a_pair_that_gives_one_coefficient_of_friction_draws_the_other_along() -> None:
    pairs = [{"materials": ["steel", "rubber"], "static_friction": 0.05}]
    scene = scene_of([ball("steel"), ball("rubber", 2.0)], material=[STEEL, RUBBER], pair=pairs)
    (found,) = [kind for kind in kinds_of_contacts(scene) if kind.between == ("steel", "rubber")]
    assert found.coefficients == (0.6, 0.05, 0.05)


@pytest.mark.parametrize(("steepness", "mode"), [(0.98, STICKING), (1.02, SLIDING)])
def test_a_ball_slides_down_a_plane_that_is_steeper_than_the_mean_friction_can_hold(
    steepness: float, mode: int
) -> None:
    # A ball rolls without sliding up to tan θ = μ_s (1 + m r²/I), here 0.3 · 3.5; beyond, it is slowed by μ_k alone.
    tangent = steepness * 0.3 * 3.5
    down, out = np.array([1.0, 0.0, -tangent]), np.array([tangent, 0.0, 1.0])
    down, out = down / np.linalg.norm(down), out / np.linalg.norm(out)
    scene = scene_of(
        [ball("rubber", position=list(0.5 * out))],
        plane=[{"material": "steel", "normal": out.tolist()}],
        material=[STEEL, RUBBER],
        gravity=FALLING,
        time={"duration": 0.2, "fixed_dt": 1e-3},
    )
    space = Space(scene, record_contacts=True)
    *_, last = space.run()
    sine, cosine = tangent / math.hypot(1.0, tangent), 1.0 / math.hypot(1.0, tangent)
    pull = G * sine / (1.0 + 0.4) if mode == STICKING else G * (sine - 0.2 * cosine)
    assert last.velocity[0] @ down == pytest.approx(0.2 * pull, rel=1e-9)  # constant acceleration, small residuals
    slip = last.velocity[0] @ down - 0.5 * space.state.angular_velocity[0] @ np.cross(out, down)
    assert bool(abs(slip) < 1e-9) is (mode == STICKING)
    assert last.contact_rows is not None
    assert last.contact_rows["mode"].tolist() == [mode]


def test_a_coefficient_that_a_plane_gives_holds_whatever_touches_it() -> None:
    bodies = [ball("steel"), ball("rubber", 2.0)]
    scene = scene_of(bodies, plane=[{"restitution": 0.5, "point": [0, 0, -9]}], material=[STEEL, RUBBER])
    found = pair_coefficients(scene)
    assert found.of(0, 2) == pytest.approx((0.5, math.sqrt(0.9 * 0.6), 0.4), rel=1e-15)
    assert found.of(1, 2) == pytest.approx((0.5, math.sqrt(0.1 * 0.6), 0.2), rel=1e-15)


def test_walls_may_have_a_material() -> None:
    domain = {"boundary": "walls", "size": [9.0, 9.0, 9.0]}
    for material, e in ({}, 0.5), ({"material": "rubber"}, 0.6):
        scene = scene_of([ball("steel")], domain={**domain, **material}, material=[STEEL, RUBBER])
        assert {pair_coefficients(scene).of(0, 1 + wall).restitution for wall in range(6)} == {e}


@settings(max_examples=50, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_the_kernel_takes_the_coefficients_of_each_pair_as_the_readable_form_does(seed: int) -> None:
    rng = np.random.default_rng(seed)
    kind, n = rng.integers(0, 3, 6), 6
    rows = rng.random((3, 3, 3))
    rows[..., 2] *= rows[..., 1]
    places = np.stack([3 * kind, kind], axis=1)
    laws = PairCoefficients(rows.reshape(-1, 3), n, places)
    fast, readable = random_bodies(n, seed), random_bodies(n, seed)
    pairs = np.array([[0, 1], [2, 3], [4, 5]])
    for bodies in (fast, readable):
        bodies.position[:] = np.repeat([[0.0, 0, 0], [9.0, 0, 0], [18.0, 0, 0]], 2, axis=0)
        bodies.position[1::2, 0] += 0.95 * (bodies.radius[::2] + bodies.radius[1::2])
    solver = solver_of(fast, pairs, laws)
    solver.resolve_impacts(0.0, max_iterations=1, impacts_only=False)
    for i, j in pairs.tolist():
        context = CollisionContext.from_bodies(BodyProxy(readable, i), BodyProxy(readable, j))
        assert context is not None
        if (readable.velocity[j] - readable.velocity[i])[0] < 0.0:
            context.resolve(*rows[kind[i], kind[j]])
    # The same few dozen operations in another order, on numbers of order 10.
    assert np.allclose(fast.velocity, readable.velocity, rtol=0, atol=1e-13)
    assert np.allclose(fast.angular_velocity, readable.angular_velocity, rtol=0, atol=1e-13)


def mixture(count: int = 30, **sections: Any) -> Scene:
    """Build a box of steel and rubber balls in motion under gravity."""
    group: Section = {"count": count, "radius": {"min": 0.2, "max": 0.3}, "spin": {"dispersion": 1.0}}
    region = {"shape": "box", "size": [3.9, 3.9, 3.9]}
    return Scene.from_dict(
        {
            "seed": 3,
            "time": {"duration": 1.0, "max_dt": 0.005},
            "gravity": FALLING,
            "record": {"every": "step", "check_every": 1},
            "domain": {"boundary": "walls", "size": [4.0, 4.0, 4.0], "material": "steel"},
            "material": [{**STEEL, "density": 7800.0}, {**RUBBER, "density": 1100.0}],
            "group": [
                {**group, "region": region, "velocity": {"dispersion": 2.0}, "material": name}
                for name in ("steel", "rubber")
            ],
            **sections,
        }
    )


@pytest.mark.parametrize("contact", [{"timing": "end-of-step"}, {"timing": "time-of-impact"}, {"solver": "staged"}])
def test_the_ledger_accounts_for_all_energy_that_two_materials_lose(contact: Section) -> None:
    energy = end_of(mixture(contact=contact)).energy()
    assert energy.ledger.restitution > 0.0 and energy.ledger.friction > 0.0
    assert energy.relative_error < 1e-12  # a uniform field: what is left is rounding


def test_the_order_of_the_bodies_changes_nothing() -> None:
    names = ["steel", "rubber", "default"]
    balls = [
        ball(names[k % 3], 1.1 * k, velocity=[1.0 - 0.3 * k, 0.1 * k, 0.0], angular_velocity=[0.0, 0.0, 0.5 * k])
        for k in range(6)
    ]
    ends = []
    for order in (range(6), [3, 5, 0, 2, 4, 1]):
        scene = scene_of(
            [balls[k] for k in order],
            material=[STEEL, RUBBER],
            gravity=WEIGHTLESS,
            time={"duration": 2.0, "max_dt": 0.02},
        )
        space = end_of(scene)
        assert space.extremes.impacts >= 5
        ends.append((space.state.position[np.argsort(order)], space.state.velocity[np.argsort(order)]))
    # Sums in another order; a few impacts amplify rounding little.
    assert np.allclose(ends[0], ends[1], rtol=0, atol=1e-12)


@pytest.mark.parametrize("named", ["one", "two alike"])
def test_bodies_of_one_material_have_the_bits_of_a_scene_without_and_no_array_of_materials(named: str) -> None:
    balls = [{"position": [0.0, 0.0, 0.6 + 1.05 * k], "radius": 0.5} for k in range(5)]
    sections = {"gravity": FALLING, "time": {"duration": 0.5, "max_dt": 0.005}, "plane": [{"restitution": 0.3}]}
    coefficients = {"restitution": 0.7, "static_friction": 0.5, "kinetic_friction": 0.3}
    plain = scene_of(balls, contact=coefficients, **sections)
    one, two = {"name": "one", **coefficients}, {"name": "two", **coefficients}
    names = ["one"] if named == "one" else ["one", "two"]
    materials = scene_of(
        [{**each, "material": names[k % len(names)]} for k, each in enumerate(balls)], material=[one, two], **sections
    )
    assert len(pair_coefficients(materials).places) == 0
    assert end_of(materials).fingerprint() == end_of(plain).fingerprint()


def test_a_material_gives_density_and_inertia_and_a_mass_of_its_own_holds() -> None:
    shell = {"name": "shell", "density": 2000.0, "inertia_factor": 0.6}
    bodies: list[Section] = [
        {"material": "shell"},
        {"position": [9, 0, 0], "material": "shell", "mass": 3.0},
        {"position": [18, 0, 0]},
    ]
    group = {"count": 2, "material": "shell", "region": {"radius": 5.0, "centre": [0, 30, 0]}}
    start = place(scene_of(bodies, material=[shell], group=[group]))
    volume = 4.0 / 3.0 * math.pi
    assert start.mass == pytest.approx([2000 * volume, 3.0, 1000 * volume, 2000 * volume, 2000 * volume], rel=1e-15)
    assert start.inertia / start.mass == pytest.approx([0.6, 0.6, 0.4, 0.6, 0.6], rel=1e-15)


def test_a_part_is_modelled_if_one_material_needs_it() -> None:
    dull = {"restitution": 0.0, "static_friction": 0.0}
    clay, ice = {"name": "clay", **dull}, {"name": "ice", "restitution": 0.2, "static_friction": 0.1}
    for names, needed in ((["clay", "clay"], False), (["clay", "ice"], True)):
        bodies = [ball(names[0], velocity=[1.0, 0.0, 0.0]), ball(names[1], 2.0)]
        needs = require(scene_of(bodies, material=[clay, ice], contact=dull))
        assert (needs.restitution.modelled, needs.friction.modelled) == (needed, needed)
    assert needs.restitution.why == "e = 0 to 0.2"


def test_the_event_driven_reference_takes_the_coefficients_of_each_pair() -> None:
    bodies = [ball("steel", -0.6, velocity=[1.0, 0.0, 0.0]), ball("rubber", 0.6, velocity=[-1.0, 0.0, 0.0])]
    scene = scene_of(bodies, material=[STEEL, RUBBER], gravity=WEIGHTLESS, contact=SMOOTH, time={"duration": 0.5})
    v = solve(Space(scene), np.array([0.0, 0.5])).trajectory.velocity[-1][:, 0]
    assert (v[1] - v[0]) / 2.0 == pytest.approx(0.6, abs=1e-9)  # the tolerance of its integration
