"""The layout of files that carom writes as an answer: they open paused, with the viewer's panels collapsed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import rerun.blueprint as rrb

from carom.recording.layout.camera import View
from carom.recording.layout.spatial_view import spatial_view
from carom.recording.schema.paths import SIM_TIME


def beside_bodies(name: str, contents: Sequence[str], view: View, panels: rrb.Vertical) -> rrb.Blueprint:
    """Lay out a 3D view of some entities, whose camera stands still, with panels on its right."""
    bodies = spatial_view(name, replace(view, follows=False), contents)
    return paused(rrb.Horizontal(bodies, panels, column_shares=[3, 2]))


def paused(root: rrb.Container) -> rrb.Blueprint:
    """Lay out views that open paused, without the panels around them."""
    return rrb.Blueprint(
        root,
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=SIM_TIME, play_state="paused"),
        auto_views=False,
        auto_layout=False,
    )
