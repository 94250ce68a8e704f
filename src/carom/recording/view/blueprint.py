"""The layout that a recording opens with: 3D views, plots, phases, events and the scene's text. Each has its file."""

from __future__ import annotations

import rerun.blueprint as rrb

from carom.recording.schema import paths
from carom.recording.schema.header import Header
from carom.recording.schema.timelines import SIM_TIME
from carom.recording.view.bodies_view import bodies_view
from carom.recording.view.camera import View
from carom.recording.view.graph_view import graph_view, has_graph
from carom.recording.view.plot_views import plot_views, whole_time


def blueprint(header: Header, view: View) -> rrb.Blueprint:
    """Lay out a recording of this scene, with the camera at this view."""
    return rrb.Blueprint(
        rrb.Vertical(
            rrb.Horizontal(*_spatial(header, view), column_shares=_shares(header)),
            rrb.Horizontal(*plot_views(header)),
            rrb.Horizontal(_texts(), _states(), column_shares=[3, 2]),
            row_shares=[5, 2.4, 1.7],
        ),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        # without a play state the viewer starts playing
        rrb.TimePanel(state="collapsed", timeline=SIM_TIME, play_state="paused"),
        auto_views=False,
        auto_layout=False,
    )


def _shares(header: Header) -> list[float] | None:
    return [3, 2] if has_graph(header) else None


def _spatial(header: Header, view: View) -> list[rrb.View]:
    return [bodies_view(header, view), *([graph_view(header, view)] if has_graph(header) else [])]


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
