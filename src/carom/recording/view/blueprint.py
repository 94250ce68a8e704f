"""The layout that a recording opens with: two 3D views, plots, phases, events and the scene's text."""

from __future__ import annotations

import rerun as rr
import rerun.blueprint as rrb
from rerun.blueprint.api import VisualizerLike
from rerun.encodings import EntityPathLike

from carom.recording.schema import palette, paths
from carom.recording.schema.header import Header
from carom.recording.schema.series import PLOTS, recorded
from carom.recording.schema.timelines import SIM_TIME
from carom.recording.view.camera import View
from carom.recording.write import encoder as entities

_GHOST = 0x8A93A630
_WIRE = 0x8A93A6FF  # bodies in the second view, behind arrows and edges


def blueprint(header: Header, view: View) -> rrb.Blueprint:
    """Lay out a recording of this scene, with the camera at this view."""
    return rrb.Blueprint(
        rrb.Vertical(
            rrb.Horizontal(*_spatial(header, view), column_shares=_shares(header)),
            rrb.Horizontal(*_plots(header)),
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
    return [3, 2] if header.collides or header.has_torque else None


def _spatial(header: Header, view: View) -> list[rrb.View]:
    bodies = rrb.Spatial3DView(
        name="Bodies and contacts",
        origin="/",
        contents=[
            paths.BODIES,
            *entities.surroundings(header),
            *([paths.CONTACTS] if header.collides else []),
        ],
        background=_background(),
        line_grid=False,
        eye_controls=_eye(view),
    )
    if not (header.collides or header.has_torque):
        return [bodies]
    graph = rrb.Spatial3DView(
        name="Collision graph, torques, angular accelerations",
        origin="/",
        contents=[
            paths.BODIES,
            *entities.surroundings(header),
            *([paths.CONTACTS] if header.collides else []),
            *([paths.TORQUE, paths.ANGULAR_ACCELERATION] if header.has_torque else []),
        ],
        background=_background(),
        line_grid=False,
        eye_controls=_eye(view),
        overrides=_faint_bodies(header),
    )
    return [bodies, graph]


def _faint_bodies(header: Header) -> dict[EntityPathLike, VisualizerLike]:
    """Bodies as thin wires, so that lines and arrows are what one sees."""
    match entities.shape(header):
        case "ellipsoids":
            thin = rr.Radius.ui_points(0.4)
            return {
                paths.BODIES: rr.Ellipsoids3D.from_fields(fill_mode="MajorWireframe", colors=_WIRE, line_radii=thin)
            }
        case "points":
            return {paths.BODIES: rr.Points3D.from_fields(radii=rr.Radius.ui_points(1.0), colors=_WIRE)}
        case _:
            return {paths.BODIES: rr.Mesh3D.from_fields(albedo_factor=_GHOST)}


def _eye(view: View) -> rrb.EyeControls3D:
    return rrb.EyeControls3D(
        position=view.eye,
        look_target=view.target,
        eye_up=[0.0, 0.0, 1.0],
        tracking_entity=paths.BODIES if view.follows else None,
    )


def _background() -> rrb.Background:
    return rrb.Background(color=palette.BACKGROUND, kind=rrb.BackgroundKind.SolidColor)


def _plots(header: Header) -> list[rrb.View | rrb.Container]:
    """Make a column of tabs of the plots that stand together; plots without a series are left out."""
    paths: dict[str | None, list[str]] = {}
    for series in recorded(header):
        paths.setdefault(series.plot, []).append(series.path)
    columns = [[_plot(name, paths[name]) for name in column if name in paths] for column in PLOTS]
    return [tabs[0] if len(tabs) == 1 else rrb.Tabs(*tabs) for tabs in columns if tabs]


def _plot(name: str, contents: list[str]) -> rrb.TimeSeriesView:
    legend = rrb.PlotLegend(rrb.Corner2D.LeftTop)
    return rrb.TimeSeriesView(name=name, origin="/", contents=contents, plot_legend=legend, axis_x=whole_time())


def whole_time() -> rrb.TimeAxis:
    """Show all of the time: by default a plot shows no more than a minute about the cursor."""
    return rrb.TimeAxis(
        view_range=rr.TimeRange(start=rr.TimeRangeBoundary.infinite(), end=rr.TimeRangeBoundary.infinite())
    )


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
