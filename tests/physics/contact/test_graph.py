"""The collision graph and its colourings."""

from __future__ import annotations

from unittest import mock

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from carom.errors import PhysicsError
from carom.physics.contact.broad_phase.grid import ALL_PAIRS_UP_TO, HierarchicalGrid, _buffer_for
from carom.physics.contact.graph import (
    CONTACTS_PER_PIECE,
    OVERFLOW,
    colour_bodies,
    colour_contacts,
    solve_order_of,
)
from carom.physics.contact.pair_list import KdTree, PairList
from carom.physics.jit.team import Team
from seeds import examples
from small_scenes import random_bodies, solver_of

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


@st.composite
def graphs(draw: st.DrawFn) -> tuple[IntArray, int]:
    n = draw(st.integers(2, 40))
    i, j = np.triu_indices(n, 1)
    chosen = np.array(draw(st.lists(st.booleans(), min_size=len(i), max_size=len(i))))
    return np.column_stack((i[chosen], j[chosen])).astype(np.int64), n


def test_equal_spheres_need_at_most_23_colours() -> None:
    # A sphere touches at most 12 equal ones, so a contact has at most 22 that share a body with it. Slight overlaps of
    # a lattice keep the touching number at 12.
    k = np.arange(6)
    x, y, z = (axis.ravel().astype(float) for axis in np.meshgrid(k, k, k))
    hexagonal = np.column_stack((2 * x + y + z, np.sqrt(3) * (y + z / 3), 2 * np.sqrt(6) / 3 * z)) * 0.9999
    pairs = HierarchicalGrid(np.ones(216), np.zeros(3)).pairs(hexagonal)
    assert np.bincount(pairs.ravel()).max() == 12
    assert colour_contacts(pairs, np.ones(216)).max() < 23


def test_a_hub_past_64_colours_overflows_into_a_last_stage() -> None:
    pairs = np.column_stack((np.zeros(100, dtype=np.int64), np.arange(1, 101)))
    colours = colour_contacts(pairs, np.ones(101))
    assert np.array_equal(colours[:64], np.arange(64))
    assert np.all(colours[64:] == OVERFLOW)


def test_stages_follow_each_other_and_keep_the_order_of_pairs() -> None:
    pairs = np.array([[0, 1], [0, 2], [1, 2], [1, 3], [2, 3]])
    order = solve_order_of(pairs, np.array([2, 0, 1, 0, 2]))
    assert list(order.place) == [3, 0, 2, 1, 4]
    assert np.array_equal(order.pairs[order.place], pairs)


@settings(max_examples=20, deadline=None)
@given(sizes=st.lists(st.integers(0, 3 * CONTACTS_PER_PIECE), min_size=1, max_size=OVERFLOW + 1))
def test_pieces_cover_all_contacts_and_none_is_of_two_colours(sizes: list[int]) -> None:
    colours = np.random.default_rng(0).permutation(np.repeat(np.arange(len(sizes)), sizes))
    order = solve_order_of(np.zeros((len(colours), 2), dtype=np.int64), colours)
    covered = [place for lo, hi in order.pieces for place in range(lo, hi)]
    assert covered == list(range(len(colours)))
    for lo, hi in order.pieces:
        assert len(np.unique(np.sort(colours)[lo:hi])) == 1 and hi - lo <= CONTACTS_PER_PIECE
    assert order.edges[-1] == len(order.pieces)
    assert order.independent <= OVERFLOW


@examples(100)
@given(graphs())
def test_no_two_contacts_of_a_colour_share_a_body(graph: tuple[IntArray, int]) -> None:
    pairs, n = graph
    colours = colour_contacts(pairs, np.ones(n))
    for colour in np.unique(colours[colours < OVERFLOW]):
        bodies = pairs[colours == colour].ravel()
        assert len(np.unique(bodies)) == len(bodies)


@examples(100)
@given(graphs())
def test_touching_bodies_differ_in_the_seeds_colouring(graph: tuple[IntArray, int]) -> None:
    pairs, n = graph
    contact_colours, body_colours = colour_bodies(pairs, n)
    assert np.all(body_colours[pairs[:, 0]] != body_colours[pairs[:, 1]])
    assert np.array_equal(contact_colours, body_colours[pairs].min(axis=1))
    touching = np.zeros(n, dtype=bool)
    touching[pairs] = True
    assert np.array_equal(body_colours == -1, ~touching)


@examples(100)
@given(
    seed=st.integers(0, 10**6),
    count=st.integers(1, 80),
    decades=st.floats(0.0, 4.0),
    far=st.sampled_from([0.0, 1e3, 1e12]),
    scale=st.sampled_from([1.0, 1.0 + 1e-9, 1.1]),
    few=st.sampled_from([0, ALL_PAIRS_UP_TO]),
)
def test_grids_find_what_trees_find(seed: int, count: int, decades: float, far: float, scale: float, few: int) -> None:
    # Sorted into cells, or so few that all pairs are looked at; radii over decades, a body far away, more contacts than
    # the buffer has room for, and boxes so narrow that two neighbours of a cell are the same one.
    rng = np.random.default_rng(seed)
    radius = 10.0 ** -rng.uniform(0.0, decades, count)
    position = rng.uniform(-4.0, 4.0, (count, 3)) * rng.choice([1.0, 0.2])
    for box in (np.zeros(3), np.array([4.0, 6.0, 20.0]) * radius.max()):
        if box[0] == 0.0:
            position[0] += far
        with mock.patch("carom.physics.contact.broad_phase.grid.ALL_PAIRS_UP_TO", few):
            grid, trees = HierarchicalGrid(radius, box), KdTree(radius, box)
        assert np.array_equal(grid.pairs(position, scale), trees.pairs(position, scale))
        moved = position + rng.normal(0.0, 0.1, position.shape)
        apart = np.where(np.arange(count)[:, None] > 0, 5.0, 1.0) * moved
        for again in (moved, apart, moved):  # farther apart, octaves share grids
            assert np.array_equal(grid.pairs(again, scale), trees.pairs(again, scale)), "the tables are used again"


@pytest.mark.parametrize("box", [0.0, 60.0, 12.0])  # m; in the last one a planet reaches around to itself
def test_grids_find_what_trees_find_in_clusters_of_a_wide_space(box: float) -> None:
    # Crowded wide cells, hashed cells, and planets that search the grids of their pebbles.
    rng = np.random.default_rng(11)
    radius = np.concatenate((np.full(2, 5.0), rng.uniform(0.05, 0.4, 1500)))
    grid, trees = HierarchicalGrid(radius, np.full(3, box)), KdTree(radius, np.full(3, box))
    centres = rng.uniform(-28.0, 28.0, (len(radius), 3))
    for spread in (1.0, 0.3, 0.05, 1.0):
        position = np.where(np.arange(len(radius))[:, None] % 10 == 0, centres, spread * centres)
        for skin in (0.0, 0.01):
            assert np.array_equal(grid.pairs(position, skin=skin), trees.pairs(position, skin=skin))


class CountedSearch(HierarchicalGrid):
    """Counts the searches."""

    searches = 0

    def pairs(self, position: FloatArray, scale: float = 1.0, skin: float = 0.0) -> IntArray:
        self.searches += 1
        return super().pairs(position, scale, skin)


@pytest.mark.parametrize("side", [0.0, 9.5, 7.0])  # m, of the periodic box; no list fits into the last one
def test_a_list_finds_what_a_search_finds_at_any_pace_and_saves_searches_at_a_slow_one(side: float) -> None:
    rng = np.random.default_rng(2)
    box, team = np.full(3, side), Team(2)
    radius = rng.uniform(0.5, 1.5, 4 * ALL_PAIRS_UP_TO)
    position = rng.uniform(-9.0, 9.0, (len(radius), 3))
    searched, grid = HierarchicalGrid(radius, box), CountedSearch(radius, box)
    listed = PairList(grid, radius, box, team)
    counts = []
    for pace in (1e-3, 0.05, 1e-3):
        before = grid.searches
        for step in range(40):
            position = position + rng.normal(0.0, pace, position.shape)
            if side > 0.0:
                position -= side * (position > 0.5 * side)  # bodies jump to the other side
            scale, skin = 1.0 + 0.01 * rng.random() * (step % 3 == 0), 0.01 * rng.random()
            assert np.array_equal(listed.pairs(position, scale, skin), searched.pairs(position, scale, skin))
        counts.append(grid.searches - before)
    assert counts[1] == 40
    assert max(counts[0], counts[2]) < 15 or side == 7.0


def test_a_shorter_search_after_a_move_needs_no_second_search() -> None:
    rng = np.random.default_rng(3)
    radius, position = rng.uniform(0.8, 1.2, 4 * ALL_PAIRS_UP_TO), rng.uniform(-9.0, 9.0, (4 * ALL_PAIRS_UP_TO, 3))
    searched, grid = HierarchicalGrid(radius, np.zeros(3)), CountedSearch(radius, np.zeros(3))
    listed, fastest = PairList(grid, radius, np.zeros(3), Team(1)), 0.5
    for _ in range(5):  # a drift searches as far as bodies may move in it, which is too fast for a list
        listed.pairs(position, scale=1.02 + fastest / radius.min())
        position = position + rng.uniform(-1.0, 1.0, position.shape) * fastest / np.sqrt(3.0)
        assert np.array_equal(listed.pairs(position, scale=1.01), searched.pairs(position, scale=1.01))
    assert grid.searches == 5


def test_a_search_with_a_skin_finds_what_nearly_touches() -> None:
    position, radius = np.array([[0.0, 0.0, 0.0], [2.05, 0.0, 0.0]]), np.ones(2)
    for search in (HierarchicalGrid(radius, np.zeros(3)), KdTree(radius, np.zeros(3))):
        assert len(search.pairs(position)) == 0
        assert len(search.pairs(position, skin=0.04)) == 0
        assert len(search.pairs(position, skin=0.06)) == 1
        assert len(search.pairs(position, scale=1.03)) == 1


def test_normals_point_from_i_to_j_and_overlaps_are_depths() -> None:
    bodies = random_bodies(3, 0)
    bodies.position[:] = [[0.0, 0.0, 0.0], [1.5, 0.0, 0.0], [0.0, 0.0, 0.0]]
    bodies.radius[:] = 1.0
    solver = solver_of(bodies, np.array([[0, 1], [0, 2]]), [0.0, 0.0, 0.0])
    assert np.array_equal(solver.normals, [[1, 0, 0], [1, 0, 0]]), "coincident centres get the same direction always"
    assert np.array_equal(solver.arms.sum(axis=1), [1.5, 0.0])
    assert np.array_equal(solver.overlaps, [0.5, 2.0])


def test_in_a_periodic_box_the_nearest_image_is_touched() -> None:
    bodies, box = random_bodies(2, 0), np.full(3, 10.0)
    bodies.position[:] = [[-4.6, 0.0, 0.0], [4.6, 0.0, 0.0]]
    bodies.radius[:] = 0.5
    solver = solver_of(bodies, HierarchicalGrid(bodies.radius, box).pairs(bodies.position), [0.0, 0.0, 0.0], box)
    assert np.array_equal(solver.normals, [[-1.0, 0.0, 0.0]])
    assert np.allclose(solver.arms.sum(axis=1), 0.8, rtol=1e-15)


def test_more_pairs_than_there_is_memory_for_are_reported_with_a_remedy() -> None:
    with pytest.raises(PhysicsError, match=r"1e\+15 pairs of bodies may touch .* lower time.max_dt"):
        _buffer_for(10**15)
