"""Where impacts have no end, contacts are held: nothing passes through anything, and the ledger explains the energy."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from carom.physics.contact.events.nearest_velocities import empty_group, find_impulses
from carom.physics.space import Space
from carom.scene.load import Scene

DEEPEST = 0.05  # of the smaller radius, the largest overlap that may remain
EXACT = 1e-12  # some 10⁴ roundings, of as many impacts


def column(
    masses: tuple[float, ...], radii: tuple[float, ...] = (), gap: float = 0.05, aside: float = 0.0, **contact: Any
) -> dict[str, Any]:
    """Balls above each other over a plane, with gaps in m, every other one to the side by a part of its radius."""
    bodies, z = [], 0.0
    for k, mass in enumerate(masses):
        radius = radii[k] if radii else 1.0
        bodies.append({"position": [aside * radius * (k % 2), 0.0, z + gap + radius], "radius": radius, "mass": mass})
        z += gap + 2.0 * radius
    return {
        "body": bodies,
        "plane": [{}],
        "gravity": {"constant": 0.0, "uniform": [0.0, 0.0, -9.81]},
        "contact": {"restitution": 0.5, "static_friction": 0.0} | contact,
        "time": {"duration": 0.6},
    }


def ended(document: dict[str, Any]) -> Space:
    """Run a scene to its end; no overlap of a step, no error of the energy may be large."""
    space = Space(Scene.from_dict(document), threads=1)
    for _ in space.run():
        pass
    overlap, error = space.extremes.overlap, space.extremes.energy_error
    assert overlap is None or overlap.value < DEEPEST
    assert error is not None and error.value <= 1e-9, "leapfrog is exact in a uniform field; 10⁶ roundings"
    return space


LIGHT_BELOW = (1.0, 1e3, 1e6)


@pytest.mark.parametrize(
    "document",
    [
        column(LIGHT_BELOW),
        column(LIGHT_BELOW, gap=0.001),
        column(LIGHT_BELOW, restitution=0.2),
        column(LIGHT_BELOW, restitution=0.8, gap=0.001),
        column((1e3, 1e6, 1e9), (0.1, 1.0, 10.0)),
        column((1.0, 1e2, 1e4, 1e6), gap=0.001),
        column((1.0, 1e3, 1e6, 1e9, 1e12), gap=0.001),
    ],
    ids=["5 cm", "1 mm", "e = 0.2", "e = 0.8", "radii", "four", "five"],
)
def test_a_dropped_column_that_gets_heavier_upwards_stands(document: dict[str, Any]) -> None:
    space = ended(document)
    radius = np.array([body["radius"] for body in document["body"]])
    stands = 2.0 * np.cumsum(radius) - radius
    above = np.append(radius[0], radius[1:] + radius[:-1])  # distance from what is below
    distance = np.diff(space.state.position[:, 2], prepend=0.0)
    assert (distance >= above - DEEPEST * radius).all()
    assert space.state.position[:, 2] == pytest.approx(stands, abs=0.05), "at most the gap of 5 cm is left"


def test_a_column_off_its_axis_squeezes_the_light_ball_out_and_nothing_overlaps() -> None:
    space = ended(column(LIGHT_BELOW, aside=1e-3, gap=0.001) | {"time": {"duration": 1.0}})
    # Rigid bodies: the weight of 10⁶ kg gives 1 kg as much energy as the fall of the heavy balls frees.
    assert np.abs(space.state.position[0, 0]) > 2.0


def test_a_column_between_walls_is_pressed_against_one_of_them_and_stays_whole() -> None:
    document = column((1.0, 1e3, 1e6, 1e9))
    for body in document["body"]:
        body["position"][2] -= 5.0
        body["velocity"] = [0.0, 0.0, -1.0]
    walls = {"boundary": "walls", "size": [4.0, 4.0, 10.0]}
    space = ended(document | {"plane": [], "domain": walls, "gravity": {"constant": 0.0}})
    assert (np.diff(space.state.position[:, 2], prepend=-6.0) >= 2.0 - EXACT).all()


def test_a_column_that_gets_heavier_upwards_stands_on_a_planet() -> None:
    masses, heights = (1e12, 1.0, 1e3, 1e6), (0.0, 2.05, 4.1, 6.15)
    bodies = [{"position": [0.0, 0.0, z], "radius": 1.0, "mass": mass} for z, mass in zip(heights, masses, strict=True)]
    space = Space(
        Scene.from_dict({"body": bodies, "contact": {"restitution": 0.5}, "time": {"duration": 0.5}}), threads=1
    )
    for _ in space.run():
        pass
    assert space.extremes.overlap is None or space.extremes.overlap.value < DEEPEST
    assert (np.diff(space.state.position[:, 2]) > 2.0 - DEEPEST).all()


@pytest.mark.parametrize("restitution", [0.5, 0.99])
@pytest.mark.parametrize("aside", [0.0, 1e-4])
def test_two_heavy_balls_do_not_pass_through_a_light_one_between_them(restitution: float, aside: float) -> None:
    bodies = [
        {"position": [x, y, 0.0], "velocity": [-x / 3.0, 0.0, 0.0], "radius": 1.0, "mass": mass}
        for x, y, mass in ((-3.0, 0.0, 1e6), (0.0, 0.0, 1.0), (3.0, aside, 1e6))
    ]
    contact = {"restitution": restitution, "static_friction": 0.0}
    no_gravity = {"gravity": {"constant": 0.0}}
    space = ended({"body": bodies, "contact": contact, "time": {"duration": 3.0}} | no_gravity)
    assert space.extremes.momentum_error is not None and space.extremes.momentum_error.value <= EXACT
    assert space.extremes.angular_momentum_error is not None
    assert space.extremes.angular_momentum_error.value <= EXACT
    assert space.extremes.overlap is None or space.extremes.overlap.value <= EXACT
    if aside == 0.0:
        assert (np.diff(space.state.position[:, 0]) >= 2.0 - EXACT).all()


@pytest.mark.parametrize("late", [0.2, 0.5, 0.8])
def test_others_meet_a_body_whose_impacts_are_exhausted(late: float) -> None:
    # Within one step of 1 s, two heavy balls hold a light one after 0.1 s, and later a fourth ball hits one of them.
    bodies = [
        {"position": [x, 0.0, 0.0], "velocity": [v, 0.0, 0.0], "radius": 1.0, "mass": mass}
        for x, v, mass in ((-2.1, 1.0, 1e6), (0.0, 0.0, 1.0), (2.1, -1.0, 1e6), (4.1 + 10.0 * late, -10.0, 1e6))
    ]
    contact = {"restitution": 0.5, "static_friction": 0.0}
    time = {"fixed_dt": 1.0, "duration": 1.0}
    space = ended({"body": bodies, "contact": contact, "time": time, "gravity": {"constant": 0.0}})
    assert (np.diff(space.state.position[:, 0]) >= 2.0 - EXACT).all()
    assert space.extremes.momentum_error is not None and space.extremes.momentum_error.value <= EXACT
    # The light ball transmits the blow: the fourth meets 2 × 10⁶ kg with e = 0 to 0.5, v' = -10 + (1 + e) 20/3.
    assert -10.0 / 3.0 - 0.1 <= space.state.velocity[3, 0] <= 0.1


def test_a_distant_plane_does_not_hold_a_body_whose_impacts_are_exhausted() -> None:
    # Within one step, a ball rattles between plates until it is exhausted, at half a second, and then 35 others hit it.
    # Each of these impacts is held, which doubles the gap up to which contacts count: to 17 radii at the end.
    count, speed = 35, 20.0
    plates = [{"point": [0.0, 0.0, s * 1.001], "normal": [0.0, 0.0, -s]} for s in (-1.0, 1.0)]
    ahead = {"point": [0.0, 16.0, 0.0], "normal": [0.0, -1.0, 0.0]}
    balls: list[dict[str, Any]] = [{"position": [0.0] * 3, "velocity": [0.0, 0.0, 40.0], "radius": 1.0, "mass": 1.0}]
    for k in range(count):
        place = [0.0, -1.1 - speed * (0.6 + 0.01 * k), 0.0]
        balls.append({"position": place, "velocity": [0.0, speed, 0.0], "radius": 0.05, "mass": 1e-3})
    smooth, time = {"restitution": 1.0, "static_friction": 0.0}, {"fixed_dt": 1.0, "duration": 1.0}
    still = {"gravity": {"constant": 0.0}}
    space = ended({"body": balls, "plane": [*plates, ahead], "contact": smooth, "time": time} | still)
    velocity = space.state.velocity[:, 1]
    assert velocity[0] > 0.5, "33 of the others have reached it, and it goes on with what they brought"
    mass = np.array([ball["mass"] for ball in balls])
    assert (mass * velocity).sum() == pytest.approx(count * 1e-3 * speed, rel=EXACT), "no wall has taken any of it"


@pytest.mark.parametrize(
    ("ratio", "integrator"), [(1e4, "auto"), (1e10, "leapfrog"), (1e16, "leapfrog"), (1e12, "auto")]
)
def test_a_heavy_elastic_ball_that_presses_a_light_one_against_a_wall_returns(ratio: float, integrator: str) -> None:
    # Galperin's billiard: floor(π / arctan √(m/M)) impacts. Beyond some 10⁵ in a step the rest of them is one, and the
    # heavy ball turns round early by the time in which it would cover the remaining gap, 2 × 10⁻⁵ of the distance.
    bodies = [
        {"position": [1.437, 0.0, 0.0], "radius": 0.5, "mass": 1.0},
        {"position": [3.374, 0.0, 0.0], "radius": 0.5, "mass": ratio, "velocity": [-1.0, 0.0, 0.0]},
    ]
    document = {
        "body": bodies,
        "plane": [{"normal": [1.0, 0.0, 0.0]}],
        "gravity": {"constant": 0.0},
        "contact": {"restitution": 1.0, "static_friction": 0.0},
        "time": {"duration": 10.0, "integrator": integrator},
    }
    space = ended(document)
    light, heavy = space.state.velocity[:, 0]
    kinetic = light * light / ratio + heavy * heavy
    assert kinetic == pytest.approx(1.0, abs=1e-9)
    angle = np.arctan(1.0 / np.sqrt(ratio))
    if ratio <= 1e10:
        impacts = int(np.pi / angle)
        assert space.extremes.impacts == impacts
        met = (impacts + 1) // 2  # every other impact is with the wall; these turn (√m v, √M V) by 2 arctan √(m/M)
        assert heavy == pytest.approx(-np.cos(2.0 * angle * met), abs=1e-9)
    assert heavy == pytest.approx(1.0, abs=2.0 / np.sqrt(ratio))
    # reflected at 1.5 m, where both balls touch the wall
    assert space.state.position[1, 0] == pytest.approx(3.0 - 3.374 + 10.0, abs=2.0 / np.sqrt(ratio) + 1e-4)


def test_a_group_with_an_elastic_contact_loses_its_energy_at_the_other_contact() -> None:
    # A light ball rattles between two heavy ones, on one side without loss, until its contacts are held.
    bodies = [
        {"position": [x, 0.0, 0.0], "velocity": [v, 0.0, 0.0], "radius": 1.0, "mass": mass, "material": material}
        for x, v, mass, material in ((-2.5, 1.0, 1e6, "hard"), (0.0, 0.0, 1.0, "hard"), (2.5, -1.0, 1e6, "soft"))
    ]
    space = ended(
        {
            "body": bodies,
            "material": [{"name": "hard", "restitution": 1.0}, {"name": "soft", "restitution": 0.5}],
            "pair": [{"materials": ["hard", "soft"], "restitution": 0.5}],
            "contact": {"static_friction": 0.0},
            "gravity": {"constant": 0.0},
            "time": {"fixed_dt": 1.0, "duration": 1.0},
        }
    )
    assert space.extremes.impacts > 100, "the light ball is exhausted"
    assert space.ledger.restitution > 0.99e6, "of 10⁶ J"
    assert space.extremes.dissipation_error is None, "no elastic contact has lost energy"


@pytest.mark.parametrize("spread", [0, 3, 8])  # decades of the masses
def test_impulses_of_a_group_push_where_contacts_close_and_only_there(spread: int) -> None:
    rng = np.random.default_rng(spread)
    for _ in range(50):
        bodies = int(rng.integers(2, 9))
        contacts = int(rng.integers(1, 3 * bodies))
        mass = 10.0 ** rng.uniform(0, spread, bodies)
        place = np.array([rng.choice(bodies, 2, replace=False) for _ in range(contacts)])
        place[rng.random(contacts) < 0.2, 1] = -1  # a plane
        normal = rng.normal(size=(contacts, 3))
        normal /= np.linalg.norm(normal, axis=1)[:, None]
        group = empty_group()
        before = rng.normal(size=(bodies, 3))
        group.v[:bodies], group.root[:bodies] = before, mass**-0.5
        group.place[:contacts], group.normal[:contacts] = place, normal
        group.allowed[:contacts] = np.where(rng.random(contacts) < 0.5, 0.0, rng.random(contacts))
        find_impulses(bodies, contacts, 1e-13, group)
        impulse, after = group.impulse[:contacts], group.v[:bodies]
        given = np.zeros((bodies + 1, 3))  # the last row is that of planes
        np.add.at(given, place[:, 1], impulse[:, None] * normal)
        np.add.at(given, place[:, 0], -impulse[:, None] * normal)
        moved = mass[:, None] * (after - before)
        assert np.abs(moved - given[:bodies]).max() <= 1e-10 * max(1.0, np.abs(impulse).max()), "Newton's third law"
        ends = np.vstack((after, np.zeros(3)))
        slack = np.sum((ends[place[:, 1]] - ends[place[:, 0]]) * normal, axis=1) + group.allowed[:contacts]
        assert (impulse >= 0.0).all() and slack.min() >= -1e-9, "contacts push, and none closes"
        assert np.abs(impulse * slack).max() <= 1e-8 * max(1.0, impulse.max()), "none pushes that opens"
