"""The 3D view of the bodies as solids."""

from __future__ import annotations

import rerun.blueprint as rrb

from carom.recording.schema import paths
from carom.recording.schema.header import Header
from carom.recording.view.camera import View
from carom.recording.view.eye import background, eye
from carom.recording.write import encoder as entities


def bodies_view(header: Header, view: View) -> rrb.Spatial3DView:
    """Show bodies, contacts and what surrounds them."""
    return rrb.Spatial3DView(
        name="Bodies and contacts",
        origin="/",
        contents=[
            paths.BODIES,
            *entities.surroundings(header),
            *([paths.CONTACTS] if header.collides else []),
        ],
        background=background(),
        line_grid=False,
        eye_controls=eye(view),
    )
