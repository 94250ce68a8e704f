"""The layout that a recording opens with: 3D views, plots, phases, events and the scene's text."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from rerun.blueprint.api import VisualizerLike
from rerun.encodings import EntityPathLike

from carom.arrays import SingleArray
from carom.errors import RecordingError
from carom.recording.layout.camera import FEW, CameraFit
from carom.recording.layout.canvas import (
    LEGEND,
    NONE,
    Additions,
    Area,
    Canvas,
    View,
    spatial_view,
    surroundings,
    taken_from,
)
from carom.recording.layout.drawing import arrow_length, shape, single
from carom.recording.layout.plot_views import energy_view, plot_views, time_axis
from carom.recording.schema import palette, paths
from carom.recording.schema.curve_outline import Curves
from carom.recording.schema.header import Header, TimeScale
from carom.recording.timelines import SIM_TIME, STEP

OF_LATE = 1 / 300  # fraction of the duration for which an impact stays visible


def turning_arrows(header: Header) -> list[str]:
    """Return the entities of the arrows that show what turns bodies."""
    of_impacts = paths.OF_IMPACTS if header.records_contacts else ()
    return [*paths.OF_LASTING, *of_impacts] if header.has_torque else []


def hidden_arrows(header: Header, added: Additions) -> list[str]:
    """Return the entities of the arrows that a view hides, since other arrows have the same directions."""
    return [] if added.both_arrows else [path for path in paths.PARALLEL.values() if path in turning_arrows(header)]


def force_arrows(header: Header) -> list[str]:
    """Return the entities of the impulse arrows in a recording."""
    if not header.records_contacts:
        return []
    return [paths.FORCE_NORMAL, *([paths.FORCE_FRICTION] if header.has_friction else [])]


def _edges(header: Header, theme: str, *, wide: bool, by_stage: bool = False) -> Overrides:
    """Draw the edges of the collision graph as force chains: their colours and widths depend on the impulse.

    The recorded colours show the solver's stages. On white paper, bright colours would be invisible, so edges have one
    colour, and only the width shows the impulse.
    """
    if not header.collides or (theme == "dark" and (by_stage or not header.records_contacts)):
        return {}
    sources, colour = dict[str, str](), palette.VERMILION if theme == "light" else None
    if header.records_contacts:
        if wide:
            sources["LineStrips3D:radii"] = "impulse_width"
        if colour is None:
            sources["LineStrips3D:colors"] = "impulse_colour"
    return {paths.CONTACTS: rr.LineStrips3D.from_fields(colors=colour).visualizer(mappings=taken_from(sources))}


TRAILS = "trails"
FIELD = "field"  # entity of the arrow of a uniform field, and of axes


# Overrides with which a view draws bodies: colours other than the recorded colours, and a minimum size on the screen.
# Spheres have their true radii in metres. For bodies smaller than two points of the screen, the view also draws a dot
# of fixed size at the recorded centre, so the file does not grow.

LEAST = 2.0  # points of the screen, radius of a dot
_MOST_NAMED = 7  # largest number of bodies whose names the layout in a file shows: the number of hues
_HIDDEN = 1e-12  # size of the dot, in radii, if the body itself is large enough to be seen

Overrides = dict[EntityPathLike, VisualizerLike | list[VisualizerLike]]


def is_crowded(header: Header) -> bool:
    """Return whether there are so many bodies that the view of the bodies draws them solid and without trails."""
    return header.bodies > FEW


def _drawn_bodies(
    header: Header, view: View, area: Area, recoloured: bool = False, named: tuple[str, ...] = ()
) -> Overrides:
    """Return overrides that add dots to small bodies, names to few bodies, and the colours of a `Supplement`."""
    apparent = header.radius / view.height() * area.height  # points, apparent radii
    small = apparent < LEAST
    is_solid = shape(header) == "ellipsoids" and is_crowded(header)
    if not (small.any() or recoloured or named or is_solid):
        return {}
    # negative radii are in points of the screen (Rerun)
    dots = np.where(small, -LEAST, _HIDDEN * header.radius).astype(np.float32)
    sizes = np.where(small, -LEAST, header.radius).astype(np.float32)
    match shape(header):
        case "ellipsoids":
            colours = "Points3D:colors" if recoloured else "Ellipsoids3D:colors"
            fill: Literal["Solid"] | None = "Solid" if is_solid else None
            names = rr.Ellipsoids3D.from_fields(show_labels=bool(named), labels=named or None, fill_mode=fill)
            spheres = names.visualizer(mappings=taken_from({"Ellipsoids3D:colors": colours}))
            return {paths.BODIES: [spheres, *([_points(dots, "Ellipsoids3D:centers", colours)] if small.any() else [])]}
        case "points":
            colours = "Ellipsoids3D:colors" if recoloured else "Points3D:colors"
            return {paths.BODIES: _points(sizes, "Points3D:positions", colours)}
        case _ if recoloured:  # all instances of a mesh have the same colour
            return {paths.BODIES: _points(sizes, "InstancePoses3D:translations", "Points3D:colors")}
        case _:
            return {}


def _points(radii: SingleArray, centres: str, colours: str) -> VisualizerLike:
    mappings = taken_from({"Points3D:positions": centres, "Points3D:colors": colours})
    return rr.Points3D.from_fields(radii=radii).visualizer(mappings=mappings)


def bodies_eye(camera: CameraFit, area: Area, added: Additions) -> View:
    """Return the camera of `bodies_view`."""
    inset, moment = area.inset_share, added.moment
    return camera.view(area.aspect, narrow=area.rendered, tips=added.marks, inset=inset, pictured=moment)


def bodies_view(header: Header, camera: CameraFit, area: Area, added: Additions = NONE) -> rrb.Spatial3DView:
    """Show bodies, planes, walls and the box, and the contacts unless a crowd of spheres hides them."""
    view = bodies_eye(camera, area, added)
    has_contacts = header.collides and not is_crowded(header)
    name = "Bodies and contacts" if has_contacts else "Bodies"
    # without carom, nobody has checked whether names overlap; a few names rarely overlap
    own = tuple(header.names) if added.legend is None and not area.rendered and header.bodies <= _MOST_NAMED else ()
    overrides = _drawn_bodies(header, view, area, added.recoloured, added.named or (own if any(own) else ()))
    overrides |= _edges(header, area.theme, wide=False, by_stage=added.by_stage)
    cursor = rr.TimeRangeBoundary.cursor_relative()
    if added.trails:  # show the pieces up to the cursor
        whole = rr.TimeRangeBoundary.infinite()
        starts = {SIM_TIME: whole, STEP: whole}
        if added.recent is not None:
            nanos, steps = added.recent
            starts[SIM_TIME] = rr.TimeRangeBoundary.cursor_relative(nanos=-nanos)
            starts[STEP] = rr.TimeRangeBoundary.cursor_relative(seq=-steps)
        ranges = [rrb.VisibleTimeRange(timeline, start=start, end=cursor) for timeline, start in starts.items()]
        overrides[TRAILS] = rrb.VisibleTimeRanges(ranges)
    if header.records_contacts:  # by default, each impact stays visible until the next impact
        clock = TimeScale.fitting(header.duration, header.shortest_dt_hint)
        start = rr.TimeRangeBoundary.cursor_relative(nanos=-int(1e9 * header.duration * OF_LATE / clock.scale))
        # the points get the colour of these arrows, since both show impulses by their sizes
        colour = palette.legible([palette.ARROWS[paths.FORCE_NORMAL]], area.theme)
        overrides[paths.IMPACTS] = [
            rrb.VisibleTimeRanges(timeline=SIM_TIME, start=start, end=cursor),
            rr.Points3D.from_fields(colors=colour).visualizer(),
        ]
    return spatial_view(
        f"{name} ({view.outside} outside)" if area.rendered and view.outside else name,
        view,
        [
            paths.BODIES,
            *surroundings(header),
            *([paths.CONTACTS] if has_contacts else []),
            *([TRAILS] if added.trails else []),
            *([f"{FIELD}/**"] if added.axes else []),
            *([f"{LEGEND}/**"] if area.inset[0] else []),
            *([paths.IMPACTS] if header.records_contacts else []),
            *([paths.IMPACT_SPINS] if header.records_contacts and header.spins else []),
        ],
        overrides,
        theme=area.theme,
    )


def _with_numbers(theme: str) -> list[VisualizerLike]:
    """Draw arrows, and their magnitudes as labels of invisible points, since an arrow colours its own labels."""
    sources = {"Points3D:positions": paths.NUMBERS_AT, "Points3D:labels": paths.NUMBERS}
    unseen = rr.Points3D.from_fields(radii=rr.Radius.ui_points(0.0), colors=palette.INKS[theme], show_labels=True)
    return [rr.Arrows3D.from_fields().visualizer(), unseen.visualizer(mappings=taken_from(sources))]


_GHOST = 0x8A93A630  # colour of a mesh behind arrows and edges


def has_graph(header: Header) -> bool:
    """Return whether there are contacts or torques to show."""
    return header.collides or header.has_torque


def graph_name(header: Header) -> str:
    """Return the title of `graph_view`."""
    edges = "Impulses" if header.records_contacts else "Collision graph"
    return f"{edges} and torques" if header.has_torque else edges


def graph_eye(header: Header, camera: CameraFit, area: Area, added: Additions) -> View:
    """Return the camera of `graph_view`."""
    # how far (m) arrows of medium length extend from the bodies
    room = arrow_length(header, paths.TORQUE) / 2 if header.has_torque else 0.0
    inset, moment = area.inset_share, added.moment
    if area.rendered and added.touching:
        camera = camera.of(added.touching)
    return camera.view(
        *(area.aspect, room), narrow=area.rendered, trails=False, tips=added.tips, moment=moment, inset=inset
    )


def graph_view(header: Header, camera: CameraFit, area: Area, added: Additions = NONE) -> rrb.Spatial3DView:
    """Show the collision graph, whose edges show impulses if these are recorded."""
    hidden: Overrides = {path: rrb.EntityBehavior(visible=False) for path in hidden_arrows(header, added)}
    only = added.touching if area.rendered else ()
    hides = is_crowded(header) and not only
    numbers: Overrides = {} if is_crowded(header) else {path: _with_numbers(area.theme) for path in paths.PARALLEL}
    return spatial_view(
        graph_name(header),
        graph_eye(header, camera, area, added),
        [
            paths.BODIES,
            *surroundings(header),
            *([paths.CONTACTS] if header.collides else []),
            *force_arrows(header),
            *turning_arrows(header),
            *([f"{LEGEND}/**"] if area.inset[0] else []),
        ],
        # among many wires in the colours of bodies, arrows could not be seen
        faint_bodies(header, added.recoloured, subdued(header, area.theme) if hides else None, only)
        | _edges(header, area.theme, wide=True)
        | hidden
        | numbers,
        theme=area.theme,
    )


def subdued(header: Header, theme: str) -> int:
    """Return the colour of wires that are not the subject of a view: faintest in crowds, where wires cross."""
    return (palette.FAINTEST if is_crowded(header) else palette.FADED)[theme]


def faint_bodies(
    header: Header, recoloured: bool = False, colour: int | None = None, only: Sequence[int] = ()
) -> Overrides:
    """Draw bodies as thin wires, in one colour or in their own, so that they do not hide edges and arrows.

    With ``only``, all other bodies are too small to be seen.
    """
    match shape(header):
        case "ellipsoids":
            width = rr.Radius.ui_points(0.4)
            sizes = None
            if only:
                size = _HIDDEN * header.radius
                size[list(only)] = header.radius[list(only)]
                sizes = np.repeat(single(size), 3).reshape(-1, 3)
            thin = rr.Ellipsoids3D.from_fields(
                half_sizes=sizes, fill_mode="MajorWireframe", line_radii=width, colors=colour
            )
            colours = {"Ellipsoids3D:colors": "Points3D:colors"} if recoloured and colour is None else {}
            return {paths.BODIES: thin.visualizer(mappings=taken_from(colours))}
        case "points":
            dots = rr.Points3D.from_fields(radii=rr.Radius.ui_points(1.0))
            colours = {"Points3D:colors": "Ellipsoids3D:colors"} if recoloured else {}
            return {paths.BODIES: dots.visualizer(mappings=taken_from(colours))}
        case _:
            return {paths.BODIES: rr.Mesh3D.from_fields(albedo_factor=_GHOST)}


WINDOW = Canvas()
ALL = "all"
PLOT = "plot"
CLOSE_UP = "close-up"

_ROWS = (5.0, 2.4, 1.7)  # heights of the 3D views, the plots and the texts
LEGEND_SHARE = 0.19  # width of the legend beside all rows, as a fraction of the whole width
_SMALL_WINDOW = Canvas(1280, 720)  # the legend is complete in any window that is at least this large


def blueprint(
    header: Header,
    camera: CameraFit,
    curves: Curves | None = None,
    canvas: Canvas = WINDOW,
    only: str = ALL,
    added: Additions = NONE,
) -> rrb.Blueprint:
    """Lay out a recording for a window, with a camera that is fitted to the bodies; ``curves`` is None during the run.

    ``only`` is the view that fills the window: "bodies", "graph", "close-up", "energy", "plot", or `ALL`. Raises
    RecordingError if the recording has nothing to show in this view.
    """
    header = as_happened(header, curves)
    parts = header, camera, curves, canvas, added
    root: rrb.View | rrb.Container = _all(*parts) if only == ALL else _single(*parts, only)
    has_panels = canvas.framed and not canvas.rendered
    panel: Literal["collapsed", "hidden"] = "collapsed" if has_panels else "hidden"
    return rrb.Blueprint(
        root,
        rrb.TopPanel(state="expanded" if has_panels else "hidden"),
        rrb.BlueprintPanel(state=panel),
        rrb.SelectionPanel(state=panel),
        # without a play state, the viewer starts playing
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
    """Return the area of the close-up view in a layout with a legend."""
    return _areas(canvas, _shares(header, True), legend=True)[-1] if only == ALL else canvas.area()


def bodies_area(header: Header, canvas: Canvas, only: str, close: bool) -> Area:
    """Return the area of the bodies' view in a layout with a legend."""
    return _areas(canvas, _shares(header, close), legend=True)[0] if only == ALL else canvas.area()


def graph_area(header: Header, canvas: Canvas, close: bool) -> Area:
    """Return the area of the contacts' view in a layout of all views with a legend."""
    return _areas(canvas, _shares(header, close), legend=True)[1]


def legend_area(canvas: Canvas) -> Area:
    """Return the area of the legend in a layout of all views; for a window, its area in a small window."""
    return (canvas if canvas.rendered else _SMALL_WINDOW).area(LEGEND_SHARE)


def _shares(header: Header, close: bool) -> list[float]:
    """Return the relative widths of the 3D views."""
    return [3.0, *([2.2] if has_graph(header) else []), *([2.0] if close else [])]


def _areas(canvas: Canvas, shares: list[float], *, legend: bool) -> list[Area]:
    across = (1.0 - LEGEND_SHARE if legend else 1.0) / sum(shares)
    return [canvas.area(across * share, _ROWS[0] / sum(_ROWS)) for share in shares]


def _all(header: Header, camera: CameraFit, curves: Curves | None, canvas: Canvas, added: Additions) -> rrb.Container:
    shares, beside = _shares(header, added.close is not None), added.legend is not None
    areas = _areas(canvas, shares, legend=beside)
    views: list[rrb.View] = [bodies_view(header, camera, areas[0], added)]
    if has_graph(header):
        views.append(graph_view(header, camera, areas[1], added))
    if added.close:
        views.append(added.close.view(header, added.recoloured))
    heights = list(_ROWS)
    if added.plots is not None:
        heights.insert(1, _ROWS[1])
    left = 1.0 - LEGEND_SHARE if beside else 1.0
    plots = canvas.area(left, _ROWS[1] / sum(heights))
    events = rrb.TextLogView(
        name=f"Events ({added.viewer_time})" if added.viewer_time else "Events",
        origin=paths.EVENTS,
        # no column for the entity, because it is always the same
        columns=rrb.TextLogColumns(text_log_columns=["LogLevel", "Body"]),
    )
    documents = {"Scene": paths.SCENE, "Scene file": paths.SCENE_TOML, "About": paths.ABOUT}
    if not beside:  # a text for readers without carom, which would draw a legend
        documents = {"Legend": paths.LEGEND} | documents
    pages = [rrb.TextDocumentView(name=name, origin=path, contents=[path]) for name, path in documents.items()]
    texts = rrb.Tabs(events, *pages, active_tab=None if beside else "Legend")
    rows = rrb.Vertical(
        rrb.Horizontal(*views, column_shares=shares),
        *([] if added.plots is None else [rrb.Horizontal(*added.plots.views(plots))]),
        rrb.Horizontal(*plot_views(header, curves, plots, added)),
        rrb.Horizontal(texts, _states(canvas.area(2.0 / 5.0 * left), added), column_shares=[3, 2]),
        row_shares=heights,
    )
    if added.legend is None:
        return rows
    return rrb.Horizontal(rows, added.legend.view(legend_area(canvas)), column_shares=[left, LEGEND_SHARE])


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
            raise RecordingError("no known impact of bodies that are there then; name two bodies, or another time")
        case "plot" if added.plots is not None:  # plots of single bodies, all with the same unit
            return added.plots.view(added.plots.units[0], canvas.area())
        case "plot":
            raise RecordingError("there are no bodies to plot")
        case _:
            return energy_view(header, curves, canvas.area(), added)


def _states(area: Area, added: Additions) -> rrb.View:
    """Lay out the strips of events: impacts, if they are few enough, phases and limits."""
    return rrb.StateTimelineView(
        name="Impacts, phase, and what limits dt" if added.struck else "Phase, and what limits dt",
        origin="/",
        contents=[*([paths.IMPACTS] if added.struck else []), paths.PHASE, paths.DT_LIMIT],
        time_view=time_axis(area, added.span),
    )
