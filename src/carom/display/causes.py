"""Writes the causes of an event for the viewer: bodies, contacts as edges coloured by impulse, and a graph of both.

The bodies behind the event keep their colours; all other bodies are faded. An edge stays at the position of its last
impulse, so that it marks the place of an impact while the bodies move on.

The graph shows bodies in rows, from the first cause down to the bodies in question, connected by impulses. Rerun's own
graphs (0.41) have edges without widths, colours or labels, and their labels overlap. The graph consists of lines and
points in a 2D view. A unit of this view is a point of the screen if the window has its usual size. A label is centred
below its point.
"""

from __future__ import annotations

import uuid
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from carom.arrays import ColourArray, FloatArray, IntArray, SingleArray
from carom.display.body_colours import fixed_colours
from carom.display.overlays import begin, send_beside_bodies, send_times
from carom.display.supplement import Static
from carom.recording.layout import WINDOW, drawing
from carom.recording.layout.camera import FEW, CameraFit
from carom.recording.layout.canvas import Area, CameraMotion
from carom.recording.read.frame_rows import drawn_paths, times_of
from carom.recording.read.recorded_scene import header_of_recording
from carom.recording.read.recording import Recording
from carom.recording.schema import palette, paths
from carom.recording.write.chunk_writer import Writer
from carom.recording.write.rows import time_columns
from carom.scene.units.dimension import IMPULSE

GRAPH = "graph"
_LINES, _MARKED, _LABELS = (f"{GRAPH}/{name}" for name in ("edges", "asked", "impulses"))
MOST_NODES = 12  # largest number of nodes in the graph; more would not fit

_NODE = 8.0  # points, radius of a node
_WIDEST = 4.0  # points, radius of the line of a large impulse
_HEIGHT, _LETTER, _BORDER = 26.0, 7.0, 12.0  # points: height of a label, mean width of a letter, width of both borders
_GAP, _WIDE = 24.0, 180.0  # points: smallest gap between neighbouring labels; usual distance of neighbours
_ALONG = (0.5, 0.38, 0.62, 0.28, 0.72)  # positions of a label along its edge, in order of preference
MOST_EDGES = 200  # largest number of edges that are drawn: those with the largest shares
_CONE, _OTHERS, _ASKED, _TRAILS, _EDGES, _TEXT = (
    *(f"world/{name}" for name in ("cone", "others", "asked", "trails", "edges")),
    "why",
)
_DRAWN = (_CONE, _OTHERS, _ASKED, _TRAILS, _EDGES)
_HEADING = "Causes: white wires in question, faint without effect"
_FADED = 0x232A35FF
_SHOWN = 0.01  # smallest share of a body or an edge that is shown
_LEAST = 0.003  # smallest share of an edge that is drawn
_WIDTHS = np.linspace(0.8, 5.0, drawing.LEVELS)  # screen points, widths of edges by impulse
_HALO = 1.25  # size of the wires around the bodies in question, relative to the bodies
_SHARES = (3, 2)  # relative heights of the graph and of the text


@dataclass(frozen=True, slots=True)
class GraphEdge:
    """An edge between two nodes, given by their indices."""

    i: int
    j: int
    text: str
    colour: int  # 0xRRGGBBAA
    width: float  # width, relative to the widest edge


@dataclass(frozen=True, slots=True)
class Box:
    """A label or a node on the screen (points)."""

    x: float  # coordinate of the middle
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
    """The nodes and edges of a graph."""

    names: Sequence[str]  # names of the nodes
    colours: Sequence[int]  # colours of the nodes
    asked: int  # number of nodes in question, which come first
    edges: Sequence[GraphEdge]  # edges, the largest shares first
    area: Area
    heading: str = "Impulses"  # quantity that the labels of edges show, with its unit

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
            yield _LINES, rr.LineStrips2D(strips, colors=colours, radii=radii)
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
        yield _MARKED, rr.LineStrips2D(list(place[: self.asked, None] + ring), radii=1.0, colors=palette.WHITE)
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
            # shifts columns, so that no edge crosses a label
            shift = 0.25 * column * (-1) ** number if len(rows) > 1 else 0.0
            x = self.area.width / 2 + shift + column * (np.arange(len(row)) - (len(row) - 1) / 2)
            place[row, 0] = x
            place[row, 1] = top + pitch * (len(rows) - 1 - number if len(rows) > 1 else 0.5)
        return place

    def _steps(self) -> Iterator[list[int]]:
        """Yield the nodes by their distance from the bodies in question; nodes without a path to these come last."""
        left, step = set(range(self.asked, len(self.names))), list(range(self.asked))
        while step:
            yield step
            ends = {(edge.i, edge.j) for edge in self.edges} | {(edge.j, edge.i) for edge in self.edges}
            step = sorted(node for node in left if any((known, node) in ends for known in step))
            left.difference_update(step)
        if left:
            yield sorted(left)

    def labels(self, place: FloatArray) -> Mapping[int, Box]:
        """Return the boxes of the labels of edges; an edge whose label would overlap another label has no label."""
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


@dataclass(frozen=True, slots=True)
class CauseEdge:
    """A contact between two bodies."""

    i: int
    j: int
    first: float  # s, time of the first impulse
    share: float
    impulse: float = 0.0  # N s, sum of the magnitudes
    last: float = np.inf  # s, time of the last impulse


@dataclass(frozen=True, slots=True)
class Causes:
    """The content of the drawing."""

    title: str
    text: str  # Markdown
    begin: float  # s
    end: float  # s
    asked: Sequence[int]
    share: FloatArray  # (n,) fraction of the effect that each body causes
    edges: Sequence[CauseEdge]  # edges between bodies, the largest shares first


def write_causes(out: Path, recording: Recording, causes: Causes) -> None:
    """Write a recording for the viewer; raises RecordingError if it cannot be written."""
    radius = recording.bodies.radius
    recording.refuse_some_bodies()
    steps, times, position = _frames(recording, causes)
    ends = [end for edge in causes.edges if edge.share >= _SHOWN for end in (edge.i, edge.j)]
    large = np.flatnonzero(causes.share >= _SHOWN).tolist()
    inside = np.array(sorted({*causes.asked, *large, *ends}), dtype=np.int64)
    outside, colours = np.setdiff1d(np.arange(len(radius)), inside), fixed_colours(recording)
    camera = CameraFit(radius[inside], position[-1, inside].astype(np.float64), motion=CameraMotion.STILL)
    camera.look(position[:, inside].astype(np.float64))
    application = f"carom-{paths.SCHEMA_VERSION}-{uuid.uuid4().hex[:12]}"
    with Writer(out, application, str(uuid.uuid4())) as writer:
        clock = begin(writer, _TEXT, causes.text, recording, causes.title, {"b": "why", "verdict": causes.title})
        index = time_columns(clock, steps, times)
        faded = np.full(len(radius), _FADED, np.uint32)
        _bodies(writer, index, _CONE, recording, inside, position, colours, rr.components.FillMode.Solid)
        wires = rr.components.FillMode.MajorWireframe
        _bodies(writer, index, _OTHERS, recording, outside, position, faded, wires)
        asked = np.array(causes.asked, dtype=np.int64)
        white = np.full(len(radius), palette.WHITE, np.uint32)
        _bodies(writer, index, _ASKED, recording, asked, position, white, wires, larger=_HALO, named=True)
        if len(inside) <= FEW and header_of_recording(recording).box is None:
            strips = list(position[:, inside].transpose(1, 0, 2))
            writer.log(_TRAILS, rr.LineStrips3D(strips, colors=colours[inside], radii=rr.Radius.ui_points(0.75)))
        drawn = [edge for edge in causes.edges[:MOST_EDGES] if edge.share >= _LEAST]
        _edges(writer, index, drawn, np.array(times), position)
        graph = _graph(recording, causes, colours)
        for path, archetype in graph.statics():
            writer.log(path, archetype)
        send_times(writer, index, times)
        last = position[-1].astype(np.float64)
        send_beside_bodies(writer, _HEADING, _DRAWN, camera, _panels(graph), recording.units, last, radius)
        writer.flush()


def _frames(recording: Recording, causes: Causes) -> tuple[list[int], list[float], SingleArray]:
    """Return steps, times (s) and drawn positions (k, n, 3) of the window's frames and of the next frame."""
    drawn = drawn_paths(recording, range(len(recording.bodies.radius)))
    times = times_of(recording, drawn.steps)
    first = max(0, int(np.searchsorted(times, causes.begin, side="right")) - 1)
    last = min(len(times), int(np.searchsorted(times, causes.end)) + 1)
    return drawn.steps[first:last].tolist(), times[first:last].tolist(), drawn.position[first:last]


def _bodies(
    writer: Writer,
    index: list[rr.TimeColumn],
    path: str,
    recording: Recording,
    bodies: IntArray,
    position: SingleArray,
    colours: ColourArray,
    fill: rr.components.FillMode,
    *,
    larger: float = 1.0,
    named: bool = False,
) -> None:
    """Draw some bodies; ``colours`` are the colours of all bodies."""
    if not len(bodies):
        return
    names = [recording.bodies.name[body] or f"body {body}" for body in bodies]
    writer.log(
        path,
        rr.Ellipsoids3D.from_fields(
            half_sizes=np.repeat(larger * recording.bodies.radius[bodies].astype(np.float32), 3).reshape(-1, 3),
            colors=colours[bodies],
            fill_mode=fill,
            line_radii=rr.Radius.ui_points(0.6 if named else 0.3),
            labels=names,
            show_labels=named,
        ),
    )
    centres = position[:, bodies].reshape(-1, 3)
    each = [len(bodies)] * len(position)
    writer.send_columns(path, index, rr.Ellipsoids3D.columns(centers=centres).partition(each))


def _levels(edges: Sequence[CauseEdge]) -> IntArray:
    """Return the level of each edge's impulse, as in other views; the median impulse has the middle level."""
    impulses = np.array([edge.impulse for edge in edges])
    positive = impulses[impulses > 0.0]
    return drawing.level(impulses, float(np.median(positive)) if len(positive) else 1.0)


def _edges(
    writer: Writer, index: list[rr.TimeColumn], edges: Sequence[CauseEdge], times: FloatArray, position: SingleArray
) -> None:
    """Draw each edge from its first impulse on; after its last impulse, it stays at the position of that impulse."""
    levels = _levels(edges)
    until = np.minimum(np.searchsorted(times, [edge.last for edge in edges]), len(times) - 1)
    strips: list[SingleArray] = []
    colours: list[int] = []
    widths: list[float] = []
    each: list[int] = []
    for row, time in enumerate(times):
        drawn = [k for k, edge in enumerate(edges) if edge.first <= time]
        strips += [position[min(row, until[k]), [edges[k].i, edges[k].j]] for k in drawn]
        colours += [int(drawing.COLOURS[levels[k]]) for k in drawn]
        widths += [-float(_WIDTHS[levels[k]]) for k in drawn]  # a negative width is in points of the screen
        each.append(len(drawn))
    shades = np.array(colours, dtype=np.uint32)  # an array, since a list of three numbers could be read as one colour
    columns = rr.LineStrips3D.columns(strips=strips, colors=shades, radii=widths)
    writer.send_columns(_EDGES, index, columns.partition(each))


def _graph(recording: Recording, causes: Causes, colours: ColourArray) -> CauseGraph:
    """Choose the bodies and edges with the largest shares for the graph."""
    nodes, edges = list(causes.asked), []
    for edge in causes.edges:
        new = [end for end in (edge.i, edge.j) if end not in nodes]
        if len(nodes) + len(new) <= MOST_NODES and edge.share > 0.0:
            nodes += new
            edges.append(edge)
    levels = _levels(edges)
    return CauseGraph(
        names=[recording.bodies.name[node] or f"body {node}" for node in nodes],
        colours=colours[nodes].tolist(),
        asked=len(causes.asked),
        edges=[
            GraphEdge(
                nodes.index(edge.i),
                nodes.index(edge.j),
                f"{recording.units.shown(edge.impulse, IMPULSE):.3g}",
                int(drawing.COLOURS[level]),
                float(_WIDTHS[level] / _WIDTHS[-1]),
            )
            for edge, level in zip(edges, levels, strict=True)
        ],
        area=WINDOW.area(2 / 5, _SHARES[0] / sum(_SHARES)),
        heading=recording.units.labelled("Impulses", IMPULSE),
    )


def _panels(graph: CauseGraph) -> rrb.Vertical:
    text = rrb.TextDocumentView(name="Why", origin=_TEXT)
    return rrb.Vertical(graph.view(), text, row_shares=list(_SHARES))
