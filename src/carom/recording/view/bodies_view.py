"""The 3D view of the bodies as solids."""

from __future__ import annotations

import rerun.blueprint as rrb

from carom.recording.schema import paths
from carom.recording.schema.header import Header
from carom.recording.view.additions import NONE, Additions
from carom.recording.view.camera import CameraFit
from carom.recording.view.canvas import Area
from carom.recording.view.contact_overrides import recent_impacts
from carom.recording.view.drawn_bodies import drawn_bodies
from carom.recording.view.eye import background, eye, space_of
from carom.recording.view.trails import TRAILS, up_to_cursor
from carom.recording.write import encoder as entities


def bodies_view(header: Header, camera: CameraFit, area: Area, added: Additions = NONE) -> rrb.Spatial3DView:
    """Show bodies, contacts, planes, walls and the box."""
    view = camera.view(area.aspect)
    return rrb.Spatial3DView(
        name="Bodies and contacts" if header.collides else "Bodies",
        origin=space_of(view),
        contents=[
            paths.BODIES,
            *entities.surroundings(header),
            *([paths.CONTACTS] if header.collides else []),
            *([TRAILS] if added.trails else []),
            *([paths.IMPACTS] if header.records_contacts else []),
        ],
        background=background(),
        line_grid=False,
        eye_controls=eye(view),
        overrides={
            **drawn_bodies(header, view, area, added.recoloured),
            **(up_to_cursor() if added.trails else {}),
            **recent_impacts(header),
        },
    )
