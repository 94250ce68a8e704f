"""The graph of an answer is legible: no label covers another, whatever its shape."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

from carom.display.causes import MOST_NODES, CauseGraph, GraphEdge
from carom.recording.layout.canvas import Area
from carom.recording.schema import palette

AREA = Area(640.0, 530.0)
CHAIN = [(k + 1, k) for k in range(MOST_NODES - 1)]
STAR = [(0, k) for k in range(1, MOST_NODES)]
ALL = list(combinations(range(MOST_NODES), 2))
APART = [(0, 1), (2, 3)]


def graph(pairs: list[tuple[int, int]], asked: int = 1) -> CauseGraph:
    count = 1 + max(max(pair) for pair in pairs)
    edges = [GraphEdge(i, j, "0.00123 N s", palette.ORANGE, 0.5) for i, j in pairs]
    return CauseGraph([f"boulder {k}" for k in range(count)], [palette.SKY] * count, asked, edges, AREA)


@pytest.mark.parametrize("pairs", [CHAIN, STAR, ALL, APART], ids=["chain", "star", "all", "apart"])
def test_labels_of_the_graph_do_not_overlap_and_are_inside_the_view(pairs: list[tuple[int, int]]) -> None:
    shown = graph(pairs)
    place = shown.places()
    boxes = [*shown.names_on_screen(place), *shown.labels(place).values()]
    assert not any(one.overlaps(other) for one, other in combinations(boxes, 2))
    for box in boxes:
        assert box.width / 2 <= box.x <= AREA.width - box.width / 2
        assert box.height / 2 <= box.y <= AREA.height - box.height / 2


def test_impulses_beside_each_other_are_apart_in_a_picture_of_1000_pixels() -> None:
    edges = [GraphEdge(k + 1, 0, "0.0166", palette.ORANGE, 0.5) for k in range(3)]
    shown = CauseGraph([f"ball {k}" for k in range(4)], [palette.SKY] * 4, 1, edges, AREA)
    labels = list(shown.labels(shown.places()).values())
    smaller = 1000 / 1600  # of the usual window: places move together, letters keep their size
    near = [replace(box, x=box.x * smaller, y=box.y * smaller) for box in labels]
    assert len(near) == 3 and not any(one.overlaps(other) for one, other in combinations(near, 2))


def test_what_is_asked_about_is_below_its_causes_and_every_impulse_of_a_chain_is_named() -> None:
    shown = graph(CHAIN[:6])
    place = shown.places()
    assert np.all(np.diff(place[:, 1]) < 0.0), "a cause is above its effect"
    assert shown.labels(place).keys() == set(range(6))
