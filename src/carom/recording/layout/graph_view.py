"""The 3D view of the collision graph: edges and arrows, and the bodies as thin wires."""

from __future__ import annotations

import rerun as rr
import rerun.blueprint as rrb
from rerun.blueprint.api import VisualizerLike
from rerun.encodings import EntityPathLike

from carom.recording.layout.camera import CameraFit
from carom.recording.layout.canvas import Area
from carom.recording.layout.contact_overrides import edges_by_impulse, force_arrows
from carom.recording.layout.spatial_view import spatial_view
from carom.recording.layout.surroundings import surroundings
from carom.recording.schema import paths
from carom.recording.schema.header import Header
from carom.recording.style.arrow_length import arrow_length
from carom.recording.style.body_shape import shape

_GHOST = 0x8A93A630
_WIRE = 0x8A93A6FF  # bodies behind arrows and edges


def has_graph(header: Header) -> bool:
    """Return whether there are contacts or torques to show."""
    return header.collides or header.has_torque


def graph_view(header: Header, camera: CameraFit, area: Area) -> rrb.Spatial3DView:
    """Return the view; edges are drawn by their impulses if these are recorded."""
    view = camera.view(area.aspect, _arrows(header))
    return spatial_view(
        _name(header),
        view,
        [
            paths.BODIES,
            *surroundings(header),
            *([paths.CONTACTS] if header.collides else []),
            *force_arrows(header),
            *([paths.TORQUE, paths.ANGULAR_ACCELERATION] if header.has_torque else []),
        ],
        faint_bodies(header) | edges_by_impulse(header),
    )


def _name(header: Header) -> str:
    edges = "Impulses" if header.records_contacts else "Collision graph"
    return f"{edges}, torques, angular accelerations" if header.has_torque else edges


def _arrows(header: Header) -> float:
    """Return how far (m) arrows of medium length reach out of the bodies."""
    return arrow_length(header, paths.ANGULAR_ACCELERATION) / 4 if header.has_torque else 0.0


def faint_bodies(header: Header) -> dict[EntityPathLike, VisualizerLike]:
    """Draw bodies as thin wires, so that they do not hide edges and arrows."""
    match shape(header):
        case "ellipsoids":
            thin = rr.Radius.ui_points(0.4)
            return {
                paths.BODIES: rr.Ellipsoids3D.from_fields(fill_mode="MajorWireframe", colors=_WIRE, line_radii=thin)
            }
        case "points":
            return {paths.BODIES: rr.Points3D.from_fields(radii=rr.Radius.ui_points(1.0), colors=_WIRE)}
        case _:
            return {paths.BODIES: rr.Mesh3D.from_fields(albedo_factor=_GHOST)}
