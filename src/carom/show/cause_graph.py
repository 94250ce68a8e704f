"""The graph of an answer: bodies in rows, from the first cause down to the bodies in question, connected by impulses.

Rerun's own graphs (0.41) have edges without widths, colours or labels, and their labels overlap. This one consists of
lines and points in a 2D view, whose units are points of the screen in a window of the usual size. A label is centred
below its point.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from carom.arrays import FloatArray
from carom.recording.layout.canvas import Area
from carom.recording.schema import palette
from carom.show.supplement import Static

GRAPH = "graph"
_EDGES, _ASKED, _LABELS = (f"{GRAPH}/{name}" for name in ("edges", "asked", "impulses"))
MOST_NODES = 12  # limit of the space

_NODE = 8.0  # points, radius
_WIDEST = 4.0  # points, radius of the line of a large impulse
_HEIGHT, _LETTER, _BORDER = 26.0, 7.0, 12.0  # points, of a label: height, mean width of a letter, both borders
_GAP, _WIDE = 24.0, 180.0  # points: smallest gap between neighbouring labels; usual distance of neighbours
_ALONG = (0.5, 0.38, 0.62, 0.28, 0.72)  # positions of a label along its edge, in the order in which they are tried


@dataclass(frozen=True, slots=True)
class GraphEdge:
    """An edge between two nodes, given by their indices."""

    i: int
    j: int
    text: str
    colour: int  # 0xRRGGBBAA
    width: float  # of the widest


@dataclass(frozen=True, slots=True)
class Box:
    """A label or a node on the screen (points)."""

    x: float  # of its middle
    y: float
    width: float
    height: float

    @classmethod
    def below(cls, x: float, y: float, text: str) -> Box:
        """Return the box of a label below a point."""
        return cls(x, y + _HEIGHT / 2, _LETTER * len(text) + _BORDER, _HEIGHT)

    def overlaps(self, other: Box) -> bool:
        """Return whether two boxes share an area."""
        across, down = abs(self.x - other.x), abs(self.y - other.y)
        return across < (self.width + other.width) / 2 and down < (self.height + other.height) / 2


@dataclass(frozen=True, slots=True)
class CauseGraph:
    """The nodes and edges, with the edges of the largest shares first.

    Attributes
    ----------
    names, colours
        Of the nodes.
    asked
        Number of the leading nodes that are in question.
    """

    names: Sequence[str]
    colours: Sequence[int]
    asked: int
    edges: Sequence[GraphEdge]
    area: Area
    heading: str = "Impulses"  # the quantity in the labels of edges, with its unit

    def view(self) -> rrb.Spatial2DView:
        """Lay out the graph."""
        return rrb.Spatial2DView(
            name=f"{self.heading}: wide and bright is large",
            origin=GRAPH,
            background=rrb.Background(color=palette.BACKGROUND, kind=rrb.BackgroundKind.SolidColor),
            visual_bounds=rrb.VisualBounds2D(x_range=[0.0, self.area.width], y_range=[0.0, self.area.height]),
        )

    def statics(self) -> Iterator[Static]:
        """Yield nodes, edges and labels."""
        place = self.places()
        if self.edges:
            strips = [place[[edge.i, edge.j]] for edge in self.edges]
            colours = np.array([edge.colour for edge in self.edges], dtype=np.uint32)
            radii = [max(0.5, _WIDEST * edge.width) for edge in self.edges]
            yield _EDGES, rr.LineStrips2D(strips, colors=colours, radii=radii)
            labels = self.labels(place)
            yield (
                _LABELS,
                rr.Points2D(
                    [(box.x, box.y - _HEIGHT / 2) for box in labels.values()],
                    radii=1e-3,
                    colors=palette.WHITE,
                    labels=[self.edges[number].text for number in labels],
                    show_labels=True,
                ),
            )
        around = np.linspace(0.0, 2.0 * np.pi, 33)
        ring = (_NODE + 3.0) * np.stack([np.cos(around), np.sin(around)], axis=1)
        yield _ASKED, rr.LineStrips2D(list(place[: self.asked, None] + ring), radii=1.0, colors=palette.WHITE)
        colours = np.array(self.colours, dtype=np.uint32)
        yield GRAPH, rr.Points2D(place, radii=_NODE, colors=colours, labels=list(self.names), show_labels=True)

    def places(self) -> FloatArray:
        """Return the positions of the nodes, (k, 2): in rows, by their distance in edges from the nodes in question."""
        column = max(Box.below(0.0, 0.0, name).width for name in self.names) + _GAP
        most = max(1, int(self.area.width / column - 0.5))
        rows = [step[k : k + most] for step in self._steps() for k in range(0, len(step), most)]
        column = max(column, min(_WIDE, self.area.width / (max(map(len, rows)) + 0.5)))
        top = 3 * _NODE
        pitch = (self.area.height - top - 2 * _NODE - _HEIGHT) / max(1, len(rows) - 1)
        place = np.zeros((len(self.names), 2))
        for number, row in enumerate(rows):
            shift = 0.25 * column * (-1) ** number if len(rows) > 1 else 0.0  # so that no edge crosses a label
            x = self.area.width / 2 + shift + column * (np.arange(len(row)) - (len(row) - 1) / 2)
            place[row, 0] = x
            place[row, 1] = top + pitch * (len(rows) - 1 - number if len(rows) > 1 else 0.5)
        return place

    def _steps(self) -> Iterator[list[int]]:
        """Yield the nodes at each distance from those in question; nodes without a path to them come last."""
        left, step = set(range(self.asked, len(self.names))), list(range(self.asked))
        while step:
            yield step
            ends = {(edge.i, edge.j) for edge in self.edges} | {(edge.j, edge.i) for edge in self.edges}
            step = sorted(node for node in left if any((known, node) in ends for known in step))
            left.difference_update(step)
        if left:
            yield sorted(left)

    def labels(self, place: FloatArray) -> Mapping[int, Box]:
        """Return the boxes of the labels of edges; an edge whose label would overlap another has none."""
        taken = [Box(x, y, 2 * _NODE, 2 * _NODE) for x, y in place.tolist()]
        taken += self.names_on_screen(place)
        found: dict[int, Box] = {}
        for number, edge in enumerate(self.edges):
            for along in _ALONG:
                x, y = (1.0 - along) * place[edge.i] + along * place[edge.j]
                box = Box.below(float(x), float(y) - _HEIGHT / 2, edge.text)
                if not any(box.overlaps(other) for other in taken):
                    found[number] = box
                    taken.append(box)
                    break
        return found

    def names_on_screen(self, place: FloatArray) -> list[Box]:
        """Return the boxes of the names of nodes."""
        return [Box.below(x, y + _NODE, name) for (x, y), name in zip(place.tolist(), self.names, strict=True)]
