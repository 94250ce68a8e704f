"""Common parts of a layout's views: cameras, screen sizes, additions, magnified spaces, and the frame of 3D views."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from itertools import product
from typing import Protocol

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from rerun.blueprint.api import VisualizerLike
from rerun.blueprint.encodings import ComponentSourceKind, VisualizerComponentMapping
from rerun.encodings import EntityPathLike

from carom.arrays import BoolArray, FloatArray, IntArray
from carom.recording.schema import palette, paths
from carom.recording.schema.curve_outline import Curves
from carom.recording.schema.header import Header
from carom.recording.schema.paths import MOVING, PERIODIC_BOX, PLANES, SHAPES, WALLS

SLOPE = float(np.tan(np.radians(55.0 / 2)))  # slope of the picture's upper border: Rerun's field of view is 55° high
UP = np.array([0.0, 0.0, 1.0])
STEEP = 1e-6  # sine of the angle to the vertical below which a direction has no azimuth


class CameraMotion(StrEnum):
    """How the camera moves while time passes."""

    STILL = "still"
    FOLLOW = "follow"
    ORBIT = "orbit"


@dataclass(frozen=True, slots=True)
class View:
    """Position of the camera, and how it moves."""

    target: FloatArray  # (3,) m
    distance: float  # m, distance of the eye from the target
    motion: CameraMotion
    to_eye: FloatArray  # (3,) unit vector
    up: FloatArray = field(default_factory=UP.copy)  # (3,) unit vector that is vertical on the screen
    slope: float = SLOPE  # half the picture's height at unit distance
    whole: bool = True  # whether all measured motion is inside the picture
    outside: int = 0  # number of bodies that are not wholly inside the picture at the first moment

    @property
    def eye(self) -> FloatArray:
        """Position of the eye (m)."""
        return np.asarray(self.target + self.distance * self.to_eye)

    def axes(self) -> FloatArray:
        """Return the unit vectors to the right and up on the screen, (2, 3)."""
        return screen(self.to_eye, self.up)[:2]

    def height(self) -> float:
        """Return the height (m) of the picture at the target."""
        return 2.0 * self.slope * self.distance

    def on_screen(self, position: FloatArray) -> FloatArray:
        """Project positions (..., 3) m; the picture's upper and lower border are at ±1, and x has the same scale."""
        across, up, nearer = np.moveaxis((position - self.target) @ screen(self.to_eye, self.up).T, -1, 0)
        return np.asarray(np.stack([across, up], axis=-1) / (self.slope * (self.distance - nearer))[..., None])

    def radius_on_screen(self, position: FloatArray, radius: FloatArray) -> FloatArray:
        """Return the radii (...,) of spheres on the screen, in half heights of the picture."""
        nearer = (position - self.target) @ self.to_eye
        return np.asarray(radius / (self.slope * (self.distance - nearer)))

    def holds(self, position: FloatArray, radius: FloatArray, aspect: float) -> BoolArray:
        """Return which spheres (...,) are wholly inside a picture with this ratio of width to height."""
        beyond = np.abs(self.on_screen(position)) + self.radius_on_screen(position, radius)[..., None]
        inside: BoolArray = np.all(beyond <= [aspect, 1.0], axis=-1)
        return inside


def screen(to_eye: FloatArray, up: FloatArray = UP) -> FloatArray:
    """Return the axes of the screen, (3, 3): to the right, up and towards the eye."""
    right = np.cross(up, to_eye)
    if float(np.linalg.norm(right)) < STEEP:  # the eye looks straight from above or below
        right = np.cross(np.eye(3)[int(np.argmin(np.abs(to_eye)))], to_eye)
    right = right / np.linalg.norm(right)
    return np.array([right, np.cross(to_eye, right), to_eye])


def turned(vector: FloatArray, axis: FloatArray, angle: float) -> FloatArray:
    """Rotate vectors (..., 3) about a unit vector by an angle (rad)."""
    along = (vector @ axis)[..., None] * axis
    aside = vector - along
    return np.asarray(along + np.cos(angle) * aside + np.sin(angle) * np.cross(axis, aside))


def corners_of(header: Header, origin: FloatArray) -> FloatArray | None:
    """Return the drawn corners (8, 3) of the walls or of the periodic box; None if there is neither."""
    size = header.walls if header.walls is not None else header.drawn_box
    return None if size is None else np.array(list(product((-0.5, 0.5), repeat=3))) * size - origin


def upright(up: FloatArray) -> FloatArray:
    """Return axes (3, 3); the last axis points up. These are the axes of the scene, unless gravity points elsewhere."""
    if float(up @ UP) > 1.0 - STEEP:
        return np.eye(3)
    across = np.cross(up, np.eye(3)[int(np.argmin(np.abs(up)))])
    across = across / np.linalg.norm(across)
    return np.array([across, np.cross(up, across), up])


CORNERS = ((1, 1), (-1, 1), (1, -1), (-1, -1))  # right and up are positive


def free_corner(
    view: View, aspect: float, inset: tuple[float, float], position: FloatArray, radius: FloatArray
) -> tuple[int, int] | None:
    """Return a corner in which a legend covers no sphere, or None; ``inset`` is a fraction of the picture's size."""
    places, sizes = view.on_screen(position), view.radius_on_screen(position, radius)[:, None]
    half, whole = np.array([inset[0] * aspect, inset[1]]), np.array([aspect, 1.0])
    for corner in CORNERS:
        if not np.any(np.all(np.abs(places - corner * (whole - half)) < half + sizes, axis=1)):
            return corner
    return None


_TITLE = 24  # points, height of a view's title bar
_TIME_PANEL = 34  # points, height of the collapsed time panel
_TOP_PANEL = 36  # points, height of the top panel


@dataclass(frozen=True, slots=True)
class Area:
    """A view without its title bar."""

    width: float  # points of the screen
    height: float
    rendered: bool = False
    theme: str = "dark"
    inset: tuple[float, float] = (0.0, 0.0)  # points, width and height of a legend that stands in a corner

    @property
    def aspect(self) -> float:
        """Ratio of width to height."""
        return self.width / self.height

    @property
    def inset_share(self) -> tuple[float, float]:
        """Width and height of the legend, as fractions of the width and height of the view."""
        return self.inset[0] / self.width, self.inset[1] / self.height


@dataclass(frozen=True, slots=True)
class Canvas:
    """The window or the picture, in points of the screen."""

    width: int = 1600
    height: int = 1000
    framed: bool = True  # whether views have title bars and windows have panels, which reduce the height
    rendered: bool = False  # whether this is a picture, without panels and possibly with narrow lenses
    theme: str = "dark"

    def area(self, across: float = 1.0, down: float = 1.0) -> Area:
        """Return the area of a view that fills these fractions of the width and of the height."""
        width, height = self.width * across, self.height * down
        if self.framed:
            panels = _TOP_PANEL + (0 if self.rendered else _TIME_PANEL)  # a hidden top panel leaves its place empty
            width, height = max(1.0, width), max(1.0, (self.height - panels) * down - _TITLE)
        return Area(width, height, self.rendered, self.theme)


class CloseView(Protocol):
    """A view of the two bodies of a contact; see `display/close_up.py`."""

    def view(self, header: Header, recoloured: bool = False) -> rrb.View:
        """Return the view."""
        ...


class LegendView(Protocol):
    """A view of the meaning of colours; see `display/legend_layout.py`."""

    def view(self, area: Area) -> rrb.View:
        """Return the view of the legend."""
        ...


class PlotsOfBodies(Protocol):
    """Plots of quantities of single bodies, one for each unit; see `display/supplement.py`."""

    @property
    def units(self) -> Sequence[str]:
        """The units of the plots."""
        ...

    def view(self, unit: str, area: Area) -> rrb.View:
        """Return the plot of a unit."""
        ...

    def views(self, area: Area) -> Sequence[rrb.View]:
        """Return all plots."""
        ...


@dataclass(frozen=True, slots=True)
class Additions:
    """Parts of a layout that are not in the file, but in a `Supplement` for the viewer. By default there are none."""

    close: CloseView | None = None
    trails: bool = False
    recoloured: bool = False
    by_stage: bool = False  # whether the edges beside the bodies have the colours of the solver's stages
    both_arrows: bool = False  # whether angular accelerations and changes of spin also have arrows
    plots: PlotsOfBodies | None = None  # plots of single bodies
    legend: LegendView | None = None
    named: tuple[str, ...] = ()  # (n,) names beside the bodies, empty for a body without a name; () if no body has one
    axes: bool = False  # whether axes show the scale, and an arrow shows a uniform field
    struck: bool = False  # whether a strip shows the impacts
    decades: Curves | None = None  # logarithms of energies that grow by decades, by the paths of the energies
    moment: bool = False  # whether a picture shows one moment, so that other moments need not be inside it
    tips: FloatArray | None = None  # (k, 3) m, tips of the arrows that are drawn at the moment
    touching: Sequence[int] = ()  # the few bodies of a crowd that a picture of the contacts shows; () for all bodies
    marks: FloatArray | None = None  # (k, 3) m, points around the drawn points of impacts
    inset: tuple[float, float] = (0.0, 0.0)  # points, width and height of the legend inside a single view
    caption: Sequence[str] = ()  # title of a plot that fills the picture
    viewer_time: str = ""  # how the viewer's times are related to the scene's unit of time, if they are not the same
    # length of trails, in ns of the viewer and in steps; None means the whole past
    recent: tuple[int, int] | None = None
    span: IntArray | None = None  # (2,) ns, first and last time of plots that nobody will zoom


NONE = Additions()
LEGEND = paths.LEGEND


# Magnified spaces, in which views show small scenes. Rerun's camera draws nothing nearer than 0.01 units (Rerun 0.41),
# a fixed limit: millimetre grains would be invisible in metres. The origin of such a view is therefore an entity whose
# transform shrinks by a power of ten, so that everything else appears larger. The numbers in the file do not change.

NEAREST = 0.5  # units, smallest distance of the camera from its target: bodies and arrows in front of it are drawn
EVERYTHING = "/"
_LENS = "lens"
_UNSEEN = 1e-3  # units; Rerun draws nothing nearer than 0.01


def space(distance: float) -> str:
    """Return the origin of a view whose camera has a distance (m) from its target."""
    if not 0.0 < distance < NEAREST:
        return EVERYTHING
    return f"/{paths.MAGNIFIED}/{math.ceil(math.log10(NEAREST / distance))}"


def scale(origin: str) -> float:
    """Return the magnification of a view with this origin, relative to metres."""
    return 1.0 if origin == EVERYTHING else 10.0 ** int(origin.rpartition("/")[2])


def log_spaces(stream: rr.RecordingStream, layout: rrb.Blueprint) -> None:
    """Write the transforms of the magnified spaces that a layout needs, and its lenses."""
    views = views_of(layout.root_container)
    for origin in sorted({str(view.origin) for view in views if str(view.origin).startswith(f"/{paths.MAGNIFIED}/")}):
        stream.log(origin, rr.Transform3D(scale=1.0 / scale(origin)), static=True)
    for view in views:
        if isinstance(view, LensView):
            stream.log(view.lens.path, view.lens.pinhole(), static=True)
            if view.lens.view.motion is CameraMotion.STILL:
                stream.log(view.lens.path, view.lens.pose(), static=True)


def views_of(part: rrb.Container | rrb.View) -> list[rrb.View]:
    """Return the views of a part of a layout."""
    if isinstance(part, rrb.View):
        return [part]
    return [view for inner in part.contents for view in views_of(inner)]


# Rerun's eye has a field of view of 55° (Rerun 0.43). Only an eye that tracks a pinhole camera has the field of view of
# that camera. When somebody rotates the view, the eye returns to 55°, far from the bodies, and rotates about a point
# one unit in front of it. Only pictures and movies therefore have a narrow lens, not the viewer's windows.


@dataclass(frozen=True, slots=True)
class Lens:
    """A camera that the eye of a view tracks, for its narrow field of view."""

    path: str
    view: View  # view with the slope of the lens
    larger: float  # scale of the space in which the view shows the scene

    def pinhole(self) -> rr.Pinhole:
        """Return the field of view; the camera itself is too near to its own eye to be drawn."""
        return rr.Pinhole(
            fov_y=2.0 * math.atan(self.view.slope),
            aspect_ratio=1.0,
            camera_xyz=rr.ViewCoordinates.RUB,
            image_plane_distance=_UNSEEN,
        )

    def pose(self) -> rr.Transform3D:
        """Return the position and the axes of the camera."""
        axes = screen(self.view.to_eye, self.view.up)
        return rr.Transform3D(translation=self.larger * self.view.eye, mat3x3=axes.T)

    def poses(self, views: Sequence[View]) -> rr.ComponentColumnList:
        """Return positions and axes of a moving camera, with a row for each view."""
        axes = [screen(view.to_eye, view.up).T for view in views]
        eyes = self.larger * np.array([view.eye for view in views])
        return rr.Transform3D.columns(translation=eyes, mat3x3=axes)


class LensView(rrb.Spatial3DView):
    """A 3D view whose eye tracks a lens."""

    lens: Lens


def spatial_view(
    name: str,
    view: View,
    contents: Sequence[str],
    overrides: Mapping[EntityPathLike, VisualizerLike | list[VisualizerLike]] | None = None,
    follows: str | None = None,
    theme: str = "dark",
) -> rrb.Spatial3DView:
    """Lay out a 3D view of entities. The eye follows the entity ``follows`` or, if ``view`` says so, all bodies."""
    origin = space(view.distance)
    larger = scale(origin)
    tracked = follows or (paths.BODIES if view.motion is CameraMotion.FOLLOW else None)
    lens = None
    if view.slope != SLOPE:
        key = "".join(filter(str.isalnum, name))
        lens = Lens(f"{origin.rstrip('/')}/{_LENS}/{key}", view, larger)
        tracked, contents = lens.path, [*contents, lens.path]
    place, target = larger * view.eye, larger * view.target
    eye = rrb.EyeControls3D(position=place, look_target=target, eye_up=view.up, tracking_entity=tracked)
    shown = (LensView if lens else rrb.Spatial3DView)(
        name=name,
        origin=origin,
        contents=list(contents),
        background=rrb.Background(color=palette.GROUNDS[theme], kind=rrb.BackgroundKind.SolidColor),
        line_grid=False,
        eye_controls=eye,
        overrides=overrides,
    )
    if isinstance(shown, LensView) and lens:
        shown.lens = lens
    return shown


def surroundings(header: Header) -> list[str]:
    """Return the entities of the planes, walls and periodic box of the scene."""
    still = ((PLANES, header.planes), (SHAPES, header.shapes)) if not header.drives else ()
    parts = (*still, (WALLS, header.walls), (PERIODIC_BOX, header.box))
    return [*(path for path, part in parts if part is not None), *([f"{MOVING}/**"] if header.drives else [])]


def taken_from(sources: Mapping[str, str]) -> list[VisualizerComponentMapping]:
    """Map each component of a visualizer to the component of the entity that supplies it."""
    return [
        VisualizerComponentMapping(target, ComponentSourceKind.SourceComponent, source_component=source)
        for target, source in sources.items()
    ]
