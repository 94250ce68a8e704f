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
from carom.physics.contact.search import contact_geometry, find_pairs
from examples import random_bodies

IntArray = NDArray[np.int64]


@st.composite
def graphs(draw: st.DrawFn) -> tuple[IntArray, int]:
    n = draw(st.integers(2, 40))
    i, j = np.triu_indices(n, 1)
    chosen = np.array(draw(st.lists(st.booleans(), min_size=len(i), max_size=len(i))))
    return np.column_stack((i[chosen], j[chosen])).astype(np.int64), n


@settings(max_examples=100, deadline=None)
@given(graphs())
def test_no_two_contacts_of_a_colour_share_a_body(graph: tuple[IntArray, int]) -> None:
    pairs, n = graph
    colours = colour_contacts(pairs, n)
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
    pairs = find_pairs(hexagonal, np.ones(216), np.zeros(3), broad_phase=True)
    assert np.bincount(pairs.ravel()).max() == 12
    assert colour_contacts(pairs, 216).max() < 23


def test_a_hub_past_64_colours_overflows_into_a_last_stage() -> None:
    pairs = np.column_stack((np.zeros(100, dtype=np.int64), np.arange(1, 101)))
    colours = colour_contacts(pairs, 101)
    assert np.array_equal(colours[:64], np.arange(64))
    assert np.all(colours[64:] == OVERFLOW)


def test_stages_follow_each_other_and_keep_the_order_of_pairs() -> None:
    colours = np.array([2, 0, 1, 0, 2])
    assert list(stage_order(colours)) == [1, 3, 2, 0, 4]


@settings(max_examples=50, deadline=None)
@given(seed=st.integers(0, 10**6), count=st.integers(2, 60))
def test_every_pair_tested_finds_what_the_trees_find(seed: int, count: int) -> None:
    bodies = random_bodies(count, seed)
    for box in (np.zeros(3), np.array([5.0, 6.0, 7.0])):
        trees = find_pairs(bodies.position, bodies.radius, box, broad_phase=True)
        assert np.array_equal(find_pairs(bodies.position, bodies.radius, box, broad_phase=False), trees)


def test_normals_point_from_i_to_j_and_overlaps_are_depths() -> None:
    position = np.array([[0.0, 0.0, 0.0], [1.5, 0.0, 0.0], [0.0, 0.0, 0.0]])
    pairs = np.array([[0, 1], [0, 2]])
    normals, distances, overlaps = contact_geometry(pairs, position, np.ones(3), np.zeros(3))
    assert np.array_equal(normals, [[1, 0, 0], [1, 0, 0]]), "coincident centres get a direction that is always the same"
    assert np.array_equal(distances, [1.5, 0.0])
    assert np.array_equal(overlaps, [0.5, 2.0])


def test_in_a_periodic_box_the_nearest_image_is_touched() -> None:
    position = np.array([[-4.6, 0.0, 0.0], [4.6, 0.0, 0.0]])
    box = np.array([10.0, 10.0, 10.0])
    pairs = find_pairs(position, np.full(2, 0.5), box, broad_phase=False)
    normals, distances, _ = contact_geometry(pairs, position, np.full(2, 0.5), box)
    assert np.array_equal(normals, [[-1.0, 0.0, 0.0]])
    assert np.allclose(distances, 0.8, rtol=1e-15)
