"""The layout that a recording opens with: two 3D views, plots, phases, events and the scene's text."""

from __future__ import annotations

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray
from rerun.blueprint.api import VisualizerLike
from rerun.utilities import EntityPathLike

from carom.recording import entities, palette
from carom.recording.clock import SIM_TIME
from carom.recording.header import Header

FloatArray = NDArray[np.float64]

_DIRECTION = np.array([0.75, -1.0, 0.55]) / np.linalg.norm([0.75, -1.0, 0.55])  # from the scene to the eye
_DISTANCE = 2.0  # in radii of what is shown: it then fills a view of Rerun's 55° from top to bottom
_WIRE = 0x8A93A6FF  # bodies in the second view: only a hint of where they are


def blueprint(header: Header, centre: FloatArray, size: float) -> rrb.Blueprint:
    """Lay out this scene, looking at a ball of radius ``size`` (m) about ``centre``."""
    return rrb.Blueprint(
        rrb.Vertical(
            rrb.Horizontal(*_spatial(header, centre, size), column_shares=_shares(header)),
            rrb.Horizontal(*_plots(header)),
            rrb.Horizontal(_texts(), _states(), column_shares=[3, 2]),
            row_shares=[5, 2.2, 1.8],
        ),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        # without a play state the viewer starts playing
        rrb.TimePanel(state="collapsed", timeline=SIM_TIME, play_state="paused"),
        auto_views=False,
        auto_layout=False,
    )


def _shares(header: Header) -> list[float] | None:
    return [3, 2] if header.collides or header.spins else None


def _spatial(header: Header, centre: FloatArray, size: float) -> list[rrb.View]:
    bodies = rrb.Spatial3DView(
        name="Bodies and contacts",
        origin="/",
        contents=[entities.BODIES, *([entities.CONTACTS] if header.collides else [])],
        background=_background(),
        line_grid=False,
        eye_controls=_eye(centre, size),
    )
    if not (header.collides or header.spins):
        return [bodies]
    graph = rrb.Spatial3DView(
        name="Collision graph, torques, angular accelerations",
        origin="/",
        contents=[
            entities.BODIES,
            *([entities.CONTACTS] if header.collides else []),
            *([entities.TORQUE, entities.ANGULAR_ACCELERATION] if header.spins else []),
        ],
        background=_background(),
        line_grid=False,
        eye_controls=_eye(centre, size),
        overrides=_faint_bodies(header),
    )
    return [bodies, graph]


def _faint_bodies(header: Header) -> dict[EntityPathLike, VisualizerLike]:
    """Bodies as thin wires, so that lines and arrows are what one sees."""
    if entities.shape(header) != "ellipsoids":
        return {}
    wires = rr.Ellipsoids3D.from_fields(fill_mode="MajorWireframe", colors=_WIRE, line_radii=rr.Radius.ui_points(0.4))
    return {entities.BODIES: wires}


def _eye(centre: FloatArray, size: float) -> rrb.EyeControls3D:
    position = centre + _DISTANCE * size * _DIRECTION
    return rrb.EyeControls3D(position=position, look_target=centre, eye_up=[0.0, 0.0, 1.0])


def _background() -> rrb.Background:
    return rrb.Background(color=palette.BACKGROUND, kind=rrb.BackgroundKind.SolidColor)


def _plots(header: Header) -> list[rrb.View | rrb.Container]:
    energy = [f"{entities.ENERGY}/{term}" for term in entities.energy_terms(header)]
    ledger = [f"{entities.LEDGER}/{term}" for term in entities.ledger_terms(header)]
    plots: list[rrb.View | rrb.Container] = [
        _plot("Energy (J)", energy),
        rrb.Tabs(
            _plot(
                "Ledger and integration error (J)" if ledger else "Integration error (J)",
                [*ledger, entities.INTEGRATION_ERROR],
            ),
            _plot("Error / energy scale", [entities.RELATIVE_ERROR]),
        ),
    ]
    if header.collides:
        plots.append(_plot("Contacts, colours, sweeps", [entities.STEP_CONTACTS, entities.COLOURS, entities.SWEEPS]))
        dt = _plot("dt (s)", [entities.DT])
        plots.append(rrb.Tabs(dt, _plot("Overlap / smaller radius", [entities.RELATIVE_OVERLAP])))
    else:
        plots.append(_plot("dt (s)", [entities.DT]))
    return plots


def _plot(name: str, contents: list[str]) -> rrb.TimeSeriesView:
    legend = rrb.PlotLegend(rrb.Corner2D.LeftTop)
    return rrb.TimeSeriesView(name=name, origin="/", contents=contents, plot_legend=legend)


def _texts() -> rrb.Container:
    return rrb.Tabs(
        rrb.TextLogView(name="Events", origin=entities.EVENTS),
        rrb.TextDocumentView(name="Scene", origin=entities.SCENE, contents=[entities.SCENE]),
        rrb.TextDocumentView(name="Scene file", origin=entities.SCENE_TOML),
    )


def _states() -> rrb.View:
    return rrb.StateTimelineView(
        name="Phase, and what limits dt", origin="/", contents=[entities.PHASE, entities.DT_LIMIT]
    )
