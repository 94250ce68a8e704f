"""What the views of a layout share: sizes on the screen, additions, magnified spaces, and the frame of 3D views."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import rerun as rr
import rerun.blueprint as rrb
from rerun.blueprint.api import VisualizerLike
from rerun.encodings import EntityPathLike

from carom.recording.layout.camera import View
from carom.recording.schema import palette, paths
from carom.recording.schema.header import Header
from carom.recording.schema.paths import PERIODIC_BOX, PLANES, WALLS

if TYPE_CHECKING:
    from carom.show.body_plots import BodyPlots
    from carom.show.close_up import CloseUp


_TITLE = 24  # points, of a view's title bar
_TIME_PANEL = 34  # points, collapsed
_TOP_PANEL = 36  # points


@dataclass(frozen=True, slots=True)
class Area:
    """A view without its title bar."""

    width: float  # points of the screen
    height: float

    @property
    def aspect(self) -> float:
        """Width over height."""
        return self.width / self.height


@dataclass(frozen=True, slots=True)
class Canvas:
    """The window or the picture, in points of the screen."""

    width: int = 1600
    height: int = 1000
    framed: bool = True  # with the viewer's panels and the titles of views

    def area(self, across: float = 1.0, down: float = 1.0) -> Area:
        """Return the area of a view that takes these shares of the width and of the height."""
        if not self.framed:
            return Area(self.width * across, self.height * down)
        height = self.height - _TOP_PANEL - _TIME_PANEL
        return Area(max(1.0, self.width * across), max(1.0, height * down - _TITLE))


@dataclass(frozen=True, slots=True)
class Additions:
    """Parts of a layout that are not in the file: the viewer gets them in a `Supplement`. By default none."""

    close: CloseUp | None = None
    trails: bool = False
    recoloured: bool = False
    plots: BodyPlots | None = None  # of single bodies


NONE = Additions()


# Magnified spaces, in which views show small scenes. Rerun's camera draws nothing nearer than 0.01 units (Rerun 0.41),
# and this cannot be changed: grains of a millimetre would be invisible in metres. A view of such a scene therefore
# has an entity as its origin whose transform shrinks by a power of ten, so that everything else is larger in the
# space of the view. The numbers in the file stay as they are.

NEAREST = 0.5  # units, of the camera from its target: bodies are drawn, and so are arrows in front of them
EVERYTHING = "/"


def space(distance: float) -> str:
    """Return the origin of a view whose camera is this far (m) from its target."""
    if not 0.0 < distance < NEAREST:
        return EVERYTHING
    return f"/{paths.MAGNIFIED}/{math.ceil(math.log10(NEAREST / distance))}"


def scale(origin: str) -> float:
    """Return how much larger than in metres things are in a view with this origin."""
    return 1.0 if origin == EVERYTHING else 10.0 ** int(origin.rpartition("/")[2])


def log_spaces(stream: rr.RecordingStream, layout: rrb.Blueprint) -> None:
    """Write the transforms of the magnified spaces that a layout needs."""
    for origin in sorted(_origins(layout.root_container)):
        stream.log(origin, rr.Transform3D(scale=1.0 / scale(origin)), static=True)


def _origins(part: rrb.Container | rrb.View) -> set[str]:
    """Return the magnified spaces among the origins of the views of a part of a layout."""
    if isinstance(part, rrb.View):
        return {str(part.origin)} if str(part.origin).startswith(f"/{paths.MAGNIFIED}/") else set()
    return set().union(*(_origins(inner) for inner in part.contents))


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


def surroundings(header: Header) -> list[str]:
    """Return the entities of planes, walls and periodic box that the scene has."""
    parts = ((PLANES, header.planes), (WALLS, header.walls), (PERIODIC_BOX, header.box))
    return [path for path, part in parts if part is not None]
