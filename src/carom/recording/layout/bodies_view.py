"""The two 3D views: the bodies as solids, and the collision graph with arrows and with the bodies as thin wires."""

from __future__ import annotations

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from rerun.blueprint.api import VisualizerLike
from rerun.encodings import EntityPathLike

from carom.arrays import SingleArray
from carom.recording.layout.camera import CameraFit, View
from carom.recording.layout.canvas import LEGEND, NONE, Additions, Area, spatial_view, surroundings, taken_from
from carom.recording.layout.drawing import arrow_length, shape
from carom.recording.schema import palette, paths
from carom.recording.schema.header import Header
from carom.recording.schema.paths import SIM_TIME, STEP
from carom.recording.schema.time_scale import TimeScale

OF_LATE = 1 / 300  # fraction of the duration for which an impact stays visible


def force_arrows(header: Header) -> list[str]:
    """Return the entities of the impulse arrows in a recording."""
    if not header.records_contacts:
        return []
    return [paths.FORCE_NORMAL, *([paths.FORCE_FRICTION] if header.has_friction else [])]


def edges_by_impulse(header: Header, theme: str) -> Overrides:
    """Draw the edges of the collision graph with widths and colours by impulse, as force chains.

    On white paper the bright end of the colours would be invisible, so only the width shows the impulse.
    """
    if not header.records_contacts:
        return plain_edges(header, theme)
    widths = {"LineStrips3D:radii": "impulse_width"}
    if theme == "light":
        edges = rr.LineStrips3D.from_fields(colors=palette.VERMILION).visualizer(mappings=taken_from(widths))
    else:
        colours = {"LineStrips3D:colors": "impulse_colour"}
        edges = rr.LineStrips3D.from_fields().visualizer(mappings=taken_from(colours | widths))
    return {paths.CONTACTS: edges}


def plain_edges(header: Header, theme: str) -> Overrides:
    """Draw edges in one colour on white paper, where the yellow and white edges of some stages would be invisible."""
    if theme == "dark" or not header.collides:
        return {}
    return {paths.CONTACTS: rr.LineStrips3D.from_fields(colors=palette.VERMILION)}


def recent_impacts(header: Header) -> Overrides:
    """Return overrides that show impacts for a short time; by default each stays visible until the next."""
    if not header.records_contacts:
        return {}
    clock = TimeScale.fitting(header.duration, header.shortest_dt_hint)
    start = rr.TimeRangeBoundary.cursor_relative(nanos=-int(1e9 * header.duration * OF_LATE / clock.scale))
    end = rr.TimeRangeBoundary.cursor_relative()
    return {paths.IMPACTS: rrb.VisibleTimeRanges(timeline=SIM_TIME, start=start, end=end)}


TRAILS = "trails"
FIELD = "field"  # the arrow of a uniform field, and axes


def up_to_cursor() -> dict[EntityPathLike, VisualizerLike]:
    """Return the override with which a view shows all pieces up to the cursor."""
    start, end = rr.TimeRangeBoundary.infinite(), rr.TimeRangeBoundary.cursor_relative()
    ranges = [rrb.VisibleTimeRange(timeline, start=start, end=end) for timeline in (SIM_TIME, STEP)]
    return {TRAILS: rrb.VisibleTimeRanges(ranges)}


# Overrides with which a view draws bodies: colours other than the recorded ones, and a minimum size on the screen.
# Spheres have their true radii in metres. For bodies smaller than two points of the screen, the view also draws a dot
# of fixed size at the recorded centre, so the file does not grow.

LEAST = 2.0  # points of the screen, radius of a dot
_HIDDEN = 1e-12  # of a body's radius; size of the dot if the body itself is large enough

Overrides = dict[EntityPathLike, VisualizerLike | list[VisualizerLike]]


def drawn_bodies(
    header: Header, view: View, area: Area, recoloured: bool = False, named: tuple[str, ...] = ()
) -> Overrides:
    """Return overrides that add dots to small bodies and names to few, and apply the colours of a `Supplement`."""
    apparent = header.radius / view.height() * area.height  # points
    small = apparent < LEAST
    if not (small.any() or recoloured or named):
        return {}
    # negative radii are in points of the screen (Rerun)
    dots = np.where(small, -LEAST, _HIDDEN * header.radius).astype(np.float32)
    sizes = np.where(small, -LEAST, header.radius).astype(np.float32)
    match shape(header):
        case "ellipsoids":
            colours = "Points3D:colors" if recoloured else "Ellipsoids3D:colors"
            names = rr.Ellipsoids3D.from_fields(show_labels=bool(named), labels=named or None)
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
    return camera.view(
        area.aspect,
        narrow=area.rendered,
        tips=added.marks,
        inset=area.inset_share,
        pictured=added.moment,
    )


def bodies_view(header: Header, camera: CameraFit, area: Area, added: Additions = NONE) -> rrb.Spatial3DView:
    """Show bodies, contacts, planes, walls and the box."""
    view = bodies_eye(camera, area, added)
    name = "Bodies and contacts" if header.collides else "Bodies"
    return spatial_view(
        f"{name} ({view.outside} outside)" if area.rendered and view.outside else name,
        view,
        [
            paths.BODIES,
            *surroundings(header),
            *([paths.CONTACTS] if header.collides else []),
            *([TRAILS] if added.trails else []),
            *([f"{FIELD}/**"] if added.field else []),
            *([LEGEND] if area.inset[0] else []),
            *([paths.IMPACTS] if header.records_contacts else []),
            *([paths.IMPACT_SPINS] if header.records_contacts and header.spins else []),
        ],
        {
            **drawn_bodies(header, view, area, added.recoloured, added.named),
            **(up_to_cursor() if added.trails else {}),
            **recent_impacts(header),
            **plain_edges(header, area.theme),
        },
        theme=area.theme,
    )


_GHOST = 0x8A93A630  # a mesh behind arrows and edges


def has_graph(header: Header) -> bool:
    """Return whether there are contacts or torques to show."""
    return header.collides or header.has_torque


def graph_eye(header: Header, camera: CameraFit, area: Area, added: Additions) -> View:
    """Return the camera of `graph_view`."""
    # how far (m) arrows of medium length extend from the bodies
    room = arrow_length(header, paths.ANGULAR_ACCELERATION) / 4 if header.has_torque else 0.0
    return camera.view(
        *(area.aspect, room),
        narrow=area.rendered,
        trails=False,
        tips=added.tips,
        moment=added.moment,
        inset=area.inset_share,
    )


def graph_view(header: Header, camera: CameraFit, area: Area, added: Additions = NONE) -> rrb.Spatial3DView:
    """Return the view; edges are drawn by their impulses if these are recorded."""
    return spatial_view(
        _name(header),
        graph_eye(header, camera, area, added),
        [
            paths.BODIES,
            *surroundings(header),
            *([paths.CONTACTS] if header.collides else []),
            *force_arrows(header),
            *([paths.TORQUE, paths.ANGULAR_ACCELERATION] if header.has_torque else []),
            *([LEGEND] if area.inset[0] else []),
        ],
        faint_bodies(header, added.recoloured) | edges_by_impulse(header, area.theme),
        theme=area.theme,
    )


def _name(header: Header) -> str:
    edges = "Impulses" if header.records_contacts else "Collision graph"
    return f"{edges}, torques, angular accelerations" if header.has_torque else edges


def faint_bodies(header: Header, recoloured: bool = False) -> Overrides:
    """Draw bodies as thin wires in their own colours, so that they do not hide edges and arrows."""
    match shape(header):
        case "ellipsoids":
            thin = rr.Ellipsoids3D.from_fields(fill_mode="MajorWireframe", line_radii=rr.Radius.ui_points(0.4))
            colours = {"Ellipsoids3D:colors": "Points3D:colors"} if recoloured else {}
            return {paths.BODIES: thin.visualizer(mappings=taken_from(colours))}
        case "points":
            dots = rr.Points3D.from_fields(radii=rr.Radius.ui_points(1.0))
            colours = {"Points3D:colors": "Ellipsoids3D:colors"} if recoloured else {}
            return {paths.BODIES: dots.visualizer(mappings=taken_from(colours))}
        case _:
            return {paths.BODIES: rr.Mesh3D.from_fields(albedo_factor=_GHOST)}
