"""Drawn data: positions, arrows and edges in float32, as documented for recordings."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from carom.contact_table import CONTACT_ROW
from carom.recording.schema import palette
from carom.recording.write import encoding_kernels as encoding

FloatArray = NDArray[np.float64]
SingleArray = NDArray[np.float32]


def arrow_vectors(
    magnitude: NDArray[np.float64], radius: NDArray[np.float64], unit: float, l_max: float
) -> SingleArray:
    n = len(magnitude)
    torque = magnitude[:, None] * np.array([0.0, 0.6, 0.8])
    body, found = np.empty(n, dtype=np.uint32), np.empty(n)
    each = np.zeros(1, dtype=np.int64)
    torques = encoding.TorqueList(torque[None], each, body, found)
    assert encoding.list_torques(torques) == n
    arrows = encoding.Arrows(*np.empty((2, n, 3), dtype=np.float32))
    points = np.zeros((1, n, 3), dtype=np.float32)
    encoding.draw_arrows(torques, points, radius, np.full(n, unit), l_max, arrows)
    return arrows.vector


def test_the_length_of_an_arrow_can_be_turned_back_into_the_magnitude() -> None:
    magnitude = np.logspace(-4, 4, 9)
    vector = arrow_vectors(magnitude, np.full(9, 0.5), unit=2.0, l_max=3.0)
    u = (np.linalg.norm(vector, axis=1) - 0.5) / 3.0
    # Lengths are float32: 6e-8 of them, magnified by d(ln m)/du up to 3/u(1 - u).
    np.testing.assert_allclose(2.0 * (u / (1 - u)) ** 3, magnitude, rtol=2e-4)


def test_every_arrow_sticks_out_of_its_sphere_and_none_is_longer_than_the_longest() -> None:
    radius = np.array([1.0, 2.0, 0.1, 5.0])
    vector = arrow_vectors(np.array([1e-3, 1.0, 1e3, 1e200]), radius, unit=1.0, l_max=4.0)
    sticking_out = np.linalg.norm(vector, axis=1) - radius
    assert np.all(sticking_out > 0.08 * 4.0)
    assert np.all(sticking_out <= 4.0 * 1.000001)


def test_only_torques_that_can_be_drawn_are_listed() -> None:
    torque = np.array([[0.0, 0.0, 0.0], [3e-200, 4e-200, 0.0], [np.nan, 0, 0], [np.inf, 0, 0], [3e200, 0.0, 4e200]])
    body, magnitude = np.empty(10, dtype=np.uint32), np.empty(10)
    each = np.zeros(2, dtype=np.int64)
    frames = np.stack((torque, 0.0 * torque[:1].repeat(5, axis=0)))
    assert encoding.list_torques(encoding.TorqueList(frames, each, body, magnitude)) == 2
    assert each.tolist() == [2, 0], "two in the first frame, none in the second"
    assert body[:2].tolist() == [1, 4]
    np.testing.assert_allclose(magnitude[:2], [5e-200, 5e200], rtol=1e-15)


def test_edges_go_to_the_nearest_image_in_the_colour_of_their_stage() -> None:
    points = np.array([[-4.5, 0, 0], [4.5, 0, 0]], dtype=np.float32)
    stages = np.arange(palette.SERIAL_STAGE + 2)
    pairs = np.tile([0, 1], (len(stages), 1))
    strips, colours = np.empty((len(stages), 6), dtype=np.float32), np.empty(len(stages), dtype=np.uint32)
    box = np.array([10.0, 10.0, 10.0])
    draw_edges(pairs, stages, points, box, strips, colours)
    assert strips[0].tolist() == [-4.5, 0, 0, -5.5, 0, 0]
    assert np.all(colours[1 : palette.SERIAL_STAGE] != colours[: palette.SERIAL_STAGE - 1])
    assert set(colours[palette.SERIAL_STAGE :].tolist()) == {palette.WHITE}


def test_edges_to_a_plane_end_at_the_foot_of_the_perpendicular() -> None:
    points = np.array([[0.0, 0.0, 0.75]], dtype=np.float32)
    strips, colours = np.empty((1, 6), dtype=np.float32), np.empty(1, dtype=np.uint32)
    draw_edges(np.array([[0, 1]]), np.array([0]), points, np.zeros(3), strips, colours, overlap=0.25)
    assert strips[0].tolist() == [0, 0, 0.75, 0, 0, 0]


def draw_edges(pairs: Any, stages: Any, points: Any, box: Any, strips: Any, colours: Any, overlap: float = 0.0) -> None:
    """Draw the contacts of one frame, with normals straight down where they matter."""
    down, none = np.tile([0.0, 0.0, -1.0], (len(pairs), 1)), np.empty(0, CONTACT_ROW)
    overlaps, each = np.full(len(pairs), overlap), np.array([[len(pairs), 0, 0]])
    contacts = encoding.FrameContacts(pairs, down, overlaps, np.asarray(stages), none, none, each)
    encoding.draw_edges(
        contacts, points[None], np.ones(len(points)), box, palette.STAGE_COLOURS, strips, colours, np.empty((1, 3))
    )


def test_positions_far_from_the_origin_keep_their_differences() -> None:
    position = np.array([[1e9, 0.0, 0.0], [1e9 + 0.25, 0.0, 0.0]])
    points = np.empty((1, 2, 3), dtype=np.float32)
    encoding.cast_positions(position[None], np.array([1e9, 0.0, 0.0]), points)
    assert points[0, :, 0].tolist() == [0.0, 0.25]


def test_the_deepest_overlap_of_a_frame_counts_against_the_smaller_radius() -> None:
    points, radius, none = np.zeros((3, 3, 3), dtype=np.float32), np.array([2.0, 1.0, 0.1]), np.empty(0, CONTACT_ROW)
    pairs, overlaps, stages = np.array([[0, 1], [1, 2], [0, 1]]), np.array([0.2, 0.1, 0.3]), np.zeros(3, np.int64)
    each = np.array([[2, 0, 0], [0, 0, 0], [1, 0, 0]])
    extremes, strips, colours = np.empty((3, 3)), np.empty((3, 6), np.float32), np.empty(3, np.uint32)
    contacts = encoding.FrameContacts(pairs, np.zeros((3, 3)), overlaps, stages, none, none, each)
    encoding.draw_edges(contacts, points, radius, np.zeros(3), palette.STAGE_COLOURS, strips, colours, extremes)
    assert extremes.tolist() == [[0.2, 1.0, 1.0], [0.0, 0.0, 0.0], [0.3, 0.3, 1.0]]


@pytest.mark.parametrize("count", [0, 1, 3, 5])
def test_the_strongest_rows_of_each_frame_are_picked_in_their_order_the_first_of_equal_ones(count: int) -> None:
    impulses, counts = np.array([1.0, 3.0, 2.0, 3.0, 2.0]), np.array([count, 0, 2])
    rows, total = np.zeros(9, CONTACT_ROW), int(counts.sum())
    rows["normal_impulse"] = [*impulses, 9.0, 5.0, 7.0, 6.0]
    chosen, picked = np.empty(total, dtype=np.int64), np.empty(total, CONTACT_ROW)
    encoding.pick_strongest(rows, np.array([5, 1, 3]), counts, np.empty(5), chosen, picked)
    expected = sorted(np.argsort(-impulses, kind="stable")[:count].tolist())
    assert chosen.tolist() == [*expected, 1, 2]
    assert np.array_equal(picked, rows[[*expected, 7, 8]])
