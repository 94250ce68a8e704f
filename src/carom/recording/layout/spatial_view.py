"""What all 3D views have in common: their space, the position of the eye and the dark background."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import rerun.blueprint as rrb
from rerun.blueprint.api import VisualizerLike
from rerun.encodings import EntityPathLike

from carom.recording.layout.camera import View
from carom.recording.layout.magnification import scale, space
from carom.recording.schema import palette, paths


def spatial_view(
    name: str,
    view: View,
    contents: Sequence[str],
    overrides: Mapping[EntityPathLike, VisualizerLike | list[VisualizerLike]] | None = None,
    follows: str | None = None,
) -> rrb.Spatial3DView:
    """Lay out a 3D view of some entities; its space is magnified if the eye is very near.

    The eye follows an entity if one is given, or all bodies if ``view`` does.
    """
    origin = space(view.distance)
    larger = scale(origin)
    return rrb.Spatial3DView(
        name=name,
        origin=origin,
        contents=list(contents),
        background=rrb.Background(color=palette.BACKGROUND, kind=rrb.BackgroundKind.SolidColor),
        line_grid=False,
        eye_controls=rrb.EyeControls3D(
            position=larger * view.eye,
            look_target=larger * view.target,
            eye_up=[0.0, 0.0, 1.0],
            tracking_entity=follows or (paths.BODIES if view.follows else None),
        ),
        overrides=overrides,
    )
