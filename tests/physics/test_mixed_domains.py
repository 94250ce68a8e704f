"""Space that repeats along some axes, and has walls, planes or no end along the others."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from carom.errors import SceneError
from carom.physics.contact.broad_phase.grid import HierarchicalGrid
from carom.physics.placement.neighbours import overlapping_pairs, squared_distance
from carom.physics.space import Space
from carom.scene.load import Scene
from carom.scene.portable_math import ENDLESS
from small_scenes import scene_of

FALLS = {"constant": 0.0, "uniform": [0.0, 0.0, -9.81]}


@given(st.sets(st.sampled_from(range(3)), min_size=1), st.integers(0, 2**31))
def test_the_grid_finds_the_pairs_of_all_images_along_the_axes_that_repeat(axes: set[int], seed: int) -> None:
    random = np.random.default_rng(seed)
    n = 200
    repeats = np.array([k in axes for k in range(3)])
    width = random.uniform(4.0, 12.0, 3)
    box = np.where(repeats, width, ENDLESS)
    radius = random.choice([0.1, 0.3, 0.9], n, p=[0.6, 0.3, 0.1])
    position = random.uniform(-0.5, 0.5, (n, 3)) * np.where(repeats, width, 20.0)
    i, j = np.triu_indices(n, 1)
    near = squared_distance(position[i], position[j], box) <= (radius[i] + radius[j]) ** 2
    expected = np.column_stack((i, j))[near].tolist()
    assert overlapping_pairs(position, radius, box).tolist() == expected
    i, j = HierarchicalGrid(radius, box).pairs(position).T
    touching = squared_distance(position[i], position[j], box) <= (radius[i] + radius[j]) ** 2
    assert np.column_stack((i, j))[touching].tolist() == expected


def test_a_ball_bounces_on_a_floor_that_repeats_as_on_one_without_end() -> None:
    ball = {"position": [0.0, 0.0, 2.0], "velocity": [3.0, -2.0, 0.0], "radius": 0.5}
    sections: dict[str, Any] = {
        "plane": [{}],
        "gravity": FALLS,
        "contact": {"restitution": 0.9, "static_friction": 0.2, "kinetic_friction": 0.2},
        "time": {"duration": 3.0, "fixed_dt": 1 / 64, "integrator": "leapfrog"},
    }
    domain = {"boundary": ["periodic", "periodic", "open"], "size": [4.0, 5.0, 1.0]}
    *_, endless = Space(scene_of([ball], **sections)).run()
    *_, repeats = Space(scene_of([ball], domain=domain, **sections)).run()
    apart = endless.position[0] - repeats.position[0]
    turns = apart[:2] / [4.0, 5.0]
    # a wrapped coordinate is rounded at each of 200 steps
    np.testing.assert_allclose(turns, np.round(turns), atol=1e-13)
    assert np.any(np.round(turns) != 0)
    assert np.all(np.abs(repeats.position[0, :2]) <= [2.0, 2.5])
    assert apart[2] == 0.0
    assert np.array_equal(endless.velocity, repeats.velocity)


def test_a_gas_between_two_walls_keeps_its_energy_and_the_momentum_along_them() -> None:
    group = {
        "count": 40,
        "radius": 0.25,
        "region": {"shape": "box", "size": [5.0, 4.0, 3.0]},
        "velocity": {"mean": [1.0, 0.5, 0.0], "dispersion": 1.0},
        "density": 1.0,
    }
    scene = Scene.from_dict(
        {
            "group": [group],
            "gravity": {"constant": 0.0},
            "contact": {"restitution": 1.0, "static_friction": 0.0, "kinetic_friction": 0.0},
            "domain": {"boundary": ["periodic", "periodic", "walls"], "size": [5.0, 4.0, 3.0]},
            "time": {"duration": 4.0},
        }
    )
    space = Space(scene)
    frames = list(space.run())
    first, last = frames[0], frames[-1]
    assert space.box is not None
    assert space.box.tolist() == [5.0, 4.0, ENDLESS]
    assert np.all(np.abs(last.position[:, 2]) <= 1.25 + 1e-9)
    mass = space.state.mass[:, None]
    # some 500 impacts round both
    momentum = [(mass * frame.velocity).sum(axis=0) for frame in (first, last)]
    np.testing.assert_allclose(momentum[1][:2], momentum[0][:2], rtol=1e-13)
    energy = [float((mass * frame.velocity**2).sum()) for frame in (first, last)]
    assert energy[1] == pytest.approx(energy[0], rel=1e-12)
    assert last.angular_momentum_error is None  # which a box that repeats does not conserve


def test_bodies_are_placed_around_others_in_a_box_that_repeats_along_some_axes() -> None:
    group = {
        "count": 30,
        "radius": 0.2,
        "region": {"shape": "box", "size": [4.0, 4.0, 3.0], "centre": [0.0, 0.0, -4.0]},
    }
    bodies = [{"position": [x, x, -4.0], "radius": 0.5, "fixed": True} for x in (-1.9, 0.0)]
    scene = {"body": bodies, "group": [group], "gravity": {"constant": 0.0}}
    domain = {"boundary": ["periodic", "periodic", "open"], "size": [4.0, 4.0, 1.0]}
    state = Space(Scene.from_dict(scene | {"domain": domain})).state
    box = np.array([4.0, 4.0, ENDLESS])
    assert len(state.position) == 32
    assert not len(overlapping_pairs(state.position, state.radius, box))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"plane": [{"normal": [0.1, 0, 1]}]}, "its component along x must be 0, because space repeats along that"),
        (
            {"gravity": {"constant": 0.0, "uniform": [0, 1, 0]}},
            'gravity.uniform along y, where domain.boundary is "per',
        ),
        ({"gravity": {"constant": 1.0}}, "self-gravity"),
        ({"domain": {"boundary": ["periodic", "open", "open"]}}, "boundary = ['periodic', 'open', 'open'] needs size"),
        ({"domain": {"boundary": ["periodic", "sticky", "open"], "size": [1, 1, 1]}}, "domain.boundary"),
        ({"domain": {"boundary": ["periodic", "open", "open"], "size": [1, 9, 9]}}, "four times the largest radius"),
    ],
)
def test_what_cannot_repeat_is_refused(change: dict[str, Any], said: str) -> None:
    scene = {
        "body": [{"radius": 0.5}],
        "gravity": {"constant": 0.0},
        "domain": {"boundary": ["periodic", "periodic", "open"], "size": [9.0, 9.0, 9.0]},
    }
    with pytest.raises(SceneError) as caught:
        Space(Scene.from_dict(scene | change))
    assert said in str(caught.value)


def test_three_equal_boundaries_are_one() -> None:
    domain = {"boundary": ["walls", "walls", "walls"], "size": [3.0, 3.0, 3.0]}
    assert Scene.from_dict({"body": [{"radius": 0.5}], "domain": domain}).domain.boundary == "walls"
