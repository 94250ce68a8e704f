"""The arrows of few bodies at a moment: the arrows that are drawn, their ends, and their numbers, moved apart."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
import pyarrow as pa
import rerun as rr

from carom.arrays import FloatArray
from carom.display.legend_layout import GRAPH
from carom.display.letters import apart, beyond
from carom.display.margins import Margins
from carom.display.request import ShownStep
from carom.recording.layout import ALL, graph_area, graph_eye, has_graph
from carom.recording.layout.camera import FEW, CameraFit
from carom.recording.layout.canvas import Canvas
from carom.recording.layout.drawing import REACH, single
from carom.recording.schema import paths
from carom.recording.schema.header import Header
from carom.recording.write.encoder import BatchEncoder
from carom.recording.write.rows import NO_STEPS, Rows, vector_column


def drawn_arrows(
    header: Header,
    origin: FloatArray,
    shown: ShownStep,
    references: Mapping[str, float],
    hidden: Sequence[str],
) -> Sequence[Rows]:
    """Return the rows of few bodies' arrows at a step or an instant; nothing if the step is not known."""
    frame, state = shown.frame, shown.state
    if frame is None or header.bodies > FEW:
        return ()
    encoder = BatchEncoder(header, origin, references, everything=True)
    found = encoder.rows([frame]) if state is None else encoder.at_impacts([state])
    return [rows for rows in found if rows.path in REACH and rows.path not in hidden]


def arrow_tips(arrows: Sequence[Rows]) -> FloatArray | None:
    """Return the ends (k, 3) m of arrows, and the places of the numbers beside them; None without arrows."""
    if not arrows:
        return None
    tips = [_vectors(rows, "Arrows3D:origins") + _vectors(rows, "Arrows3D:vectors") for rows in arrows]
    found = np.concatenate([*tips, *(_vectors(rows, paths.NUMBERS_AT) for rows in arrows)])
    return np.asarray(found[np.isfinite(found).all(axis=1)])


def _values(rows: Rows, component: str) -> pa.Array:
    """Return the values of a component in all rows; none if the rows lack it."""
    columns = (column for column in rows.columns if str(column.component_descriptor()) == component)
    return next((column.as_arrow_array().flatten() for column in columns), pa.array([]))


def _vectors(rows: Rows, component: str) -> FloatArray:
    """Return the vectors (k, 3) of a component."""
    values = _values(rows, component)
    return np.asarray(values.flatten().to_numpy() if len(values) else np.zeros(0), dtype=np.float64).reshape(-1, 3)


def numbers_apart(
    header: Header, camera: CameraFit, canvas: Canvas, only: str, placed: Margins, arrows: Sequence[Rows]
) -> Iterator[Rows]:
    """Move the numbers beside the arrows of a moment apart, and into the view of the contacts."""
    if only not in (ALL, GRAPH) or not has_graph(header):
        return
    area = placed.area if only == GRAPH else graph_area(header, canvas, placed.added.close is not None)
    view = placed.view if only == GRAPH else graph_eye(header, camera, area, placed.added)
    numbered = [rows for rows in arrows if rows.path in paths.PARALLEL and len(_values(rows, paths.NUMBERS))]
    if not numbered:
        return
    places = np.concatenate([_vectors(rows, paths.NUMBERS_AT) for rows in numbered])
    texts = [text for rows in numbered for text in _values(rows, paths.NUMBERS).to_pylist()]
    seen = np.flatnonzero(np.array([bool(text) for text in texts]) & np.isfinite(places).all(axis=1))
    ways = np.concatenate([_vectors(rows, "Arrows3D:vectors") for rows in numbered])
    if len(ways) == len(places):
        places[seen] = beyond(places[seen], ways[seen], [texts[k] for k in seen], view, area)
    places[seen] = apart(places[seen], [texts[k] for k in seen], view, area)
    ends = np.cumsum([len(_values(rows, paths.NUMBERS)) for rows in numbered])
    for rows, moved in zip(numbered, np.split(places, ends[:-1]), strict=True):
        column = vector_column(rr.ComponentDescriptor(paths.NUMBERS_AT), single(moved), len(moved))
        yield Rows(rows.path, rows.index._replace(impacts=NO_STEPS), [column])
