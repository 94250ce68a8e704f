"""Properties of all 3D views: their space, position of the eye and background."""

from __future__ import annotations

import rerun.blueprint as rrb

from carom.recording.layout.camera import View
from carom.recording.layout.magnification import scale, space
from carom.recording.schema import palette, paths


def eye(view: View, follows: str | None = None) -> rrb.EyeControls3D:
    """Place Rerun's eye; it follows an entity if one is given, or all bodies if the view does."""
    larger = scale(space_of(view))
    return rrb.EyeControls3D(
        position=larger * view.eye,
        look_target=larger * view.target,
        eye_up=[0.0, 0.0, 1.0],
        tracking_entity=follows or (paths.BODIES if view.follows else None),
    )


def space_of(view: View) -> str:
    """Return the origin of a 3D view, whose space is magnified if the eye is very near."""
    return space(view.distance)


def background() -> rrb.Background:
    """Return the dark background."""
    return rrb.Background(color=palette.BACKGROUND, kind=rrb.BackgroundKind.SolidColor)
