"""The layout that a recording opens with: 3D views, plots, phases, events and the scene's text. Each has its file."""

from __future__ import annotations

import rerun.blueprint as rrb

from carom.recording.schema import paths
from carom.recording.schema.header import Header
from carom.recording.schema.timelines import SIM_TIME
from carom.recording.view.bodies_view import bodies_view
from carom.recording.view.camera import CameraFit
from carom.recording.view.canvas import Canvas
from carom.recording.view.graph_view import graph_view, has_graph
from carom.recording.view.plot_views import plot_views, whole_time

WINDOW = Canvas()

_ROWS = (5.0, 2.4, 1.7)  # heights of the 3D views, the plots and the texts


def blueprint(header: Header, camera: CameraFit, canvas: Canvas = WINDOW) -> rrb.Blueprint:
    """Lay out a recording of this scene, with the camera where it fits."""
    shares = _shares(header)
    return rrb.Blueprint(
        rrb.Vertical(
            rrb.Horizontal(*_spatial(header, camera, canvas, shares), column_shares=shares),
            rrb.Horizontal(*plot_views(header)),
            rrb.Horizontal(_texts(), _states(), column_shares=[3, 2]),
            row_shares=list(_ROWS),
        ),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        # without a play state the viewer starts playing
        rrb.TimePanel(state="collapsed", timeline=SIM_TIME, play_state="paused"),
        auto_views=False,
        auto_layout=False,
    )


def _shares(header: Header) -> list[float]:
    return [3, 2] if has_graph(header) else [1]


def _spatial(header: Header, camera: CameraFit, canvas: Canvas, shares: list[float]) -> list[rrb.View]:
    down = _ROWS[0] / sum(_ROWS)
    areas = [canvas.area(share / sum(shares), down) for share in shares]
    views: list[rrb.View] = [bodies_view(header, camera, areas[0])]
    if has_graph(header):
        views.append(graph_view(header, camera, areas[1]))
    return views


def _texts() -> rrb.Container:
    return rrb.Tabs(
        rrb.TextLogView(name="Events", origin=paths.EVENTS, columns=_event_columns()),
        rrb.TextDocumentView(name="Scene", origin=paths.SCENE, contents=[paths.SCENE]),
        rrb.TextDocumentView(name="Scene file", origin=paths.SCENE_TOML),
    )


def _event_columns() -> rrb.TextLogColumns:
    """Leave out the entity path: there is only one."""
    return rrb.TextLogColumns(text_log_columns=["LogLevel", "Body"])


def _states() -> rrb.View:
    return rrb.StateTimelineView(
        name="Phase, and what limits dt",
        origin="/",
        contents=[paths.PHASE, paths.DT_LIMIT],
        time_view=whole_time(),
    )
