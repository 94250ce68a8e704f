"""Properties of all 3D views: position of the eye and background."""

from __future__ import annotations

import rerun.blueprint as rrb

from carom.recording.schema import palette, paths
from carom.recording.view.camera import View


def eye(view: View, follows: str | None = None) -> rrb.EyeControls3D:
    """Place Rerun's eye; it follows an entity if one is given, or all bodies if the view does."""
    return rrb.EyeControls3D(
        position=view.eye,
        look_target=view.target,
        eye_up=[0.0, 0.0, 1.0],
        tracking_entity=follows or (paths.BODIES if view.follows else None),
    )


def background() -> rrb.Background:
    """Return the dark background."""
    return rrb.Background(color=palette.BACKGROUND, kind=rrb.BackgroundKind.SolidColor)
