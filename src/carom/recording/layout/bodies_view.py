"""The 3D view of the bodies as solids."""

from __future__ import annotations

import rerun.blueprint as rrb

from carom.recording.layout.additions import NONE, Additions
from carom.recording.layout.camera import CameraFit
from carom.recording.layout.canvas import Area
from carom.recording.layout.contact_overrides import recent_impacts
from carom.recording.layout.drawn_bodies import drawn_bodies
from carom.recording.layout.spatial_view import spatial_view
from carom.recording.layout.surroundings import surroundings
from carom.recording.layout.visible_trails import TRAILS, up_to_cursor
from carom.recording.schema import paths
from carom.recording.schema.header import Header


def bodies_view(header: Header, camera: CameraFit, area: Area, added: Additions = NONE) -> rrb.Spatial3DView:
    """Show bodies, contacts, planes, walls and the box."""
    view = camera.view(area.aspect)
    return spatial_view(
        "Bodies and contacts" if header.collides else "Bodies",
        view,
        [
            paths.BODIES,
            *surroundings(header),
            *([paths.CONTACTS] if header.collides else []),
            *([TRAILS] if added.trails else []),
            *([paths.IMPACTS] if header.records_contacts else []),
        ],
        {
            **drawn_bodies(header, view, area, added.recoloured),
            **(up_to_cursor() if added.trails else {}),
            **recent_impacts(header),
        },
    )
