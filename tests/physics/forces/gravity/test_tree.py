"""Gravity by a tree: beside the direct sum, within the error of its opening angle, and the same bits on any threads."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from carom.physics.forces.gravity.boxes import GRAIN, GROUP, LEAF, Boxes
from carom.physics.forces.gravity.tree import TreeGravity
from carom.physics.jit.team import Team
from carom.physics.space import Space
from carom.scene.load import Scene
from gravity_shapes import SHAPES, Shape, ball, errors, masses, plummer, pulled_by, summed

FloatArray = NDArray[np.float64]

# docs/physics.md: the median and the 99th percentile of |a - a_direct| / |a_direct| stay below these times θ^3.5
MEDIAN, PERCENTILE_99 = 0.012, 0.1


def pulled(
    position: FloatArray, mass: FloatArray, theta: float, softening: float = 0.0, quadrupoles: bool = True
) -> tuple[FloatArray, float | None]:
    return pulled_by(TreeGravity(mass, 1.0, softening, theta, quadrupoles), position)


@pytest.mark.parametrize("theta", [pytest.param(0.2, marks=pytest.mark.slow), 0.3, 0.5, 0.7, 0.8])
@pytest.mark.parametrize("shape", [plummer, ball])
def test_the_error_is_that_of_the_opening_angle(shape: Shape, theta: float) -> None:
    position, mass = shape(3000), masses(3000)
    error = errors(pulled(position, mass, theta)[0], summed(position, mass)[0])
    assert np.median(error) <= MEDIAN * theta**3.5
    assert np.percentile(error, 99) <= PERCENTILE_99 * theta**3.5


@pytest.mark.parametrize("shape", [plummer, ball])
def test_half_the_opening_angle_takes_the_error_to_an_eighth(shape: Shape) -> None:
    # What a box leaves out begins with its octupole, θ³ of its pull.
    position, mass = shape(3000), masses(3000)
    expected = summed(position, mass)[0]
    coarse, fine = (np.median(errors(pulled(position, mass, theta)[0], expected)) for theta in (0.6, 0.3))
    assert fine <= coarse / 8


@pytest.mark.parametrize("shape", [plummer, ball])
def test_without_quadrupoles_the_error_is_that_of_points(shape: Shape) -> None:
    # docs/physics.md: below 0.05 and 0.3 times θ³, a slope of 3.13 to 3.15. What a point leaves out begins with θ² of
    # its pull, since about the centre of mass there is no dipole; and smaller angles leave fewer bodies to points.
    position, mass = shape(3000), masses(3000)
    expected, angles = summed(position, mass)[0], np.array([0.2, 0.3, 0.5, 0.7, 0.8])
    found = [errors(pulled(position, mass, theta, quadrupoles=False)[0], expected) for theta in angles]
    median = np.median(found, axis=1)
    assert np.all(median <= 0.05 * angles**3) and np.all(np.percentile(found, 99, axis=1) <= 0.3 * angles**3)
    assert np.polyfit(np.log(angles), np.log(median), 1)[0] == pytest.approx(3.1, abs=0.15)
    full = [np.median(errors(pulled(position, mass, theta)[0], expected)) for theta in angles]
    assert np.all(full <= median / 3)


@pytest.mark.parametrize("decades", [6.0, 30.0])
def test_masses_may_span_decades(decades: float) -> None:
    position, mass = plummer(2000), masses(2000, decades)
    error = errors(pulled(position, mass, 0.5)[0], summed(position, mass)[0])
    assert np.median(error) <= MEDIAN * 0.5**3.5
    assert np.percentile(error, 99) <= PERCENTILE_99 * 0.5**3.5


@pytest.mark.parametrize("n", [1, 2, 3, LEAF, LEAF + 1, GROUP - 1, GROUP, GROUP + 1, 2 * GROUP + 1])
@pytest.mark.parametrize("softening", [0.0, 0.3])
def test_any_number_of_bodies_is_summed(n: int, softening: float) -> None:
    position, mass = ball(n), masses(n)
    found, energy = pulled(position, mass, 0.5, softening)
    expected, expected_energy = summed(position, mass, softening)
    assert np.abs(found - expected).max() <= MEDIAN * np.abs(expected).max()
    assert energy == pytest.approx(expected_energy, rel=MEDIAN, abs=1e-300)


def test_bodies_at_one_point_do_not_pull_each_other() -> None:
    position, mass = np.ones((3 * GROUP, 3)), masses(3 * GROUP)
    found, energy = pulled(position, mass, 0.5)
    assert energy == 0.0
    assert np.array_equal(found, np.zeros_like(position))


def test_softened_bodies_at_one_point_have_a_potential_and_no_pull() -> None:
    position, mass = np.ones((3 * GROUP, 3)), np.ones(3 * GROUP)
    found, energy = pulled(position, mass, 0.5, softening=0.5)
    pairs = 3 * GROUP * (3 * GROUP - 1) / 2
    assert energy == pytest.approx(-pairs / 0.5, rel=1e-12)
    assert np.array_equal(found, np.zeros_like(position))


def test_the_potential_is_that_of_the_force() -> None:
    # a = -∇φ of the same multipoles: moving everything but one light body by h changes its φ by -a·h, to order h².
    position, mass = plummer(2000), masses(2000)
    position[0], mass[0] = [3.0, 4.0, 5.0], 1e-6
    acceleration = pulled(position, mass, 0.5)[0][0]
    h = 1e-4
    gradient = np.zeros(3)
    for axis in range(3):
        energies = []
        for sign in (1.0, -1.0):
            moved = position.copy()
            moved[0, axis] += sign * h
            energy = pulled(moved, mass, 0.5)[1]
            assert energy is not None
            energies.append(energy)
        gradient[axis] = (energies[0] - energies[1]) / (2 * h) / mass[0]
    # The rest of the bodies see it too, through other boxes: their halves of U agree to the opening error only, and the
    # difference of two sums of 10⁷ times its size keeps 10⁻⁶.
    assert np.abs(gradient + acceleration).max() <= 1e-3 * np.linalg.norm(acceleration)


def test_leaving_out_the_potential_changes_no_bit_of_the_acceleration() -> None:
    position, mass = plummer(1000), masses(1000)
    gravity = TreeGravity(mass, 1.0, 0.0, 0.5)
    with_potential, without = np.empty((1000, 3)), np.empty((1000, 3))
    gravity.accelerate(position, with_potential, potential=True)
    gravity.accelerate(position, without, potential=False)
    assert np.array_equal(with_potential, without)


@pytest.mark.parametrize("threads", [2, 3, 4])
def test_threads_change_no_bit(threads: int) -> None:
    position, mass = plummer(6000), masses(6000)
    serial, parallel = np.empty((6000, 3)), np.empty((6000, 3))
    energy = TreeGravity(mass, 1.0, 0.0, 0.5).accelerate(position, serial, potential=True)
    shared = TreeGravity(mass, 1.0, 0.0, 0.5, True, Team(threads)).accelerate(position, parallel, potential=True)
    assert np.array_equal(serial, parallel) and energy == shared


@pytest.mark.parametrize("shape", SHAPES)
def test_the_order_of_the_bodies_does_not_matter(shape: Shape) -> None:
    position, mass = shape(1000), masses(1000)
    order = np.random.default_rng(6).permutation(1000)
    found, _ = pulled(position, mass, 0.5)
    shuffled, _ = pulled(position[order], mass[order], 0.5)
    # The boxes are the same and their sums are in another order. A centre of mass is rounded by 2⁻⁵³ of its distance
    # from the first body of its box, and far from the origin by 2⁻⁵³ of that.
    rounding = 1000 * 4e-16 * (1.0 + np.abs(position.mean(axis=0)).max())
    assert np.abs(shuffled - found[order]).max() <= rounding * np.abs(found).max()


@pytest.mark.parametrize("theta", [0.3, 0.5, 0.8])
def test_forces_add_up_to_nothing_within_the_opening_error(theta: float) -> None:
    position, mass = plummer(3000), masses(3000)
    force = mass[:, None] * pulled(position, mass, theta)[0]
    assert np.linalg.norm(force.sum(axis=0)) <= MEDIAN * theta**3.5 * np.linalg.norm(force, axis=1).sum()


@pytest.mark.parametrize("n", [1000, 2 * GRAIN])  # sorted by one thread, and by whoever is free
@pytest.mark.parametrize("shape", SHAPES)
def test_boxes_stand_in_preorder_and_hold_every_body_once(shape: Shape, n: int) -> None:
    boxes = Boxes(np.ones(n))
    position = shape(n)
    boxes.sort(position)
    assert np.array_equal(np.sort(boxes.body), np.arange(n))
    assert np.array_equal(boxes.position.T, position[boxes.body])
    first, last, skip = (array[: boxes.count] for array in (boxes.first, boxes.last, boxes.skip))
    for box in range(boxes.count):
        inside = range(box + 1, skip[box])
        assert all(first[box] <= first[k] and last[k] <= last[box] for k in inside)
        assert skip[box] == boxes.count or first[skip[box]] == last[box]
    assert boxes.groups[0] == 0 and boxes.groups[-1] == n
    sizes = np.diff(boxes.groups)
    assert sizes.min() > 0 and sizes.max() <= GROUP


@pytest.mark.parametrize("shape", SHAPES)
def test_boxes_are_the_same_on_any_number_of_threads(shape: Shape) -> None:
    n = 8 * GRAIN + 1
    found = set()
    for threads in (1, 2, 4):
        boxes = Boxes(np.ones(n), Team(threads))
        for _ in range(3):  # chance decides which thread sorts which body
            boxes.sort(shape(n))
            parts = [array[: boxes.count].tobytes() for array in (boxes.first, boxes.last, boxes.skip)]
            found.add((boxes.count, boxes.body.tobytes(), boxes.position.tobytes(), boxes.groups.tobytes(), *parts))
    assert len(found) == 1


def test_a_cloud_falls_together_by_a_tree_as_by_the_direct_sum() -> None:
    group = {"count": 400, "radius": 0.1, "region": {"shape": "ball", "radius": 3.0}}
    document = {"time": {"max_dt": 0.01, "duration": 0.2}, "group": [group], "contact": {"enabled": False}}
    end = {}
    for method in ("tree", "direct"):
        space = Space(Scene.from_dict({**document, "gravity": {"constant": 1e-3, "method": method}}))
        start = space.state.position.copy()
        for frame in space.run():
            end[method] = frame.position
    moved = np.linalg.norm(end["direct"] - start, axis=1)
    parted = np.linalg.norm(end["tree"] - end["direct"], axis=1)
    # The error of the pull, carried along; a body whose pull is small is compared with the typical way.
    assert 0.0 < np.percentile(parted, 99) <= PERCENTILE_99 * 0.5**3.5 * np.median(moved)
