"""Writes the bodies and contacts behind an answer for the viewer: edges by share, all else faded, and a graph."""

from __future__ import annotations

import uuid
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

from carom.arrays import FloatArray, IntArray, SingleArray
from carom.recording.layout.camera import CameraFit, CameraMotion, View
from carom.recording.read.frame_rows import drawn_paths
from carom.recording.read.recording import Recording
from carom.recording.schema import palette, paths
from carom.recording.schema.paths import STEP
from carom.recording.schema.time_scale import TimeScale
from carom.recording.write.whole_file import Writer
from carom.show.overlays import beside_bodies

MOST_EDGES = 200  # that are drawn, of the largest shares
_MOST_NODES = 16  # of the graph; more are a hairball
_CONE, _OTHERS, _EDGES, _GRAPH, _TEXT = "world/cone", "world/others", "world/edges", "graph", "why"
_FADED = 0x232A35FF
_ASKED = palette.YELLOW
_SHARES = np.array([0x9AA5B8FF, 0x56B4E9FF, 0xE69F00FF, 0xD55E00FF], dtype=np.uint32)  # below 1, 5 and 20 %, and above
_LIMITS = (0.01, 0.05, 0.2)
_WIDTHS = (0.8, 1.6, 2.8, 4.5)  # pixels, of edges
_LEAST = 0.003  # share of an edge that is drawn


@dataclass(frozen=True, slots=True)
class CauseEdge:
    """A contact between two bodies."""

    i: int
    j: int
    first: float  # s
    share: float


@dataclass(frozen=True, slots=True)
class Causes:
    """What is drawn."""

    title: str
    text: str  # Markdown
    begin: float  # s
    end: float  # s
    asked: Sequence[int]
    share: FloatArray  # (n,) that each body is the cause of
    edges: Sequence[CauseEdge]  # between bodies, the largest shares first


def write_causes(out: Path, recording: Recording, causes: Causes) -> None:
    """Write a recording for the viewer. RecordingError if it cannot be written."""
    radius, clock = recording.bodies.radius, TimeScale(float(recording.info["time_scale"]))
    recording.refuse_some_bodies()
    steps, times, position = _frames(recording, causes)
    inside = _shown(causes)
    outside = np.setdiff1d(np.arange(len(radius)), inside)
    camera = CameraFit(radius[inside], position[-1, inside].astype(np.float64), motion=CameraMotion.STILL)
    camera.look(position[:, inside].astype(np.float64))
    application = f"carom-{paths.SCHEMA_VERSION}-{uuid.uuid4().hex[:12]}"
    with Writer(out, application, str(uuid.uuid4())) as writer:
        writer.log(paths.WORLD, rr.ViewCoordinates.RIGHT_HAND_Z_UP)
        writer.log(_TEXT, rr.TextDocument(causes.text, media_type=rr.MediaType.MARKDOWN))
        writer.send_property("carom", {"title": causes.title, "time_scale": clock.scale, "bodies": len(radius)})
        writer.send_property("diff", {"a": recording.path.name, "b": "why", "verdict": causes.title})
        index = clock.columns(steps, times)
        _bodies(writer, index, recording, inside, position, _colours(causes)[inside], solid=True)
        _bodies(writer, index, recording, outside, position, np.full(len(outside), _FADED, np.uint32), solid=False)
        drawn = [edge for edge in causes.edges[:MOST_EDGES] if edge.share >= _LEAST]
        _edges(writer, index, drawn, np.array(times), position)
        _graph(writer, recording, causes)
        fingerprints = pa.array([0] * len(steps), pa.uint64())
        columns = rr.AnyValues.columns(True, time=pa.array(times), fingerprint=fingerprints)
        writer.send_columns(paths.FINGERPRINT, index, columns)
        writer.send_layout(_layout(camera.view()))
        writer.flush()


def _frames(recording: Recording, causes: Causes) -> tuple[list[int], list[float], SingleArray]:
    """Return steps, times (s) and drawn positions (k, n, 3) of the frames of the window and the one after it."""
    drawn = drawn_paths(recording, range(len(recording.bodies.radius)))
    table = recording.fingerprints()
    place = np.searchsorted(table[STEP].to_numpy(), drawn.steps)
    times = table["time"].to_numpy()[np.minimum(place, table.num_rows - 1)]
    first = max(0, int(np.searchsorted(times, causes.begin, side="right")) - 1)
    last = min(len(times), int(np.searchsorted(times, causes.end)) + 1)
    return drawn.steps[first:last].tolist(), times[first:last].tolist(), drawn.position[first:last]


def _shown(causes: Causes) -> IntArray:
    """Return the bodies to draw as solids: those asked about, and those with a share of at least 1 %."""
    ends = [end for edge in causes.edges if edge.share >= _LIMITS[0] for end in (edge.i, edge.j)]
    large = np.flatnonzero(causes.share >= _LIMITS[0]).tolist()
    return np.array(sorted({*causes.asked, *large, *ends}), dtype=np.int64)


def _colours(causes: Causes) -> NDArray[np.uint32]:
    """Return colours of bodies by what they are the cause of; those asked about are yellow."""
    colours: NDArray[np.uint32] = _SHARES[np.searchsorted(_LIMITS, causes.share, side="right")].copy()
    colours[list(causes.asked)] = _ASKED
    return colours


def _bodies(
    writer: Writer,
    index: list[rr.TimeColumn],
    recording: Recording,
    bodies: IntArray,
    position: SingleArray,
    colours: NDArray[np.uint32],
    *,
    solid: bool,
) -> None:
    if not len(bodies):
        return
    path = _CONE if solid else _OTHERS
    fill = rr.components.FillMode.Solid if solid else rr.components.FillMode.MajorWireframe
    names = [recording.bodies.name[body] for body in bodies]
    writer.log(
        path,
        rr.Ellipsoids3D.from_fields(
            half_sizes=np.repeat(recording.bodies.radius[bodies].astype(np.float32), 3).reshape(-1, 3),
            colors=colours,
            fill_mode=fill,
            line_radii=rr.Radius.ui_points(0.3),
            labels=names,
            show_labels=False,
        ),
    )
    centres = position[:, bodies].reshape(-1, 3)
    each = [len(bodies)] * len(position)
    writer.send_columns(path, index, rr.Ellipsoids3D.columns(centers=centres).partition(each))


def _edges(
    writer: Writer,
    index: list[rr.TimeColumn],
    edges: Sequence[CauseEdge],
    times: FloatArray,
    position: SingleArray,
) -> None:
    """Draw each edge from its first impulse on."""
    strips: list[SingleArray] = []
    colours: list[int] = []
    widths: list[float] = []
    each: list[int] = []
    rank = [int(np.searchsorted(_LIMITS, edge.share, side="right")) for edge in edges]
    for row, time in enumerate(times):
        drawn = [k for k, edge in enumerate(edges) if edge.first <= time]
        strips += [position[row, [edges[k].i, edges[k].j]] for k in drawn]
        colours += [int(_SHARES[rank[k]]) for k in drawn]
        widths += [-_WIDTHS[rank[k]] for k in drawn]  # negative: pixels
        each.append(len(drawn))
    shades = np.array(colours, dtype=np.uint32)  # a list of three numbers may be one colour
    columns = rr.LineStrips3D.columns(strips=strips, colors=shades, radii=widths)
    writer.send_columns(_EDGES, index, columns.partition(each))


def _graph(writer: Writer, recording: Recording, causes: Causes) -> None:
    """Draw the bodies of the largest shares as a graph."""
    nodes, edges = list(causes.asked), []
    for edge in causes.edges:
        new = [end for end in (edge.i, edge.j) if end not in nodes]
        if len(nodes) + len(new) <= _MOST_NODES and edge.share > 0.0:
            nodes += new
            edges.append((str(edge.i), str(edge.j)))
    colours = _colours(causes)
    labels = [recording.bodies.name[node] or f"body {node}" for node in nodes]
    writer.log(
        _GRAPH,
        rr.GraphNodes([str(node) for node in nodes], labels=labels, colors=colours[nodes], radii=[6.0] * len(nodes)),
    )
    if edges:
        writer.log(_GRAPH, rr.GraphEdges(edges, graph_type="undirected"))


def _layout(view: View) -> rrb.Blueprint:
    panels = rrb.Vertical(
        rrb.GraphView(name="Impulses between bodies", origin=_GRAPH),
        rrb.TextDocumentView(name="Why", origin=_TEXT),
        row_shares=[1, 1],
    )
    title = "Causes: yellow is asked about, red to blue by share"
    return beside_bodies(title, [_CONE, _OTHERS, _EDGES], view, panels)
