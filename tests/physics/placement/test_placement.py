"""Bodies start where the scene says, never overlapping, the same every time."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from carom.errors import SceneError
from carom.physics.placement import packing_fraction, place
from carom.physics.placement.neighbours import overlapping_pairs, squared_distance
from carom.scene.load import Scene, scene_from_text
from carom.scene.matter import pair_coefficients
from carom.scene.start import half_spaces
from seeds import examples

WRONG_STARTS = {
    "bodies that overlap": ("[[body]]\nradius = 1\n[[body]]\nradius = 1\n", 1, "body.0 and body.1 overlap"),
    "a body in a plane": ("[[plane]]\n[[body]]\nradius = 1\n", 2, "body.0 overlaps"),
    "a full region": ("[[group]]\nregion = { radius = 3 }\nradius = 1\n", 2, "group.0.region is too small"),
    "a body larger than its region": (
        '[[group]]\nradius = 1\ncount = 1\n[group.region]\nshape = "box"\nsize = [9, 9, 1]\n',
        4,
        "group.0: a body of radius 1 m does not fit",
    ),
    "a full box": ('[domain]\nboundary = "walls"\nsize = [4, 4, 4]\n[[group]]\nradius = 1\n', 3, "domain.size: the"),
}


@pytest.mark.parametrize(("text", "line", "said"), WRONG_STARTS.values(), ids=WRONG_STARTS)
def test_a_start_that_cannot_be_placed_is_refused_with_the_line_of_its_key(text: str, line: int, said: str) -> None:
    with pytest.raises(SceneError, match=rf"^mine\.toml:{line}: {said}"):
        place(scene_from_text(text, "mine.toml"))


def test_a_start_that_an_override_makes_impossible_is_refused_with_the_override() -> None:
    text = '[domain]\nboundary = "walls"\nsize = [9, 9, 9]\n[[group]]\nradius = 1\ncount = 10\n'
    scene = scene_from_text(text, "mine.toml", ["domain.size=[4, 4, 4]"])
    with pytest.raises(SceneError, match=r"^the override domain\.size=\[4, 4, 4\]: domain\.size: the groups"):
        place(scene)


def brute_force(position: Any, radius: Any, box: Any) -> Any:
    i, j = np.triu_indices(len(radius), 1)
    touching = squared_distance(position[i], position[j], box) <= (radius[i] + radius[j]) ** 2
    return np.column_stack((i[touching], j[touching]))


def placed(**group: Any) -> Any:
    return place(Scene.from_dict({"seed": 1, "group": [group]}))


@examples(60)
@given(seed=st.integers(0, 2**32 - 1), count=st.integers(2, 120), decades=st.floats(0, 2), periodic=st.booleans())
def test_few_and_many_bodies_overlap_where_testing_every_pair_finds_it(
    seed: int, count: int, decades: float, periodic: bool
) -> None:
    rng = np.random.default_rng(seed)
    box = np.array([10.0, 12.0, 14.0])
    position = (rng.random((count, 3)) - 0.5) * box
    radius = 2.4 * 10.0 ** (-decades * rng.random(count))
    domain = box if periodic else None
    found = overlapping_pairs(position, radius, domain)
    assert np.array_equal(found, brute_force(position, radius, domain))


@pytest.mark.parametrize("distribution", ["uniform", "log-uniform", "power-law"])
def test_no_two_random_bodies_overlap(distribution: str) -> None:
    start = placed(count=1500, radius={"min": 0.1, "max": 2.0, "distribution": distribution})
    assert len(overlapping_pairs(start.position, start.radius)) == 0
    assert start.radius.min() >= 0.1 and start.radius.max() <= 2.0


def test_whole_spheres_lie_in_their_region() -> None:
    start = placed(count=300, radius=0.5, region={"shape": "ball", "radius": 8.0, "centre": [5.0, 0.0, 0.0]})
    distance = np.linalg.norm(start.position - np.array([5.0, 0.0, 0.0]), axis=1)
    assert distance.max() <= 8.0 - 0.5 + 1e-12


def test_a_group_is_placed_around_bodies_that_are_there_already() -> None:
    scene = Scene.from_dict(
        {"body": [{"radius": 5.0}], "group": [{"count": 200, "radius": 0.2, "region": {"radius": 6.0}}]}
    )
    start = place(scene)
    assert len(overlapping_pairs(start.position, start.radius)) == 0


def test_placement_is_uniform_in_the_ball() -> None:
    # The mean of (r/R)³ is 1/2 for a uniform ball, with a standard deviation of √(1/12)/√n of the mean: four of them.
    start = placed(count=20_000, radius=0.001, region={"radius": 1.0})
    cubed = (np.linalg.norm(start.position, axis=1) / 0.999) ** 3
    assert abs(cubed.mean() - 0.5) < 4 * np.sqrt(1 / 12 / 20_000)


def test_the_same_seed_gives_the_same_start_and_another_a_different_one() -> None:
    group = {"count": 50, "radius": 1.0}
    first, again = (place(Scene.from_dict({"seed": 3, "group": [group]})) for _ in range(2))
    other = place(Scene.from_dict({"seed": 4, "group": [group]}))
    assert np.array_equal(first.position, again.position)
    assert not np.array_equal(first.position, other.position)


def test_a_dense_region_is_filled_and_one_too_dense_is_refused() -> None:
    start = placed(count=2000, radius=1.0, region={"radius": 19.5})
    assert len(overlapping_pairs(start.position, start.radius)) == 0
    with pytest.raises(SceneError, match=r"would fill 0\.485 of it"):
        placed(count=2000, radius=1.0, region={"radius": 16.04})


def test_a_group_that_finds_no_room_is_refused_with_the_remedy() -> None:
    # Below the limit on paper, but whole spheres must lie inside: the room left for centres is far smaller.
    with pytest.raises(
        SceneError,
        match=r"could not be placed within .* lower count or radius, or set group\.0\.arrangement = \"compressed\"",
    ):
        placed(count=6, radius=1.0, region={"radius": 2.55})


@pytest.mark.parametrize("boundary", ["periodic", "walls"])
def test_a_group_that_finds_no_place_in_a_default_region_larger_than_the_domain_fills_the_domain(boundary: str) -> None:
    group = {"count": 500, "radius": 0.5, "arrangement": "compressed"}  # its ball, a tenth full, is 17 m wide
    domain = {"boundary": boundary, "size": [8.0, 8.0, 8.0]}
    document = {"gravity": {"constant": 0.0}, "domain": domain, "group": [group]}
    start = place(Scene.from_dict(document))
    assert np.abs(start.position).max() <= 4.0
    ball = {"region": {"radius": 8.6}}  # a region that the scene gives is a region
    with pytest.raises(SceneError, match=r"group\.0"):
        place(Scene.from_dict(document | {"group": [group | ball]}))


def test_two_groups_without_regions_share_a_closed_domain() -> None:
    groups = [{"count": 200, "radius": 0.05}, {"count": 20, "radius": 0.1}]  # both balls are about the same origin
    document = {"domain": {"boundary": "periodic", "size": [3.0, 3.0, 3.0]}, "gravity": {"constant": 0.0}}
    start = place(Scene.from_dict(document | {"group": groups}))
    assert np.linalg.norm(start.position[:200], axis=1).max() < 0.65 < np.abs(start.position[200:]).max() <= 1.5


def test_100000_bodies_at_ten_per_cent_packing_are_placed() -> None:
    group = {"count": 100_000, "radius": {"min": 0.5, "max": 1.5}}
    scene = Scene.from_dict({"group": [group]})
    start = place(scene)
    assert packing_fraction(scene.group[0]) == pytest.approx(0.1)
    assert len(overlapping_pairs(start.position, start.radius)) == 0


def test_bulk_rotation_turns_the_group_as_one() -> None:
    start = placed(count=20, radius=0.1, region={"radius": 3.0, "centre": [1, 2, 3]}, bulk_rotation=[0, 0, 2.0])
    offset = start.position - np.array([1.0, 2.0, 3.0])
    assert np.allclose(start.velocity, np.cross([0.0, 0.0, 2.0], offset), rtol=0, atol=1e-14 * 6)
    assert np.array_equal(start.angular_velocity, np.tile([0.0, 0.0, 2.0], (20, 1)))


def test_velocities_are_maxwellian_about_the_mean() -> None:
    # Four standard errors of the mean, σ/√n, and of the standard deviation, σ/√(2n).
    start = placed(count=5000, radius=0.01, velocity={"mean": [1, 2, 3], "dispersion": 0.5})
    assert np.all(abs(start.velocity.mean(axis=0) - [1, 2, 3]) < 4 * 0.5 / np.sqrt(5000))
    assert np.all(abs(start.velocity.std(axis=0) - 0.5) < 4 * 0.5 / np.sqrt(10_000))


def test_a_group_is_placed_clear_of_planes_and_walls_and_what_is_fixed_stays_so() -> None:
    scene = Scene.from_dict(
        {
            "domain": {"boundary": "walls", "size": [10.0, 10.0, 10.0]},
            "plane": [{"normal": [1.0, 0.0, 2.0]}],
            "body": [{"fixed": True, "position": [0.0, 0.0, 3.0]}],
            "group": [{"count": 200, "radius": 0.2, "region": {"shape": "box", "size": [20.0, 20.0, 20.0]}}],
        }
    )
    start = place(scene)
    assert half_spaces(scene).depth(start.position, start.radius).max() < 0.0
    assert len(overlapping_pairs(start.position, start.radius)) == 0
    assert start.fixed.tolist() == [True] + [False] * 200


def test_half_spaces_are_the_planes_and_then_the_walls_with_unit_normals_and_laws() -> None:
    scene = Scene.from_dict(
        {
            "contact": {"restitution": 0.3, "static_friction": 0.5, "kinetic_friction": 0.2},
            "domain": {"boundary": "walls", "size": [2.0, 4.0, 6.0]},
            "plane": [{"name": "ramp", "point": [0, 0, 1], "normal": [3e200, 0, 4e200], "restitution": 0.9}],
            "body": [{"position": [0, 0, 2], "radius": 0.1}],
        }
    )
    solids = half_spaces(scene)
    assert solids.name == ["ramp"] + [f"wall at {side}{axis}" for axis in "xyz" for side in "-+"]
    assert np.allclose(np.linalg.norm(solids.normal, axis=1), 1.0, rtol=0, atol=2e-16)
    assert np.allclose(solids.normal[0], [0.6, 0.0, 0.8], rtol=0, atol=2e-16)
    assert np.allclose(solids.offset, [0.8, -1, -1, -2, -2, -3, -3], rtol=0, atol=2e-16)
    assert pair_coefficients(scene).rows[1:].tolist() == [[0.9, 0.5, 0.2]] + [[0.3, 0.5, 0.2]] * 6


@pytest.mark.parametrize("size", [12.649110640673518, 7.3, 10.0])
def test_a_body_that_begins_on_the_border_of_a_periodic_box_stays_there_when_it_is_placed_again(size: float) -> None:
    domain = {"boundary": "periodic", "size": [size] * 3}
    others: dict[str, Any] = {"domain": domain, "contact": {"enabled": False}, "gravity": {"constant": 0.0}}
    bodies = [{"position": [turn * size / 2.0, 0.0, 0.0], "radius": 0.01} for turn in range(-9, 10)]
    once = place(Scene.from_dict({"body": bodies, **others}))
    again = Scene.from_arrays(position=once.position, radius=0.01, mass=1.0, **others)
    assert np.array_equal(place(again).position, once.position)
    assert np.abs(once.position).max() <= size / 2.0


def test_a_body_written_outside_a_periodic_box_begins_inside_it() -> None:
    bodies = [{"position": [0.0, 1000.0, -4.5]}, {"position": [3.0, 3.0, 12.0]}]
    group = {"count": 5, "radius": 0.1, "region": {"radius": 5.0, "centre": [300.0, 0.0, 0.0]}}
    domain = {"boundary": "periodic", "size": [10.0, 12.0, 14.0]}
    scene = Scene.from_dict({"gravity": {"constant": 0.0}, "domain": domain, "body": bodies, "group": [group]})
    position = place(scene).position
    assert np.allclose(position[:2], [[0.0, 4.0, -4.5], [3.0, 3.0, -2.0]])
    assert (np.abs(position) <= [5.0, 6.0, 7.0]).all()


def test_more_pairs_than_memory_holds_are_counted_and_refused() -> None:
    with pytest.raises(SceneError, match=r"7.2e\+07 pairs of bodies overlap or nearly overlap"):
        overlapping_pairs(np.zeros((12_000, 3)), np.ones(12_000))


def test_a_body_whose_radius_is_a_rounding_of_its_position_does_not_begin_behind_a_wall() -> None:
    # Four units in the last place are allowed for rounding, which is more than this radius.
    beyond = float(np.nextafter(np.nextafter(1.0, 2.0), 2.0))
    body = {"position": [beyond, 0.0, 0.0], "radius": 3e-16, "mass": 1.0}
    with pytest.raises(SceneError, match=r"body\.0 overlaps wall at \+x by .* at the start"):
        place(Scene.from_dict({"body": [body], "domain": {"boundary": "walls", "size": [2.0, 2.0, 2.0]}}))
