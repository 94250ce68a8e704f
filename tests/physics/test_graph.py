"""The collision graph and its colourings."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from carom.physics.contact.graph import (
    OVERFLOW,
    CollisionGraph,
    colour_bodies,
    colour_contacts,
    stage_order,
)
from carom.physics.contact.grid import Grid
from carom.physics.contact.search import KdTree, contact_geometry

IntArray = NDArray[np.int64]


@st.composite
def graphs(draw: st.DrawFn) -> tuple[IntArray, int]:
    n = draw(st.integers(2, 40))
    i, j = np.triu_indices(n, 1)
    chosen = np.array(draw(st.lists(st.booleans(), min_size=len(i), max_size=len(i))))
    return np.column_stack((i[chosen], j[chosen])).astype(np.int64), n


@settings(max_examples=50, deadline=None)
@given(graphs())
def test_the_adjacency_lists_every_neighbour_in_order(graph: tuple[IntArray, int]) -> None:
    pairs, n = graph
    m = len(pairs)
    offsets, neighbours = CollisionGraph(pairs, np.zeros((m, 3)), np.zeros(m), np.zeros(m, dtype=np.int64)).adjacency(n)
    for body in range(n):
        expected = sorted([*pairs[pairs[:, 0] == body, 1], *pairs[pairs[:, 1] == body, 0]])
        assert list(neighbours[offsets[body] : offsets[body + 1]]) == expected


def test_equal_spheres_need_at_most_23_colours() -> None:
    # A sphere touches at most 12 equal ones, so a contact has at most 22 that share a body with it. Slight overlaps of
    # a lattice keep the touching number at 12.
    k = np.arange(6)
    x, y, z = (axis.ravel().astype(float) for axis in np.meshgrid(k, k, k))
    hexagonal = np.column_stack((2 * x + y + z, np.sqrt(3) * (y + z / 3), 2 * np.sqrt(6) / 3 * z)) * 0.9999
    pairs = Grid(np.ones(216), np.zeros(3)).pairs(hexagonal)
    assert np.bincount(pairs.ravel()).max() == 12
    assert colour_contacts(pairs, np.ones(216)).max() < 23


def test_a_hub_past_64_colours_overflows_into_a_last_stage() -> None:
    pairs = np.column_stack((np.zeros(100, dtype=np.int64), np.arange(1, 101)))
    colours = colour_contacts(pairs, np.ones(101))
    assert np.array_equal(colours[:64], np.arange(64))
    assert np.all(colours[64:] == OVERFLOW)


def test_stages_follow_each_other_and_keep_the_order_of_pairs() -> None:
    colours = np.array([2, 0, 1, 0, 2])
    assert list(stage_order(colours)) == [1, 3, 2, 0, 4]


@settings(max_examples=100, deadline=None)
@given(graphs())
def test_no_two_contacts_of_a_colour_share_a_body(graph: tuple[IntArray, int]) -> None:
    pairs, n = graph
    colours = colour_contacts(pairs, np.ones(n))
    for colour in np.unique(colours[colours < OVERFLOW]):
        bodies = pairs[colours == colour].ravel()
        assert len(np.unique(bodies)) == len(bodies)


@settings(max_examples=100, deadline=None)
@given(graphs())
def test_touching_bodies_differ_in_the_seeds_colouring(graph: tuple[IntArray, int]) -> None:
    pairs, n = graph
    contact_colours, body_colours = colour_bodies(pairs, n)
    assert np.all(body_colours[pairs[:, 0]] != body_colours[pairs[:, 1]])
    assert np.array_equal(contact_colours, body_colours[pairs].min(axis=1))
    touching = np.zeros(n, dtype=bool)
    touching[pairs] = True
    assert np.array_equal(body_colours == -1, ~touching)


@settings(max_examples=100, deadline=None)
@given(
    seed=st.integers(0, 10**6),
    count=st.integers(1, 80),
    decades=st.floats(0.0, 4.0),
    far=st.sampled_from([0.0, 1e3, 1e12]),
    stretch=st.sampled_from([1.0, 1.0 + 1e-9, 1.1]),
)
def test_grids_find_what_trees_find(seed: int, count: int, decades: float, far: float, stretch: float) -> None:
    # Radii over decades, a body far away, more contacts than the buffer has room for, and boxes so narrow that two
    # neighbours of a cell are the same one.
    rng = np.random.default_rng(seed)
    radius = 10.0 ** -rng.uniform(0.0, decades, count)
    position = rng.uniform(-4.0, 4.0, (count, 3)) * rng.choice([1.0, 0.2])
    for box in (np.zeros(3), np.array([4.0, 6.0, 20.0]) * radius.max()):
        if box[0] == 0.0:
            position[0] += far
        grid, trees = Grid(radius, box), KdTree(radius, box)
        assert np.array_equal(grid.pairs(position, stretch), trees.pairs(position, stretch))
        moved = position + rng.normal(0.0, 0.1, position.shape)
        assert np.array_equal(grid.pairs(moved, stretch), trees.pairs(moved, stretch)), "the tables are used again"


def test_a_search_with_slack_finds_what_nearly_touches() -> None:
    position, radius = np.array([[0.0, 0.0, 0.0], [2.05, 0.0, 0.0]]), np.ones(2)
    for search in (Grid(radius, np.zeros(3)), KdTree(radius, np.zeros(3))):
        assert len(search.pairs(position)) == 0
        assert len(search.pairs(position, slack=0.04)) == 0
        assert len(search.pairs(position, slack=0.06)) == 1
        assert len(search.pairs(position, stretch=1.03)) == 1


def test_normals_point_from_i_to_j_and_overlaps_are_depths() -> None:
    position = np.array([[0.0, 0.0, 0.0], [1.5, 0.0, 0.0], [0.0, 0.0, 0.0]])
    pairs = np.array([[0, 1], [0, 2]])
    normals, arms, overlaps = contact_geometry(pairs, position, np.ones(3), np.zeros(3))
    assert np.array_equal(normals, [[1, 0, 0], [1, 0, 0]]), "coincident centres get a direction that is always the same"
    assert np.array_equal(arms.sum(axis=1), [1.5, 0.0])
    assert np.array_equal(overlaps, [0.5, 2.0])


def test_in_a_periodic_box_the_nearest_image_is_touched() -> None:
    position = np.array([[-4.6, 0.0, 0.0], [4.6, 0.0, 0.0]])
    box = np.array([10.0, 10.0, 10.0])
    pairs = Grid(np.full(2, 0.5), box).pairs(position)
    normals, arms, _ = contact_geometry(pairs, position, np.full(2, 0.5), box)
    assert np.array_equal(normals, [[-1.0, 0.0, 0.0]])
    assert np.allclose(arms.sum(axis=1), 0.8, rtol=1e-15)
