"""Regions of every shape, lattices, Plummer's model and dense packings, all without overlaps."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from carom.errors import SceneError
from carom.physics.placement import place
from carom.physics.placement.growth import densest
from carom.physics.placement.lattice import CELLS
from carom.physics.placement.neighbours import overlapping_pairs
from carom.scene.load import Scene
from carom.scene.start import InitialBodies

FloatArray = NDArray[np.float64]
Section = dict[str, Any]
ROUNDING = 1e-9  # m, of positions of some metres


def placed(group: Section, **sections: Any) -> InitialBodies:
    start = place(Scene.from_dict({"seed": 3, "group": [group], **sections}))
    assert len(overlapping_pairs(start.position, start.radius)) == 0
    return start


@pytest.mark.parametrize("arrangement", ["random", "compressed", "hcp"])
@pytest.mark.parametrize(
    "region",
    [
        {"shape": "ball", "radius": 4.0},
        {"shape": "box", "size": [6.0, 7.0, 8.0]},
        {"shape": "cylinder", "radius": 3.0, "height": 9.0},
        {"shape": "shell", "radius": 5.0, "inner_radius": 3.0},
    ],
    ids=lambda region: region["shape"],
)
def test_every_sphere_is_inside_its_region(region: Section, arrangement: str) -> None:
    centre = np.array([3.0, -2.0, 5.0])
    group = {"count": 90, "radius": {"min": 0.3, "max": 0.5}, "arrangement": arrangement}
    start = placed({**group, "region": {**region, "centre": centre.tolist()}})
    offset, r = start.position - centre, start.radius
    if region["shape"] == "box":
        assert (np.abs(offset) + r[:, None] <= 0.5 * np.array(region["size"]) + ROUNDING).all()
        return
    distance = np.linalg.norm(offset[:, :2] if region["shape"] == "cylinder" else offset, axis=1)
    assert (distance + r <= region["radius"] + ROUNDING).all()
    assert (distance - r >= region.get("inner_radius", -1.0) - ROUNDING).all()
    assert (np.abs(offset[:, 2]) + r <= 0.5 * region.get("height", 99.0) + ROUNDING).all()


@pytest.mark.parametrize("shape", ["cylinder", "shell"])
def test_centres_are_uniform_in_the_volume_that_is_open_to_them(shape: str) -> None:
    # Kolmogorov and Smirnov: the largest difference is below 1.63/√n in 99 of 100 samples; this one is fixed.
    n, r = 3000, 1e-3
    lengths = {"cylinder": {"radius": 2.0, "height": 6.0}, "shell": {"radius": 2.0, "inner_radius": 1.0}}[shape]
    x = placed({"count": n, "radius": r, "region": {"shape": shape, **lengths}}).position
    if shape == "cylinder":
        parts = [(np.linalg.norm(x[:, :2], axis=1) / (2.0 - r)) ** 2, x[:, 2] / (6.0 - 2 * r) + 0.5]
    else:
        inner, outer = (1.0 + r) ** 3, (2.0 - r) ** 3
        parts = [
            (np.linalg.norm(x, axis=1) ** 3 - inner) / (outer - inner),
            0.5 + 0.5 * x[:, 2] / np.linalg.norm(x, axis=1),
        ]
    for part in parts:
        assert np.abs(np.sort(part) - (np.arange(n) + 0.5) / n).max() < 1.63 / math.sqrt(n)


@pytest.mark.parametrize(
    ("lattice", "neighbours", "packing"),
    [
        ("cubic", 6, math.pi / 6),
        ("fcc", 12, math.pi / math.sqrt(18)),
        ("hcp", 12, math.pi / math.sqrt(18)),
    ],
)
def test_a_lattice_has_the_neighbours_and_the_packing_of_its_kind(
    lattice: str, neighbours: int, packing: float
) -> None:
    region = {"shape": "box", "size": [10.0, 10.0, 10.0]}
    start = placed({"count": 500, "radius": 0.5, "arrangement": lattice, "spacing": 1.0, "region": region})
    distance = np.linalg.norm(start.position[:, None] - start.position, axis=2)
    count = (distance < 1.0 + 1e-6).sum(axis=1) - 1
    assert count.max() == neighbours
    edges, points = CELLS[lattice]
    assert len(points) * math.pi / 6.0 / math.prod(edges) == pytest.approx(packing, rel=1e-15)


def test_a_lattice_without_a_spacing_fills_its_region_and_leaves_room_for_bodies_before_it() -> None:
    group = {"count": 400, "radius": 0.3, "arrangement": "fcc", "region": {"radius": 5.0}}
    free = placed(group)
    assert free.position[:, 2].max() > 4.0, "the highest layer is near the top"
    around = placed(group, body=[{"radius": 2.0}], plane=[{"point": [0.0, 0.0, -3.0]}])
    assert len(around.mass) == 401
    assert (around.position[1:, 2] >= -3.0 + 0.3 - ROUNDING).all()


@pytest.mark.parametrize("arrangement", ["cubic", "fcc", "hcp"])
@pytest.mark.parametrize("shape", ["ball", "shell"])
@pytest.mark.parametrize("count", [1, 2, 3])
def test_a_lattice_of_a_few_spheres_beside_a_body_narrows_until_it_has_points(
    arrangement: str, shape: str, count: int
) -> None:
    region = {"shape": shape, "radius": 4.0} | ({"inner_radius": 1.2} if shape == "shell" else {})
    group = {"count": count, "radius": 0.5, "arrangement": arrangement, "region": region}
    for plane in ([], [{"point": [0.0, 0.0, -1.0]}]):
        start = placed(group, body=[{"radius": 0.3, "position": [0.0, 0.0, -0.5]}], plane=plane)
        assert len(start.position) == count + 1


@pytest.mark.parametrize("packing", [0.45, 0.6])
def test_compression_reaches_its_packing_in_a_periodic_box(packing: float) -> None:
    n = 250
    side = float((n * 4.0 / 3.0 * math.pi / packing) ** (1 / 3))
    group = {"count": n, "radius": 1.0, "arrangement": "compressed", "region": {"shape": "box", "size": [side] * 3}}
    domain = {"boundary": "periodic", "size": [side] * 3}
    scene = Scene.from_dict({"seed": 3, "gravity": {"constant": 0.0}, "domain": domain, "group": [group]})
    start = place(scene)
    assert len(overlapping_pairs(start.position, start.radius, np.full(3, side))) == 0
    assert start.radius.tolist() == [1.0] * n
    assert place(scene).position.tobytes() == start.position.tobytes()


def test_compressed_spheres_keep_clear_of_planes_and_of_bodies_before_them() -> None:
    region = {"radius": 5.0}
    group = {"count": 130, "radius": {"min": 0.4, "max": 0.7}, "arrangement": "compressed", "region": region}
    start = placed(group, body=[{"radius": 2.0}], plane=[{"point": [0.0, 0.0, -3.5]}])
    assert (start.position[1:, 2] - start.radius[1:] >= -3.5).all()


@pytest.mark.parametrize("count", [8, 12])
def test_compressed_spheres_meet_no_image_of_each_other_in_a_box_of_a_few_radii(count: int) -> None:
    side = float((count * 4.0 / 3.0 * math.pi / 0.45) ** (1 / 3))
    group = {"count": count, "radius": 1.0, "arrangement": "compressed", "region": {"shape": "box", "size": [side] * 3}}
    domain = {"boundary": "periodic", "size": [side] * 3}
    x = place(Scene.from_dict({"seed": 3, "gravity": {"constant": 0.0}, "domain": domain, "group": [group]})).position
    images = side * np.array([(i, j, k) for i in (-1, 0, 1) for j in (-1, 0, 1) for k in (-1, 0, 1)])
    i, j = np.triu_indices(count, 1)
    assert np.linalg.norm((x[j] - x[i])[:, None] + images, axis=2).min() >= 2.0


def test_spheres_that_jam_are_refused_at_the_size_that_they_have() -> None:
    # a box is as dense as a periodic one only far from its sides, and this one is two diameters wide
    group = {"count": 9, "radius": 1.0, "arrangement": "compressed", "region": {"shape": "box", "size": [4.0] * 3}}
    with pytest.raises(SceneError, match=r"group\.0: spheres jam at 0\.\d+ of their radius; enlarge the region"):
        place(Scene.from_dict({"group": [group]}))


def test_plummer_spheres_have_the_mass_profile_of_the_model_up_to_the_cut() -> None:
    n, scale, cut = 4000, 2.0, 12.0
    region = {"shape": "plummer", "scale": scale, "radius": cut, "centre": [1.0, 2.0, 3.0]}
    start = placed({"count": n, "radius": 1e-4, "region": region})
    r = np.sort(np.linalg.norm(start.position - [1.0, 2.0, 3.0], axis=1))
    assert r[-1] <= cut

    def within(distance: Any) -> Any:
        return (1.0 + (scale / distance) ** 2) ** -1.5

    cumulative = within(r) / within(cut)
    assert np.abs(cumulative - (np.arange(n) + 0.5) / n).max() < 1.63 / math.sqrt(n)  # as above


@pytest.mark.parametrize("virial", [0.5, 0.1])
def test_plummer_velocities_have_the_virial_ratio_that_was_asked_for(virial: float) -> None:
    n, constant = 1000, 3.0
    region = {"shape": "plummer", "scale": 1.5, "radius": 60.0}
    group = {"count": n, "radius": 1e-5, "mass": 0.7, "region": region, "velocity": {"virial": virial}}
    start = placed(group, gravity={"constant": constant})
    i, j = np.triu_indices(n, 1)
    distance = np.linalg.norm(start.position[i] - start.position[j], axis=1)
    potential = constant * 0.7**2 * float(np.sum(1.0 / distance))
    kinetic = 0.5 * 0.7 * float(np.sum(start.velocity**2))
    # Of 1000 random stars the kinetic and the potential energy vary by 3 % each.
    assert kinetic / potential == pytest.approx(virial, rel=0.08)
    assert np.abs(start.velocity.mean(axis=0)).max() < 0.1 * start.velocity.std()


BAD = {
    "a cylinder without a height": (
        {"region": {"shape": "cylinder", "radius": 3.0}},
        ['shape = "cylinder" needs radius = … and height = …'],
    ),
    "a ball with a height": ({"region": {"radius": 3.0, "height": 3.0}}, ["needs radius = …", "and no height"]),
    "a shell turned inside out": (
        {"region": {"shape": "shell", "radius": 3.0, "inner_radius": 4.0}},
        ["inner_radius is not below radius"],
    ),
    "a lattice in no region": ({"arrangement": "fcc"}, ['arrangement = "fcc" needs a region']),
    "a spacing at random": ({"spacing": 3.0}, ["spacing with arrangement", "cubic, fcc, hcp"]),
    "a spacing below a diameter": (
        {"arrangement": "fcc", "spacing": 1.5, "region": {"radius": 30.0}},
        ["group.0.spacing = 1.5 m", "diameter, 2 m"],
    ),
    "a lattice too small": (
        {"arrangement": "cubic", "count": 30, "region": {"radius": 3.0}},
        ["group.0.region has space for", "of 30 bodies"],
    ),
    "a compressed cluster": (
        {"arrangement": "compressed", "region": {"shape": "plummer", "scale": 9.0}},
        ["in a plummer region", "remove one of them"],
    ),
    "a virial ratio in a ball": ({"velocity": {"virial": 0.5}}, ["velocity.virial", 'shape = "plummer"']),
    "a packing that only compression reaches": (
        {"count": 500, "region": {"radius": 10.0}},
        ["would fill 0.5", "0.38", 'or set arrangement = "compressed"'],
    ),
    "a packing that nothing reaches": (
        {"count": 700, "arrangement": "compressed", "region": {"radius": 10.0}},
        ["would fill 0.7", "0.62"],
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_a_group_that_cannot_be_placed_is_told_why(name: str) -> None:
    group, said = BAD[name]
    with pytest.raises(SceneError) as caught:
        place(Scene.from_dict({"group": [group]}))
    assert [part for part in said if part not in str(caught.value)] == []


def test_a_virial_ratio_needs_gravity() -> None:
    group = {"velocity": {"virial": 0.5}, "radius": 1e-3, "region": {"shape": "plummer", "scale": 1.0}}
    with pytest.raises(SceneError, match=r"group\.0\.velocity\.virial needs gravity"):
        place(Scene.from_dict({"gravity": {"constant": 0.0}, "group": [group]}))


def test_groups_of_one_region_are_compressed_together() -> None:
    region = {"shape": "box", "size": [12.0] * 3}
    sizes = ((280, {"min": 0.43, "max": 1.0}), (500, 0.5))  # 0.28 and 0.15 of the box; 0.17 follow
    groups: list[dict[str, object]] = [
        {"count": count, "radius": radius, "arrangement": "compressed", "region": region} for count, radius in sizes
    ]
    groups.append({"count": 140, "radius": 0.8, "arrangement": "compressed", "region": region})
    scene = Scene.from_dict(
        {"domain": {"boundary": "periodic", "size": [12.0] * 3}, "gravity": {"constant": 0}, "group": groups}
    )
    start = place(scene)
    filled = 4.0 / 3.0 * np.pi * np.sum(start.radius**3) / 12.0**3
    assert filled > 0.6, "two groups one after the other jam at the second"
    assert [list(start.group).count(k) for k in range(3)] == [280, 500, 140]
    assert len(overlapping_pairs(start.position, start.radius, np.full(3, 12.0))) == 0


def test_unequal_spheres_are_compressed_beyond_what_equal_ones_fill() -> None:
    side, small, large = 10.0, 420, 100
    radius = np.repeat([0.5, 1.0], [small, large])
    filled = 4.0 / 3.0 * np.pi * np.sum(radius**3) / side**3
    assert 0.632 < filled < densest(radius), "0.62 is the limit of equal spheres"
    assert densest(np.ones(9)) == pytest.approx(0.62, abs=1e-12)
    region = {"shape": "box", "size": [side] * 3}
    groups = [
        {"count": n, "radius": r, "arrangement": "compressed", "region": region} for n, r in ((420, 0.5), (100, 1))
    ]
    start = place(
        Scene.from_dict(
            {"domain": {"boundary": "periodic", "size": [side] * 3}, "gravity": {"constant": 0}, "group": groups}
        )
    )
    assert len(overlapping_pairs(start.position, start.radius, np.full(3, side))) == 0
