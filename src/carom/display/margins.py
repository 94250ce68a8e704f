"""The margins of a view: the legend in a free corner, axes that show the scale, and the arrow of a field.

`margins` places them for a window, a picture, and a movie, in one order: the camera makes room for the legend, the
legend stands where it covers no body, and axes and arrow stand beside it. If the camera of a movie moves, legend, axes
and arrow move with it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import rerun as rr

from carom.arrays import FloatArray
from carom.display.legend_layout import BODIES, GRAPH, DrawnLabels, Legend
from carom.display.staging import axes_and_field
from carom.display.supplement import Static
from carom.recording.layout import ALL, bodies_area, bodies_eye, graph_eye, legend_area
from carom.recording.layout.camera import CameraFit
from carom.recording.layout.canvas import CORNERS, Additions, Area, CameraMotion, Canvas, View, free_corner, screen
from carom.recording.layout.drawing import single
from carom.recording.schema.header import Header
from carom.recording.write.rows import NO_STEPS, NO_TIMES, Index, Rows


@dataclass(frozen=True, slots=True)
class Margins:
    """What stands in the margins of a single view, usually the view of the bodies."""

    view: View
    area: Area
    added: Additions  # additions, with the room for the legend
    statics: Sequence[Static]
    rows: Sequence[Rows]


def margins(
    header: Header,
    camera: CameraFit,
    canvas: Canvas,
    only: str,
    added: Additions,
    words: Legend,
    field: FloatArray | None,
    drawn: FloatArray,
    radius: FloatArray,
    *,
    poses: Callable[[View], Sequence[View]] | None = None,
    times: FloatArray = NO_TIMES,
) -> Margins:
    """Place legend, axes and the arrow of a uniform ``field`` (3,) m/s².

    Things in the margins cover as little as possible of the ``drawn`` points, (k, 3) m, with radii (k,) m. In a movie
    whose camera moves, they move with its ``poses`` at some ``times`` (s).
    """
    area = bodies_area(header, canvas, only, added.close is not None)
    own = words.of(only, area) if canvas.rendered and only != ALL else replace(words, entries=[])
    added = replace(added, inset=own.size)
    area = replace(area, inset=own.size)
    view = graph_eye(header, camera, area, added) if only == GRAPH else bodies_eye(camera, area, added)
    path = () if poses is None or view.motion is CameraMotion.STILL else poses(view)
    corner, placed = None, DrawnLabels((), ())
    if own.entries:
        corner = free_corner(view, area.aspect, area.inset_share, drawn, radius) or CORNERS[0]
        placed = own.inside(view, area, corner, path)
    elif only == ALL:
        placed = words.beside(legend_area(canvas))
    statics, rows = list(placed.statics), list(placed.rows)
    has_margins = only in (ALL, BODIES, GRAPH)
    # nothing can move with the eye of a window
    if has_margins and (canvas.rendered or view.motion is CameraMotion.STILL):
        statics += axes_and_field(header.units, view, area, field, drawn, radius, corner)
        added = replace(added, axes=True)
    if path and has_margins and only != ALL:
        rows += moving(statics, view, path, times).rows
    return Margins(view, area, added, statics, rows)


def moving(drawn: Sequence[Static], view: View, poses: Sequence[View], times: FloatArray) -> DrawnLabels:
    """Return static data and rows for a camera that moves: its ``poses`` at some times (k,) s."""
    rows = list[Rows]()
    for path, archetype in drawn:
        points = getattr(archetype, "origins" if isinstance(archetype, rr.Arrows3D) else "positions")
        if points is None:
            continue
        places = np.array(points.as_arrow_array().to_pylist(), dtype=np.float64)
        moved = single(np.concatenate(list(_carried(places, view, poses))))
        if isinstance(archetype, rr.Arrows3D):
            archetype.origins, columns = None, rr.Arrows3D.columns(origins=moved)
        elif isinstance(archetype, rr.Points3D):
            archetype.positions, columns = None, rr.Points3D.columns(positions=moved)
        rows.append(Rows(path, Index(NO_STEPS, times), columns.partition([len(places)] * len(poses))))
    return DrawnLabels(drawn, rows)


def _carried(places: FloatArray, view: View, poses: Iterable[View]) -> Iterator[FloatArray]:
    """Yield, for each pose, the points (k, 3) m that appear on the screen where ``places`` do in a view."""
    onto = (places - view.target) @ screen(view.to_eye, view.up).T
    for pose in poses:
        yield np.asarray(pose.target + onto @ screen(pose.to_eye, pose.up))
