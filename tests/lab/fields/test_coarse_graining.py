"""Sums over the cells of a grid: of planted bodies and branch vectors, by hand and by brute force."""

from __future__ import annotations

import numpy as np
import pytest

from carom.arrays import FloatArray
from carom.lab.fields.coarse_graining import BodySums, Branches, Grid, add_transferred
from carom.scene.schema.shear import Shear

PERIODIC, OPEN = (True, True, True), (False, False, False)
ROUNDING = 1e-12  # of sums of a few hundred numbers of order 1


def grid_of(periodic: tuple[bool, bool, bool] = OPEN, shear: Shear | None = None) -> Grid:
    """Return 4 × 3 × 2 cells of 0.5, 1 and 2 m about the origin."""
    return Grid(np.array([-1.0, -1.5, -2.0]), np.array([0.5, 1.0, 2.0]), (4, 3, 2), periodic, shear)


def branches_of(start: FloatArray, reach: FloatArray, time: float = 0.0) -> Branches:
    impulse = np.random.default_rng(5).normal(size=start.shape)
    return Branches(start, reach, impulse, np.full(len(start), time))


def by_sampling(grid: Grid, branches: Branches, samples: int) -> FloatArray:
    """Integrate φ along branch vectors at equidistant points."""
    total = np.zeros((grid.count, 3, 3))
    for s in (np.arange(samples) + 0.5) / samples:
        cell = grid.cells(branches.start + s * branches.reach, branches.time)
        np.add.at(total, cell, branches.reach[:, :, None] * branches.impulse[:, None, :] / samples)
    return total


def test_a_branch_vector_counts_in_each_cell_with_the_part_of_its_length() -> None:
    # from x = -0.75 to 0.75 in cells of 0.5: a quarter, half and quarter … of 1.5 m are 1/6, 1/3, 1/3, 1/6
    start, reach = np.array([[-0.75, 0.1, 0.1]]), np.array([[1.5, 0.0, 0.0]])
    branch, cell, fraction = grid_of().cut(start, reach, np.zeros(1))
    assert branch.tolist() == [0] * 4
    assert fraction == pytest.approx([1 / 6, 1 / 3, 1 / 3, 1 / 6], abs=ROUNDING)
    assert [np.unravel_index(each, (4, 3, 2)) for each in cell] == [(x, 1, 1) for x in range(4)]


@pytest.mark.parametrize("periodic", [PERIODIC, OPEN])
@pytest.mark.parametrize("rate", [0.0, 0.37])
def test_cut_branch_vectors_are_the_integral_of_the_kernel_also_through_faces_that_repeat(
    periodic: tuple[bool, bool, bool], rate: float
) -> None:
    rng = np.random.default_rng(3)
    shear = Shear(rate=rate, flow="x", gradient="y") if rate and periodic == PERIODIC else None
    grid = grid_of(periodic, shear)
    start = grid.origin + grid.size * rng.random((40, 3))
    branches = branches_of(start, rng.normal(scale=0.4, size=(40, 3)), time=2.3)
    exact, samples = np.zeros((grid.count, 3, 3)), 2000
    add_transferred(exact, grid, branches)
    # each of some 5 pieces of 40 vectors of 0.7 m and impulses of up to 3 N s errs by at most one sample
    assert exact == pytest.approx(by_sampling(grid, branches, samples), abs=40 * 5 * 0.7 * 3 / samples)
    whole = np.einsum("ka,kb->ab", branches.reach, branches.impulse)
    assert exact.sum(axis=0) == pytest.approx(whole, abs=40 * ROUNDING)


def test_the_part_of_a_branch_vector_in_a_fixed_body_is_left_out() -> None:
    start, whole, impulse = np.zeros((4, 3)), np.tile([3.0, 0, 0], (4, 1)), np.ones((4, 3))
    moves = np.array([True, True, False, False]), np.array([True, False, True, False])
    kept = Branches.of(start, whole, impulse, np.zeros(4), np.full(4, 1 / 3), moves)
    assert kept.start[:, 0] == pytest.approx([0.0, 0.0, 1.0], abs=ROUNDING)
    assert kept.reach[:, 0] == pytest.approx([3.0, 1.0, 2.0], abs=ROUNDING)


def test_sums_over_cells_are_sums_over_bodies_and_temperatures_survive_a_common_velocity() -> None:
    rng, grid, wind = np.random.default_rng(1), grid_of(), np.array([1e6, 0.0, 0.0])
    position = grid.origin + grid.size * rng.random((2, 50, 3))
    velocity, mass, radius = rng.normal(size=(2, 50, 3)), rng.uniform(1, 2, 50), rng.uniform(0.1, 0.2, 50)
    still, blown = BodySums(grid), BodySums(grid)
    for k in range(2):
        still.add(position[k], velocity[k], mass, radius, 0.0)
        blown.add(position[k], velocity[k] + wind, mass, radius, 0.0)
    assert still.mass.sum() == pytest.approx(2 * mass.sum(), rel=ROUNDING)
    assert still.momentum.sum(axis=0) == pytest.approx(np.einsum("n,kna->a", mass, velocity), abs=100 * ROUNDING)
    assert still.volume.sum() == pytest.approx(2 * (4 / 3 * np.pi * radius**3).sum(), rel=ROUNDING)
    assert still.number.sum() == 100
    # energy about the cells' means and of the means is the energy of the bodies
    means = still.momentum / np.where(still.mass > 0, still.mass, 1.0)[:, None]
    carried = np.einsum("c,ca,cb->ab", still.mass, means, means)
    whole = np.einsum("n,kna,knb->ab", mass, velocity, velocity)
    assert still.kinetic.sum(axis=0) + carried == pytest.approx(whole, abs=1e3 * ROUNDING)
    # 10⁶ m/s have steps of 10⁻¹⁰ m/s, so the velocities that remain are rounded by that much
    assert blown.kinetic == pytest.approx(still.kinetic, abs=1e-7)


def test_bodies_beyond_a_face_count_in_the_cell_that_repeats_there_or_in_the_last_one() -> None:
    beyond, now = np.array([[1.1, 0.0, 0.1]]), np.zeros(1)
    assert np.unravel_index(grid_of(PERIODIC).cells(beyond, now)[0], (4, 3, 2)) == (0, 1, 1)
    assert np.unravel_index(grid_of().cells(beyond, now)[0], (4, 3, 2)) == (3, 1, 1)
    # across the gradient, the image is shifted by rate × size × time = 0.25 m along the flow
    shear = Shear(rate=0.5, flow="x", gradient="y")
    across = np.array([[0.1, 1.6, 0.1]])
    assert np.unravel_index(grid_of(PERIODIC, shear).cells(across, np.array([1 / 6]))[0], (4, 3, 2)) == (1, 0, 1)
