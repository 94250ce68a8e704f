"""The layout that a recording opens with: 3D views, plots, phases, events and the scene's text."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Literal

import rerun.blueprint as rrb

from carom.errors import RecordingError
from carom.recording.layout.bodies_view import bodies_view, graph_view, has_graph
from carom.recording.layout.camera import CameraFit
from carom.recording.layout.canvas import NONE, Additions, Area, Canvas
from carom.recording.layout.plot_views import Curves, energy_view, plot_views, time_axis
from carom.recording.schema import paths
from carom.recording.schema.header import Header
from carom.recording.schema.paths import SIM_TIME

if TYPE_CHECKING:
    from carom.show.body_plots import BodyPlots

WINDOW = Canvas()
ALL = "all"
PLOT = "plot"
CLOSE_UP = "close-up"

_ROWS = (5.0, 2.4, 1.7)  # heights of the 3D views, the plots and the texts


def blueprint(
    header: Header,
    camera: CameraFit,
    curves: Curves | None = None,
    canvas: Canvas = WINDOW,
    only: str = ALL,
    added: Additions = NONE,
) -> rrb.Blueprint:
    """Lay out a recording of this scene, with the camera fitted if possible.

    Parameters
    ----------
    header
        The recording's header.
    camera
        The camera, fitted to the bodies.
    curves
        The recorded series; None during the run.
    canvas
        The window that the layout is for.
    only
        The view that fills the window: "bodies", "graph", "close-up", "energy", "plot", or `ALL`.
    added
        Parts that are not in the file.

    Raises
    ------
    RecordingError
        If the recording has nothing to show in the view.
    """
    header = as_happened(header, curves)
    parts = header, camera, curves, canvas, added
    if only == PLOT:
        root: rrb.View | rrb.Container = _plot(added.plots, canvas)
    else:
        root = _all(*parts) if only == ALL else _single(*parts, only)
    panel: Literal["collapsed", "hidden"] = "collapsed" if canvas.framed else "hidden"
    return rrb.Blueprint(
        root,
        rrb.TopPanel(state="expanded" if canvas.framed else "hidden"),
        rrb.BlueprintPanel(state=panel),
        rrb.SelectionPanel(state=panel),
        # without a play state the viewer starts playing
        rrb.TimePanel(state=panel, timeline=SIM_TIME, play_state="paused"),
        auto_views=False,
        auto_layout=False,
    )


_TOUCHES = ("step/contacts", "step/impact_rate")


def as_happened(header: Header, curves: Curves | None) -> Header:
    """Return the header of a layout: without contacts and torques if the curves show that no bodies touched."""
    if not header.collides or curves is None or any(path not in curves for path in _TOUCHES):
        return header
    if any(curves[path].largest > 0.0 for path in _TOUCHES):
        return header
    return replace(header, collides=False, has_torque=False, has_friction=False)


def close_up_area(header: Header, canvas: Canvas, only: str) -> Area:
    """Return the area of the close-up view in a layout."""
    return _areas(canvas, _shares(header, True, True))[-2] if only == ALL else canvas.area()


def bodies_area(header: Header, canvas: Canvas, only: str, close: bool) -> Area:
    """Return the area of the view of the bodies in a layout with a legend."""
    return _areas(canvas, _shares(header, close, True))[0] if only == ALL else canvas.area()


def legend_area(header: Header, canvas: Canvas, close: bool) -> Area:
    """Return the area of the legend in a layout of all views."""
    return _areas(canvas, _shares(header, close, True))[-1]


def _shares(header: Header, close: bool, legend: bool) -> list[float]:
    """Return the widths of the 3D views and of the legend."""
    return [3.0, *([2.2] if has_graph(header) else []), *([2.0] if close else []), *([1.7] if legend else [])]


def _areas(canvas: Canvas, shares: list[float]) -> list[Area]:
    return [canvas.area(share / sum(shares), _ROWS[0] / sum(_ROWS)) for share in shares]


def _all(header: Header, camera: CameraFit, curves: Curves | None, canvas: Canvas, added: Additions) -> rrb.Container:
    shares = _shares(header, added.close is not None, added.legend is not None)
    areas = _areas(canvas, shares)
    views: list[rrb.View] = [bodies_view(header, camera, areas[0], added)]
    if has_graph(header):
        views.append(graph_view(header, camera, areas[1], added))
    if added.close:
        views.append(added.close.view(header, added.recoloured))
    if added.legend:
        views.append(added.legend.view(areas[-1]))
    heights = list(_ROWS)
    if added.plots is not None:
        heights.insert(1, _ROWS[1])
    plots = canvas.area(1.0, _ROWS[1] / sum(heights))
    return rrb.Vertical(
        rrb.Horizontal(*views, column_shares=shares),
        *([] if added.plots is None else [rrb.Horizontal(*added.plots.views(plots))]),
        rrb.Horizontal(*plot_views(header, curves, plots, added)),
        rrb.Horizontal(_texts(added), _states(canvas, added), column_shares=[3, 2]),
        row_shares=heights,
    )


def _plot(bodies: BodyPlots | None, canvas: Canvas) -> rrb.View:
    """Lay out the plot of single bodies alone; all have the same unit."""
    if bodies is None:
        raise RecordingError("there are no bodies to plot")
    return bodies.view(bodies.units[0], canvas.area())


def _single(
    header: Header, camera: CameraFit, curves: Curves | None, canvas: Canvas, added: Additions, only: str
) -> rrb.View:
    match only:
        case "bodies":
            return bodies_view(header, camera, replace(canvas.area(), inset=added.inset), added)
        case "graph" if has_graph(header):
            return graph_view(header, camera, replace(canvas.area(), inset=added.inset), added)
        case "graph":
            raise RecordingError(
                "there is no collision graph, since bodies neither touch nor have torques; use the view of bodies"
            )
        case "close-up" if added.close:
            return added.close.view(header, added.recoloured)
        case "close-up":
            raise RecordingError("there is no known impact for a close-up; name two bodies")
        case _:
            return energy_view(header, curves, canvas.area(), added.span)


def _texts(added: Additions) -> rrb.Container:
    name = f"Events ({added.viewer_time})" if added.viewer_time else "Events"
    return rrb.Tabs(
        rrb.TextLogView(name=name, origin=paths.EVENTS, columns=_event_columns()),
        rrb.TextDocumentView(name="Scene", origin=paths.SCENE, contents=[paths.SCENE]),
        rrb.TextDocumentView(name="Scene file", origin=paths.SCENE_TOML),
    )


def _event_columns() -> rrb.TextLogColumns:
    """Omit the column of the entity path, which is the same in each row."""
    return rrb.TextLogColumns(text_log_columns=["LogLevel", "Body"])


def _states(canvas: Canvas, added: Additions) -> rrb.View:
    """Lay out the strips of events: impacts, if they are few enough, phases and limits."""
    return rrb.StateTimelineView(
        name="Impacts, phase, and what limits dt" if added.struck else "Phase, and what limits dt",
        origin="/",
        contents=[*([paths.IMPACTS] if added.struck else []), paths.PHASE, paths.DT_LIMIT],
        time_view=time_axis(canvas.area(2.0 / 5.0), added.span),
    )
