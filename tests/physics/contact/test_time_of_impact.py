"""Impacts at their own moments: nothing tunnels, nothing is late, and what is conserved stays so."""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from numpy.typing import NDArray

import event_driven_oracle
from carom.physics.contact.events.time_of_impact import stay_apart, time_of_impact, time_of_impact_on_parabola
from carom.physics.contact.graph import OVERFLOW
from carom.physics.schedule import every
from carom.physics.space import Space
from carom.scene.load import Scene, scene_from_text
from carom.state.frame import CollisionGraph, Frame
from seeds import examples
from small_scenes import cloud, scene_of

FloatArray = NDArray[np.float64]
Document = dict[str, Any]

LOCATED = {"timing": "time-of-impact"}
STILL = {"constant": 0.0}


def scene(bodies: list[Document], contact: Document | None = None, **sections: Any) -> Scene:
    sections.setdefault("gravity", STILL)
    return scene_of(bodies, contact=LOCATED | (contact or {}), **sections)


def struck(space: Space) -> list[tuple[tuple[int, int], float]]:
    """Pairs and moments, in s, of all impacts of the next step, each pair's first, in the order of time."""
    begin = space.time
    space.compute_dynamics(space.step + 1)
    graph = space.contacts
    if graph.into_step is None:
        return []
    moments = sorted(zip((begin + graph.into_step).tolist(), map(tuple, graph.pairs.tolist()), strict=True))
    return [(pair, moment) for moment, pair in moments]


def last(space: Space) -> Frame:
    *_, frame = space.run()
    return frame


# ------------------------------------------------------------------------------------------- nothing tunnels


def bullet(target: Document, **sections: Any) -> Space:
    """1000 of its radii in the one step of 1 s, at a target that it meets 0.3 m beside its centre."""
    fast = {"position": [-50.0, 0.03, 0.0], "velocity": [100.0, 0, 0], "radius": 0.1, "mass": 1.0}
    time = {"fixed_dt": 1.0, "duration": 1.0}
    smooth = {"restitution": 1.0, "static_friction": 0.0}
    return Space(scene([fast, {"radius": 0.1, "mass": 1.0, **target}], smooth, time=time, **sections))


def test_a_small_sphere_at_a_thousand_radii_a_step_hits_another_at_the_right_time() -> None:
    space = bullet({"position": [0.0, 0.0, 0.0]})
    met = (50.0 - math.sqrt(0.2**2 - 0.03**2)) / 100.0
    [(pair, moment)] = struck(space)
    assert pair == (0, 1)
    assert moment == pytest.approx(met, abs=4 * np.spacing(50.0) / 100.0), "positions of 50 m are rounded, and the root"
    # an elastic impact of equal masses exchanges what lies along the normal, here 0.15 of it across
    sine = 0.03 / 0.2
    normal = np.array([math.sqrt(1 - sine * sine), -sine, 0.0])
    gained = 100.0 * normal[0] * normal
    assert np.allclose(space.state.velocity[1], gained, rtol=1e-13)
    assert np.allclose(space.state.position[1], gained * (1.0 - met), rtol=1e-12, atol=1e-12)


def test_without_times_of_impact_it_passes_through() -> None:
    scene = bullet({"position": [0.0, 0.0, 0.0]}).scene
    plain = Space(scene_from_text(scene.toml, scene.title, ["contact.timing=end-of-step"]))
    assert not struck(plain) and not len(plain.contacts)


def test_a_fast_sphere_hits_an_approaching_and_a_fixed_sphere() -> None:
    [(_, moment)] = struck(bullet({"position": [50.0, 0.03, 0.0], "velocity": [-100.0, 0, 0]}))
    assert moment == pytest.approx((100.0 - 0.2) / 200.0, rel=1e-14)
    space = bullet({"position": [0.0, 0.03, 0.0], "fixed": True})
    assert len(struck(space)) == 1
    assert space.state.velocity[0].tolist() == [-100.0, 0.0, 0.0] and not space.state.velocity[1].any()


def test_a_fast_sphere_rebounds_from_a_plane() -> None:
    space = bullet({"position": [0.0, 9.0, 0.0]}, plane=[{"point": [20.0, 0, 0], "normal": [-1, 0, 0]}])
    [(pair, moment)] = struck(space)
    assert pair == (0, 2) and moment == pytest.approx(0.699, rel=1e-14)
    assert space.state.position[0, 0] == pytest.approx(19.9 - 100.0 * (1.0 - 0.699), rel=1e-13)


@pytest.mark.parametrize("size", [[60.0, 6.0, 6.0], [7.0, 6.0, 6.0], [0.9, 0.8, 0.7]])
def test_a_fast_sphere_hits_across_the_edge_of_a_periodic_box_after_any_number_of_passes(size: list[float]) -> None:
    # across the y edge it is 0.03 m beside the target only if images are taken into account, and in the smallest box
    # it passes a dozen of them, ever nearer, before it meets one
    space = bullet({"position": [0.0, size[1], 0.0]}, domain={"boundary": "periodic", "size": size})
    found = struck(space)
    drift = space.state.velocity[0] - [100.0, 0.0, 0.0]
    assert drift.any()
    expected = min(
        ((50.0 + k * size[0]) - math.sqrt(0.2**2 - 0.03**2)) / 100.0
        for k in range(-200, 200)
        if (50.0 + k * size[0]) > 0.2
    )
    assert found[0][1] == pytest.approx(expected, abs=1e-14)


def test_a_fast_sphere_in_a_crowd_hits_only_the_sphere_in_its_way() -> None:
    # 20³ spheres at rest, 4 radii apart; the bullet flies along a row of gaps, and meets the one sphere put there
    grid = np.array(list(itertools.product(range(20), repeat=3)), dtype=float) * 0.4
    bodies: list[Document] = [{"position": x.tolist(), "radius": 0.1, "mass": 1.0} for x in grid]
    bodies.append({"position": [-40.0, 0.2, 0.2], "velocity": [100.0, 0, 0], "radius": 0.05, "mass": 1e-3})
    bodies.append({"position": [9.0, 0.2, 0.2], "radius": 0.05, "mass": 1.0})
    space = Space(scene(bodies, {"restitution": 0.5}, time={"fixed_dt": 0.6, "duration": 0.6}))
    [(pair, moment)] = struck(space)
    assert pair == (8000, 8001) and moment == pytest.approx((49.0 - 0.1) / 100.0, rel=1e-14)


def test_a_sphere_that_is_thrown_out_of_its_reach_hits_bodies_far_away() -> None:
    # at rest it reaches hardly anywhere; struck by the bullet it flies 49 m on in the same step, and hits the third
    first = {"position": [0.0, 0.03, 0.0]}
    space = bullet(first)
    far = {"position": [30.0, 0.03, 0.0], "radius": 0.1, "mass": 1.0}
    bodies = [body.model_dump(exclude_defaults=True) for body in space.scene.body]
    crowd = [{"position": [0.0, 5.0 + k, 0.0], "radius": 0.1, "mass": 1.0} for k in range(40)]
    space = Space(scene([*bodies, far, *crowd], {"restitution": 1.0}, time={"fixed_dt": 1.0, "duration": 1.0}))
    assert [pair for pair, _ in struck(space)] == [(0, 1), (1, 2)]
    assert space.state.velocity[:3, 0].tolist() == pytest.approx([0.0, 0.0, 100.0], abs=1e-12)


# ------------------------------------------------------------------------------------------- exactness


def test_newtons_cradle_is_exact_to_round_off() -> None:
    # spheres in a row, two thrown in: free flight and exchange of velocities, whatever the step
    exact: list[FloatArray] = []
    for dt in (0.5, 0.03):
        row = [{"position": [2.5 * k, 0, 0], "radius": 1.0, "mass": 1.0} for k in range(5)]
        thrown = [
            {"position": [-9.0 - 2.5 * k, 0, 0], "velocity": [3.0, 0, 0], "radius": 1.0, "mass": 1.0} for k in (0, 1)
        ]
        space = Space(scene([*row, *thrown], {"restitution": 1.0}, time={"fixed_dt": dt, "duration": 9.0}))
        frame = last(space)
        assert sorted(frame.velocity[:, 0].tolist()) == pytest.approx([0.0] * 5 + [3.0, 3.0], abs=1e-14)
        assert space.extremes.impacts == 10 and space.extremes.overlap is not None
        assert space.extremes.overlap.value <= 1e-14
        exact.append(frame.position)
    # each sphere ends where the one before it would have, had it flown on; sums of hundreds of steps are rounded
    assert np.allclose(exact[0], exact[1], rtol=0, atol=1e-12)
    assert exact[0][4, 0] == pytest.approx(-9.0 + 2.0 * 5 + 3.0 * 9.0, abs=1e-12)


@pytest.mark.parametrize("restitution", [1.0, 0.6])
def test_a_ball_that_falls_on_a_plane_bounces_as_high_as_the_law_says_to_round_off(restitution: float) -> None:
    # In a uniform field the velocities of the moment keep the energy exactly: the ledger closes at any step. The height
    # at the moment is wrong by g τ (dt - τ)/2, which moves the impact and nothing else.
    g, dt = 10.0, 0.03
    ball = {"position": [0.0, 0.0, 6.0], "radius": 1.0, "mass": 2.0}
    space = Space(
        scene(
            [ball],
            {"restitution": restitution, "static_friction": 0.0},
            plane=[{}],
            gravity={"constant": 0.0, "uniform": [0, 0, -g]},
            time={"fixed_dt": dt, "duration": 1.7},
        )
    )
    [*_, frame] = space.run()
    assert space.extremes.impacts == 1
    assert abs(frame.energy.integration_error) <= 1e-15 * 100 * frame.energy.scale
    lost = (1.0 - restitution**2) * 2.0 * g * 5.0
    assert frame.energy.ledger.restitution == pytest.approx(lost, rel=2 * g * dt * dt / 8 / 5.0)


@pytest.mark.parametrize("integrator", ["leapfrog", "euler"])
@examples(60)
@given(seed=st.integers(0, 2**32 - 1))
def test_a_step_is_that_of_the_oracle(integrator: str, seed: int) -> None:
    # A few impacts in one step. An error grows by the path between impacts over the radius, about ten times for each.
    # Inelastic collapses are left out: their gaps shrink like the square of their closing speeds and reach rounding,
    # 10⁻¹⁶ m, while bodies still close with 10⁻⁸ m/s. Kernel and oracle then part by that speed and by all that it
    # does to later impacts (up to 3 × 10⁻⁴ s in 12 000 scenes, against 3 × 10⁻¹⁴ s wherever bodies close faster).
    random = np.random.default_rng(seed)
    periodic, walls, falls = random.random(3) < (0.3, 0.3, 0.5)
    bodies = [
        {
            "position": x.tolist(),
            "velocity": random.standard_normal(3).tolist(),
            "angular_velocity": random.standard_normal(3).tolist(),
            "radius": float(random.uniform(0.3, 0.5)),
            "mass": float(random.uniform(0.5, 3.0)),
        }
        for x in _apart(random, int(random.integers(2, 7)))
    ]
    domain = {"boundary": "periodic" if periodic else "walls", "size": [4.0, 4.5, 5.0]} if periodic or walls else {}
    friction = 0.0 if domain.get("boundary") == "walls" else float(random.choice([0.0, 0.2, 5.0]))
    field = [0.0, 0.0, -0.3] if falls and not domain else [0.0, 0.0, 0.0]
    space = Space(
        scene(
            bodies,
            {"restitution": float(random.uniform(0, 1)), "static_friction": friction, "stabilisation": "none"},
            domain=domain,
            gravity={"constant": 0.0, "uniform": field},
            time={"fixed_dt": 1.5, "duration": 1.5, "integrator": integrator},
        )
    )
    state, other = space.state, Space(space.scene)
    kick = 1.5 if integrator == "euler" else 0.75
    other.state.velocity[:] += other.state.acceleration * kick
    expected = event_driven_oracle.drift(other.state, other, kick, 1.5)
    other.state.velocity[:] += other.state.acceleration * (1.5 - kick)
    found = struck(space)
    if space.box is not None:
        other.state.position[:] -= space.box * np.floor(other.state.position / space.box + 0.5)
    assume(all(impact.closing > 1e-6 for impact in expected))
    first = {(impact.i, impact.j): impact.time for impact in reversed(expected)}
    assert dict(found) == pytest.approx(first, abs=1e-9)
    assert np.allclose(state.position, other.state.position, rtol=0, atol=1e-8)
    assert np.allclose(state.velocity, other.state.velocity, rtol=0, atol=1e-8)
    assert np.allclose(state.angular_velocity, other.state.angular_velocity, rtol=0, atol=1e-8)


def _apart(random: np.random.Generator, n: int) -> FloatArray:
    """Draw points in a box of 3 m, no two of them nearer than 1.01 m; the periodic box around is 4 m wide or more."""
    points: list[FloatArray] = []
    while len(points) < n:
        point = random.uniform(-1.45, 1.45, 3)
        if all(np.linalg.norm(point - other) > 1.01 for other in points):
            points.append(point)
    return np.array(points)


def test_bodies_that_stay_apart_by_the_bound_have_no_impact_on_lines_or_parabolas() -> None:
    """Gaps of 10⁻⁷ to 10³ radii, of which the motion closes none or up to one and a half."""
    random, span, rejected = np.random.default_rng(0), 0.1, 0
    for _ in range(4000):
        R, normal = 10.0 ** random.uniform(-3.0, 1.0), random.normal(size=3)
        normal /= np.linalg.norm(normal)
        gap, aside = R * 10.0 ** random.uniform(-7.0, 3.0), np.cross(normal, random.normal(size=3))
        d, v = (
            (R + gap) * normal,
            (random.choice([0.0, 0.01, 1.0]) * aside - random.uniform(0.0, 1.5) * normal) * gap / span,
        )
        field = random.normal(size=3)
        bow = 0.125 * span * span * np.linalg.norm(field)
        apart, still = tuple(d.tolist()), (0.0, 0.0, 0.0)
        if stay_apart(apart, tuple(v.tolist()), R, span):
            rejected += 1
            assert time_of_impact(apart, tuple(v.tolist()), still, R, span, 0.0, 0.0) == np.inf
        if stay_apart(apart, tuple(v.tolist()), R + bow, span):  # the chord of the parabola
            start = tuple((v - 0.5 * span * field).tolist())
            assert time_of_impact_on_parabola(apart, start, tuple(field.tolist()), 0.0, R, span) == np.inf
    assert 1000 < rejected < 3000  # the bound is sharp where the gap is small


def test_a_rolling_start_turns_bodies_piece_by_piece() -> None:
    # A spinning sphere is stopped, half-way through the step, by the friction of one that cannot turn: up to then it
    # has turned by ω τ, and from then on by the rest of its spin.
    spinning = {"position": [0.0, 0, 0], "angular_velocity": [0.0, 0.0, 1.0], "radius": 1.0, "mass": 1.0}
    other = {"position": [2.5, 0, 0], "velocity": [-1.0, 0, 0], "radius": 1.0, "mass": 1.0, "inertia_factor": 0.4}
    space = Space(
        scene([spinning, other], {"restitution": 0.5, "static_friction": 9.0}, time={"fixed_dt": 1.0, "duration": 1.0})
    )
    [(_, moment)] = struck(space)
    left = space.state.angular_velocity[0, 2]
    assert moment == pytest.approx(0.5) and 0.0 < left < 1.0
    angle = 2.0 * math.asin(space.state.orientation[0, 2])
    assert angle == pytest.approx(moment + left * (1.0 - moment), rel=1e-13)


# ------------------------------------------------------------------------------------------- many impacts


@pytest.mark.parametrize("restitution", [0.0, 0.05])
def test_three_beads_that_collapse_come_to_an_end(restitution: float) -> None:
    # below e = 7 - 4√3 they meet infinitely often in a finite time (McNamara & Young 1992)
    beads = [
        {"position": [x, 0, 0], "velocity": [v, 0, 0], "radius": 1.0, "mass": 1.0}
        for x, v in ((-3, 1), (0, 0), (4, -1))
    ]
    space = Space(
        scene(beads, {"restitution": restitution, "static_friction": 0.0}, time={"fixed_dt": 5.0, "duration": 10.0})
    )
    last(space)
    assert 2 <= space.extremes.impacts < 200, "a drift ends when rounding is all that closes: 50 impacts"
    assert np.abs(space.state.velocity).max() <= 1e-12, "they end together, at rest with their centre of mass"
    assert np.diff(space.state.position[:, 0]) == pytest.approx([2.0, 2.0], abs=1e-12)


def test_an_elastic_ball_that_rattles_for_too_long_keeps_its_speed_and_that_is_reported_once() -> None:
    # between plates, some 10⁶ times in the step
    plates = [{"point": [0, 0, s * 1.00001], "normal": [0, 0, -s]} for s in (-1, 1)]
    ball = {"velocity": [3.0, 0.0, 40.0], "radius": 1.0, "mass": 1.0}
    smooth = {"restitution": 1.0, "static_friction": 0.0}
    space = Space(scene([ball], smooth, plane=plates, time={"fixed_dt": 0.5, "duration": 0.5}))
    texts = [event.text for frame in space.run() for event in frame.events]
    assert len([text for text in texts if "so many impacts" in text]) == 1
    assert np.abs(space.state.velocity[0]) == pytest.approx([3.0, 0.0, 40.0], rel=1e-12)
    assert space.state.position[0, 0] == pytest.approx(1.5, rel=1e-9), "it glides along the plates"
    assert space.extremes.energy_error is not None and space.extremes.energy_error.value <= 1e-12
    assert space.extremes.overlap is None or space.extremes.overlap.value <= 1e-12


def test_an_elastic_gas_keeps_its_energy_and_momentum_and_overlaps_nowhere() -> None:
    gas = Scene.load("elastic-gas", ["contact.timing=time-of-impact", "time.duration=3"])
    space = Space(gas)
    last(space)
    extremes = space.extremes
    assert extremes.impacts > 1000 and extremes.energy_error is not None and extremes.overlap is not None
    assert extremes.energy_error.value <= 1e-13 and extremes.momentum_error is not None
    assert extremes.momentum_error.value <= 1e-13
    assert extremes.overlap.value <= 1e-13


def test_a_step_ten_times_as_long_is_the_same_gas() -> None:
    # free flight has no error but rounding, and impacts are where they are: 0.3 s, before chaos shows
    ends = []
    for dt in (0.01, 0.1):
        space = Space(
            Scene.load("elastic-gas", ["contact.timing=time-of-impact", "time.duration=0.3", f"time.fixed_dt={dt}"])
        )
        last(space)
        ends.append((space.state.position.copy(), space.extremes.impacts))
    assert ends[0][1] == ends[1][1] > 50
    assert np.abs(ends[0][0] - ends[1][0]).max() <= 1e-9


def test_a_collapse_conserves_what_a_collapse_conserves_and_overlaps_less() -> None:
    deepest = {}
    for timing in ("end-of-step", "time-of-impact"):
        space = Space(cloud(contact={"timing": timing}, record={"every": 0.1}))
        last(space)
        extremes = space.extremes
        assert extremes.impacts > 100 and extremes.overlap is not None
        assert extremes.momentum_error is not None and extremes.momentum_error.value <= 1e-12
        assert extremes.angular_momentum_error is not None and extremes.angular_momentum_error.value <= 1e-12
        assert extremes.energy_error is not None and extremes.energy_error.value <= 1e-3
        deepest[timing] = extremes.overlap.value
    assert deepest["time-of-impact"] < 0.25 * deepest["end-of-step"]


# ------------------------------------------------------------------------------------------- what stays as it is


@pytest.mark.parametrize("constant", [0.0, 1.0])
def test_contacts_at_rest_have_the_same_bits_with_either_timing(constant: float) -> None:
    # a row of ten on a plane, or drawn together by themselves: nothing closes faster than a contact at rest
    row = [{"position": [0.0, 0.0, 0.5 + k], "radius": 0.5, "mass": 1.0} for k in range(10)]
    ends = []
    for timing in ("end-of-step", "time-of-impact"):
        space = Space(
            scene(
                row,
                {"timing": timing},
                gravity={"constant": constant, "uniform": [0, 0, 0 if constant else -9.81]},
                plane=[] if constant else [{}],
                time={"duration": 3.0, "max_dt": 0.01},
            )
        )
        ends.append((last(space).fingerprint, space.extremes.impacts))
    assert ends[0] == ends[1] and ends[0][1] == 0


def test_a_pile_under_a_hit_comes_to_rest_again() -> None:
    ball = {"position": [0.0, 0.0, 12.0], "velocity": [0.0, 0.0, -3.0], "radius": 0.5, "mass": 1.0}
    stack = [{"position": [0.0, 0.0, 0.5 + k], "radius": 0.5, "mass": 1.0} for k in range(3)]
    space = Space(
        scene(
            [*stack, ball],
            {"restitution": 0.3},
            plane=[{}],
            gravity={"constant": 0.0, "uniform": [0, 0, -9.81]},
            time={"duration": 30.0, "max_dt": 0.01},
            record={"every": 1.0},
        )
    )
    frame = last(space)
    assert space.extremes.kinetic.value <= 1e-3 and frame.energy.relative_error <= 1e-5


@pytest.mark.parametrize("threads", [1, 2])
def test_the_bits_do_not_depend_on_threads_or_on_what_is_recorded(threads: int) -> None:
    document = cloud(contact=LOCATED, time={"duration": 2.0})
    one = Space(document, threads=1)
    frames = list(one.run())
    other = Space(document, threads=threads)
    *_, end = other.run(schedule=every(0.5))
    assert end.fingerprint == frames[-1].fingerprint


def test_the_first_contact_and_the_graph_of_a_frame_are_those_of_the_impacts() -> None:
    space = bullet({"position": [0.0, 0.0, 0.0]})
    *_, frame = space.run()
    assert frame.contacts.pairs.tolist() == [[0, 1]] and frame.contacts.overlaps.tolist() == [0.0]
    assert frame.contacts.normals[0] == pytest.approx([math.sqrt(1 - 0.15**2), -0.15, 0.0], rel=1e-12)
    assert any("First contact" in event.text for event in frame.events)
    assert space.extremes.impact is not None and space.extremes.total_contacts == space.extremes.impacts == 1
    assert space.extremes.impact.value == pytest.approx(0.25 * (100.0**2) * (1 - 0.15**2), rel=1e-12)


def test_a_warning_names_what_struck_within_the_step() -> None:
    space = bullet({"position": [0.0, 0.0, 0.0]})
    space.compute_dynamics(1)
    assert space._contact is not None
    assert space._contact.snapshots.keep_contributions()().shape == (1, 3)


# ------------------------------------------------------------------------------------------- colours


def assert_coloured(graph: CollisionGraph, moves: NDArray[np.bool_]) -> None:
    """No two contacts of a colour share a body that moves."""
    for colour in np.unique(graph.colours[graph.colours < OVERFLOW]):
        ends = graph.pairs[graph.colours == colour].ravel()
        ends = ends[moves[ends]]
        assert len(np.unique(ends)) == len(ends)


@pytest.mark.parametrize("dt", [0.1, 1.0])
def test_no_two_impacts_of_a_step_that_share_a_body_have_the_same_colour(dt: float) -> None:
    gas = Scene.load("elastic-gas", ["contact.timing=time-of-impact", f"time.fixed_dt={dt}", "time.duration=2"])
    space, most = Space(gas), 0
    for frame in space.run():
        assert_coloured(frame.contacts, np.ones(1000, dtype=np.bool_))
        most = max(most, int(frame.contacts.colours.max(initial=0)))
    assert 1 <= most < 23, "some body is struck twice; few are struck by many"


def test_an_impact_has_another_colour_than_the_contacts_in_which_its_bodies_rest() -> None:
    # a shower on a pile: contacts at rest keep the colours in which they are resolved
    shower = [
        {
            "position": [0.9 * (k % 4), 0.9 * (k // 4 % 4), 0.5 + 1.2 * (k // 16)],
            "velocity": [0.1, 0, -2.0],
            "radius": 0.4,
        }
        for k in range(64)
    ]
    walls = [{"normal": normal, "point": [-1.0 * n for n in normal]} for normal in ([0, 0, 1.0], [1.0, 0, 0])]
    space = Space(
        scene(
            shower,
            {"restitution": 0.3},
            plane=walls,
            gravity={"constant": 0.0, "uniform": [0, 0, -9.81]},
            time={"duration": 3.0, "fixed_dt": 0.05},
            record={"every": "step"},
        )
    )
    moves = np.arange(64 + 2) < 64
    mixed = 0
    for frame in space.run():
        graph = frame.contacts
        assert_coloured(graph, moves)
        mixed += graph.into_step is not None and bool(np.any(graph.overlaps > 0)) and bool(np.any(graph.overlaps == 0))
    assert mixed > 5, "impacts on the way and contacts at the end in one step"


def test_bodies_that_strike_each_other_differ_in_the_seeds_colouring() -> None:
    overrides = ["contact.timing=time-of-impact", "contact.colouring=bodies", "time.fixed_dt=0.5", "time.duration=2"]
    for frame in Space(Scene.load("elastic-gas", overrides)).run():
        graph = frame.contacts
        if len(graph) == 0:
            continue
        assert graph.body_colours is not None
        ends = graph.body_colours[graph.pairs]
        assert np.all(ends[:, 0] != ends[:, 1]) and np.array_equal(graph.colours, ends.min(axis=1))
