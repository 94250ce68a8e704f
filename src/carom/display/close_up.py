"""The close-up view: the two bodies of a contact with normal, impulse and spins; all other bodies are faint.

The entities of a close-up are not in the file; the viewer gets them in a `Supplement`. The bodies move through all
frames, and the camera follows them. The edge and the arrows show one step.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

from carom.arrays import FloatArray, SingleArray
from carom.contact_table import IMPACT_MODE
from carom.display.body_colours import BodyColours
from carom.display.legend import DrawnLabels, Legend, LegendLine, MovieClock, in_digits
from carom.display.letters import apart, beyond, label_width
from carom.display.margins import moving
from carom.display.request import ShownStep, at_impact
from carom.display.staging import axes_and_field
from carom.display.supplement import Static
from carom.physics.vector import minimum_images
from carom.recording.layout import FIELD, drawing, faint_bodies, is_crowded, subdued
from carom.recording.layout.camera import CameraFit
from carom.recording.layout.canvas import (
    CORNERS,
    LEGEND,
    UP,
    Area,
    CameraMotion,
    LensView,
    View,
    free_corner,
    spatial_view,
    surroundings,
    turned,
    views_of,
)
from carom.recording.layout.drawing import line_radii, single
from carom.recording.read.frame_rows import DrawnPaths, drawn_paths, times_of
from carom.recording.read.lookup import names_of
from carom.recording.read.named_events import Pair
from carom.recording.read.recording import Recording
from carom.recording.schema import palette, paths
from carom.recording.schema.header import Header, TimeScale
from carom.recording.write.rows import NO_STEPS, BatchColumn, Index, Rows
from carom.scene.units import dimension
from carom.scene.units.system import UnitSystem
from carom.state.frame import Frame

ROOT = "close_up"
BODIES, EDGE, NORMAL, IMPULSE, SPIN = (f"{ROOT}/{name}" for name in ("bodies", "edge", "normal", "impulse", "spin"))
BEFORE, VELOCITY = f"{ROOT}/velocity_before", f"{ROOT}/velocity"
FOLLOWED, LABELS = f"{ROOT}/followed", f"{ROOT}/labels"

_MOST_UNLIKE = 6.0  # ratio of radii above which the view shows only a part of the larger body
_MOST_BYTES = 200_000_000  # most bytes of positions that are read to follow the bodies
_ASIDE = 0.85  # fraction of the component along the normal that is subtracted from the direction to the eye
_USUAL = np.array([0.75, -1.0, 0.55]) / np.linalg.norm([0.75, -1.0, 0.55])  # towards the eye
_AROUND = np.radians([0, 30, -30, 60, -60, 90, -90, 120, -120, 150, -150, 180])  # from it, nearest first
_SEEN = 0.5  # least length on the screen, over its length, of an arrow that is no speck
_SHORT = 0.1  # of the longest arrow of its kind; a shorter arrow is a speck from anywhere
_NORMAL = 0.9  # length of the normal, in radii of the smaller body
_SPIN = 1.3  # length of the faster spin's arrow, in radii of the smaller body
_VELOCITY = 1.3  # length of the longest velocity's arrow, in radii of the smaller body
_OFF = (1.2, 1.55)  # distances of the velocities before and after an impact from the centre, in radii of their body
# vertical part of the normal on the screen; velocities stand beside steeper normals, and above flatter normals
_STEEP = 0.7
_IMPULSE = 1.6  # length of an impulse's arrow, in radii of its body
_ROOM = 1.35  # half size of the view around each body, in its radii
_THICK, _THIN = 0.07, 0.04  # radii of arrows, in radii of the smaller body
_REACH = 3.0  # distance of an eye that follows points, over half the diagonal of the box around them (Rerun 0.41)
_ROUNDING = 1e-9  # fraction of the faster spin; a spin below this fraction is rounding
_TOUCHING = 1e-9  # fraction of a radius; a smaller gap is rounding
# colour of velocities before an impact; velocities after it have the colour of ink
_EARLIER = {"dark": palette.GREY, "light": 0xB4BAC2FF}
# fraction of the approach speed; if speeds before an impact differ more, bodies have several impacts at an instant
_CHAINED = 0.01
_ALIKE = 0.08  # two shades have one hue if their shares of red, green and blue differ by at most this
_UNSEEN = 1e-6  # size of the invisible points that the camera follows, in radii of the smaller body


@dataclass(frozen=True, slots=True)
class Contact:
    """The contact of the two bodies in the shown step."""

    point: FloatArray  # (3,) m from the recording's origin
    normal: FloatArray  # (3,) unit vector from i to j, or out of a plane or wall, like the impulse on the body
    approach_speed: float  # m/s
    impulse: FloatArray  # (3,) N s, on j
    force: float | None  # N, the impulse over the step; None for an impact
    edge: FloatArray  # (2, 3) m

    @property
    def friction(self) -> float:
        """The size of the impulse of friction in N s."""
        return float(np.linalg.norm(self.impulse - (self.impulse @ self.normal) * self.normal))


@dataclass(frozen=True, slots=True)
class _Arrows:
    """Arrows of one entity, of which the first few have labels."""

    path: str  # empty if only their labels are drawn
    origins: FloatArray  # (n, 3) m
    vectors: FloatArray  # (n, 3) m
    labels: list[str]
    along: float = 1.0  # position of the labels, from 0 at the origins to 1 at the tips
    bodies: Sequence[int] = ()  # places of the bodies that the labels belong to, in the close-up
    short: Sequence[str] = ()  # labels in a view whose legend has the other labels
    way: FloatArray | None = None  # (3,) in which the short labels are off the arrows; by default on beyond their tips


@dataclass(frozen=True, slots=True)
class CloseUp:
    """Two bodies at one step."""

    header: Header
    names: str  # numbers of the bodies, or of the body and the plane
    called: Sequence[str]  # (b,) names of the bodies, or their numbers
    bodies: tuple[int, ...]  # numbers of the bodies; a single number if the body touches a plane
    step: ShownStep
    instant: ShownStep | None  # time of an impact within the step, at which normal, impulse and spins are drawn
    position: FloatArray  # (b, 3) m, where normal, impulse and spins are drawn
    contact: Contact | None  # None if the bodies do not touch in this step, or if the contacts of the step are unknown
    spin: FloatArray | None  # (b, 3) rad/s; at an instant, after the impact
    spin_before: FloatArray | None  # (b, 3) rad/s, before the impact of an instant
    velocity: FloatArray | None  # (1, b, 3) m/s or, before and after the impact of an instant, (2, b, 3)
    middle: FloatArray  # (3,) m, centre of the bodies as they are drawn
    paths: DrawnPaths | None
    times: FloatArray  # (frames,) s, times of the paths
    origin: FloatArray  # (3,) m, origin of the recording
    cell: Callable[[float], FloatArray | None]  # see `Header.cell`; the second body is drawn at its nearest image
    eye: View
    colours: BodyColours  # colours of the bodies, which are the same in the other views
    area: Area
    legend: Legend  # legend of the view; empty, unless the view is alone in a picture
    is_brief: bool  # whether the numbers are in a legend beside the view, so that labels in the view are short
    corner: tuple[int, int]  # corner of the legend
    # (3,) unit vector across the normal on the screen, along which velocities are drawn off their bodies
    aside: FloatArray
    poses: Sequence[View]  # poses of the camera at the times of a movie's clock

    def view(self, header: Header, recoloured: bool = False) -> rrb.Spatial3DView:
        """Return a view of the two bodies as solids, with all others as thin wires."""
        arrows = NORMAL, IMPULSE, SPIN, BEFORE, VELOCITY
        contents = [BODIES, FOLLOWED, EDGE, *arrows, LABELS, paths.BODIES, *surroundings(header)]
        contents += [f"{LEGEND}/**", f"{FIELD}/**"] if self.legend.entries else []
        return spatial_view(
            *(
                f"Close-up: {self.names}",
                self.eye,
                contents,
                faint_bodies(header, recoloured, subdued(header, self.area.theme), self._neighbours()),
            ),
            follows=FOLLOWED,
            theme=self.area.theme,
        )

    def _neighbours(self) -> Sequence[int]:
        """Return the bodies that a picture of a crowd shows: those that touch one of the pair; () for all."""
        frame = (self.instant or self.step).frame
        if not self.is_brief or frame is None or not is_crowded(self.header):
            return ()
        pairs = frame.contacts.pairs
        ends = np.unique(pairs[np.isin(pairs, self.bodies).any(axis=1)])
        return [*{*self.bodies, *ends[ends < self.header.bodies].tolist()}]

    def statics(self, header: Header) -> Iterable[Static]:
        """Yield sizes and colours of the entities."""
        radius = single(header.radius[list(self.bodies)])
        small = float(radius.min())
        yield (
            BODIES,
            rr.Ellipsoids3D.from_fields(
                half_sizes=np.repeat(radius, 3).reshape(-1, 3),
                colors=self.colours.fixed,
                fill_mode="TransparentFillMajorWireframe",
                line_radii=rr.Radius.ui_points(1.0),
            ),
        )
        ink = palette.INKS[self.area.theme]
        impulse, spin = palette.legible([palette.ARROWS[paths.FORCE_NORMAL], palette.SPIN], self.area.theme).tolist()
        yield FOLLOWED, rr.Points3D.from_fields(radii=_UNSEEN * small, colors=palette.GROUNDS[self.area.theme])
        yield EDGE, rr.LineStrips3D.from_fields(radii=rr.Radius.ui_points(3.0), colors=palette.VERMILION)
        yield NORMAL, rr.Arrows3D.from_fields(radii=line_radii(_THIN, small), colors=palette.VERMILION)
        yield BEFORE, rr.Arrows3D.from_fields(radii=line_radii(_THIN, small), colors=_EARLIER[self.area.theme])
        yield VELOCITY, rr.Arrows3D.from_fields(radii=line_radii(_THIN, small), colors=ink)
        yield IMPULSE, rr.Arrows3D.from_fields(radii=line_radii(_THICK, small), colors=impulse)
        yield SPIN, rr.Arrows3D.from_fields(radii=line_radii(_THIN, small), colors=spin)
        # on the arrows themselves, the labels would have their colours
        yield LABELS, rr.Points3D.from_fields(radii=_UNSEEN * small, colors=ink, show_labels=True)
        yield from self._legend().statics

    def _legend(self) -> DrawnLabels:
        """Place legend and axes, which move with the camera of a movie."""
        drawn = self.legend.inside(self.eye, self.area, self.corner, self.poses)
        if not self.legend.entries:
            return drawn
        radius = self.header.radius[list(self.bodies)]
        axes = axes_and_field(self.header.units, self.eye, self.area, None, self.position, radius, self.corner)
        statics = [*drawn.statics, *axes]
        if self.legend.clock is None:
            return DrawnLabels(statics, drawn.rows)
        still = moving(statics, self.eye, self.poses, self.legend.clock.times)
        return DrawnLabels(still.statics, [*drawn.rows, *still.rows])

    def camera_rows(self, layout: rrb.Blueprint) -> Iterable[Rows]:
        """Yield the poses of the camera of a movie."""
        for shown in views_of(layout.root_container):
            if isinstance(shown, LensView) and self.legend.clock is not None:
                yield Rows(shown.lens.path, Index(NO_STEPS, self.legend.clock.times), shown.lens.poses(self.poses))

    def rows(self, header: Header) -> Iterable[Rows]:
        """Yield the positions of the bodies at all frames, and the contact of the step."""
        colours, instant = self.colours, self.instant
        yield from self._legend().rows
        if colours.fixed is None:
            columns = rr.Ellipsoids3D.columns(colors=colours.colours.ravel())
            index = Index(colours.steps, colours.times)
            each = columns.partition([len(self.bodies)] * len(index.steps))
            yield Rows(BODIES, index, each)
        if instant is not None and instant.frame is not None:
            turns = instant.frame.orientation
            turned = None if turns is None else turns[list(self.bodies)].astype(np.float32)
            yield from self._placed(Index.within_step(instant.time), self.position[None], turned)
        yield from self._at_steps()
        if self.contact is not None:
            yield from self._arrows(self.contact, header)

    def _at_steps(self) -> Iterable[Rows]:
        """Place the bodies, and the points that the camera follows, at all frames and repeated steps."""
        step, chosen = self.step, list(self.bodies)
        if self.paths is None:
            turned = None
            if step.frame is not None and step.frame.orientation is not None:
                turned = step.frame.orientation[chosen].astype(np.float32)
            index = Index(np.array([step.step]), np.array([step.time]))
            yield from self._placed(index, step.position[None, chosen], turned)
            return
        yield from self._placed(Index(self.paths.steps, self.times), self.paths.position, self.paths.orientation)
        recorded = set(self.paths.steps.tolist())
        frames = [frame for frame in step.added if frame.step not in recorded]
        if frames:
            position = np.stack([frame.position[chosen] - self.origin for frame in frames])
            turns = [frame.orientation[chosen] for frame in frames if frame.orientation is not None]
            turned = np.concatenate(turns).astype(np.float32) if turns else None
            yield from self._placed(Index.of(frames), position, turned)

    def _placed(self, index: Index, position: NDArray[np.floating], turned: SingleArray | None) -> Iterable[Rows]:
        """Place the bodies at (frames, b, 3) m, and two points around them that set the distance of the camera."""
        places = zip(position.astype(np.float64), index.times.tolist(), strict=True)
        placed = np.stack([_nearest_images(place, self.cell(time)) for place, time in places])
        centres = single(placed.reshape(-1, 3))
        turns = None if turned is None else turned.reshape(-1, 4)
        columns = rr.Ellipsoids3D.columns(centers=centres, quaternions=turns)
        yield Rows(BODIES, index, columns.partition([position.shape[1]] * len(position)))
        middle = placed.mean(axis=1) + (self.eye.target - self.middle)
        corner = np.full(3, self.eye.distance / _REACH / np.sqrt(3.0))
        ends = single(np.stack([middle - corner, middle + corner], axis=1).reshape(-1, 3))
        points = rr.Points3D.columns(positions=ends).partition([2] * len(position))
        yield Rows(FOLLOWED, index, points)

    def _arrows(self, contact: Contact, header: Header) -> Iterable[Rows]:
        """Draw edge, normal, impulse and spins at the step, with labels; clear them at the next frame."""
        yield from self._once(EDGE, rr.LineStrips3D.columns(strips=[single(contact.edge)]), 1)
        labelled = self._labelled(contact, header)
        for arrows in labelled:
            if arrows.path and len(arrows.vectors):
                columns = rr.Arrows3D.columns(vectors=single(arrows.vectors), origins=single(arrows.origins))
                yield from self._once(arrows.path, columns, len(arrows.vectors))
        if self.legend.entries:  # the legend has the numbers
            return
        if self.is_brief:
            labelled = [replace(arrows, labels=list(arrows.short)) for arrows in labelled]
        # with two bodies, a label begins with the name of its body if there is space
        texts = [text for arrows in labelled for text in arrows.labels]
        owners = [arrows.bodies[k] if arrows.bodies else -1 for arrows in labelled for k in range(len(arrows.labels))]
        named = [text if k < 0 else f"{self.called[k]}: {text}" for text, k in zip(texts, owners, strict=True)]
        if len(self.bodies) == 2 and not self.is_brief and max(map(label_width, named), default=0.0) < self.area.width:
            texts = named
        wanted = np.concatenate([(a.origins + a.along * a.vectors)[: len(a.labels)] for a in labelled])
        if self.is_brief:
            ways = np.concatenate([np.broadcast_to(_way(a), a.vectors.shape)[: len(a.labels)] for a in labelled])
            wanted = beyond(wanted, ways, texts, self.eye, self.area)
        written = [k for k, text in enumerate(texts) if text]
        texts, wanted = [texts[k] for k in written], wanted[written]
        places = single(apart(wanted, texts, self.eye, self.area))
        yield from self._once(LABELS, rr.Points3D.columns(positions=places, labels=texts), len(texts))

    def _labelled(self, contact: Contact, header: Header) -> list[_Arrows]:
        """Return normal, impulses, spins, angular impulses and velocities, with their numbers."""
        small = float(header.radius[list(self.bodies)].min())
        label = "normal"
        if contact.force is None and contact.approach_speed > 0.0:  # bodies in lasting contact do not approach
            label += f", approach {header.units.text(contact.approach_speed, dimension.VELOCITY, '.3g')}"
        return [
            _Arrows(NORMAL, contact.point[None], _NORMAL * small * contact.normal[None], [label], 0.5),
            self._impulses(contact, header),
            self._spins(small, header.units),
            self._angular_impulses(contact, header),
            *self._velocities(small),
        ]

    def _velocities(self, small: float) -> Iterable[_Arrows]:
        """Yield the velocities before an impact, and then the velocities after it or, without an impact, of the step.

        They stand beside their bodies, where no impulse is; a body that is too large to be shown whole has none.
        """
        if self.velocity is None:
            return
        speeds = np.linalg.norm(self.velocity, axis=2)
        whole = _impulse_radii(self.header.radius[list(self.bodies)]) > 0.0
        for path, velocity, speed, off in zip(
            (BEFORE, VELOCITY)[-len(speeds) :], self.velocity, speeds, _OFF[-len(speeds) :], strict=True
        ):
            moving = whole & (speed > _ROUNDING * speeds.max())
            vectors = _VELOCITY * small * velocity[moving] / (speeds.max() or 1.0)
            apart = off * self.header.radius[list(self.bodies)][moving, None]
            texts = [in_digits(self.header.units, each, dimension.VELOCITY) for each in speed[moving].tolist()]
            short = texts if path == VELOCITY else []
            start = self.position[moving] + apart * self.aside - 0.5 * vectors
            yield _Arrows(path, start, vectors, [], 0.5, short=short, way=self.aside)

    def _speeds(self) -> list[str]:
        """Return a text for each body: its speed or, at an impact, its speeds before and after."""
        if self.velocity is None:
            return []
        speeds = np.linalg.norm(self.velocity, axis=2)
        speeds[speeds <= _ROUNDING * speeds.max(initial=0.0)] = 0.0
        texts = [in_digits(self.header.units, speed, dimension.VELOCITY) for speed in speeds[-1].tolist()]
        if len(speeds) == 1:
            return [f"speed {text}" for text in texts]
        first = [self.header.units.shown(speed, dimension.VELOCITY) for speed in speeds[0].tolist()]
        return [f"speed {one:.3g} before, {last} after" for one, last in zip(first, texts, strict=True)]

    def speed_lines(self) -> list[LegendLine]:
        """Return the lines about velocities of a legend beside all views, in the colours of this view."""
        named = zip(self.called, self._speeds(), self._hues(self.area.theme), strict=False)
        lines = [LegendLine(f"■ {name} close up: {text}", hue) for name, text, hue in named]
        return lines + self._velocity_lines(self.area.theme, ", close up")

    def _hues(self, theme: str) -> list[int]:
        """Return the colours (b,) of the bodies; ink if they change with time."""
        fixed = self.colours.fixed
        return [palette.INKS[theme]] * len(self.bodies) if fixed is None else fixed.tolist()

    def lines(self, theme: str) -> list[LegendLine]:
        """Return the lines of a legend about this view: each body with its numbers, and the arrows with numbers."""
        colours, units = self._hues(theme), self.header.units
        arrows = [] if self.contact is None else self._labelled(self.contact, self.header)
        speeds, entries = self._speeds(), list[LegendLine]()
        for place, (name, colour) in enumerate(zip(self.called, colours, strict=True)):
            own = [a.labels[a.bodies.index(place)] for a in arrows if a.labels and place in a.bodies]
            entries.append(LegendLine(f"■ {name}", colour))
            texts = (*speeds[place : place + 1], *own)
            entries += [LegendLine(f"    {text}", colour, is_extra=True) for text in texts]
        if self.contact is None:
            return entries
        if self.velocity is not None and len(self.velocity) > 1 and len(self.bodies) > 1:
            apart = float((self.velocity[0, 0] - self.velocity[0, 1]) @ self.contact.normal)
            if abs(apart - self.contact.approach_speed) > _CHAINED * self.contact.approach_speed:
                entries.append(LegendLine("before and after all impacts of this instant", palette.GREY))
        normal, impulse, spin, *_ = arrows
        entries.append(LegendLine(f"→ {normal.labels[0]}; — line of centres", palette.VERMILION))
        if impulse.labels:
            text = f"→ impulse on each body, {impulse.labels[0]}"
            entries.append(LegendLine(text, palette.ARROWS[paths.FORCE_NORMAL]))
        if spin.labels:
            fastest = units.text(self.spin_of_scale, dimension.ANGULAR_VELOCITY, ".3g")
            scale = f", {_SPIN} radii = {fastest}" if self.spin_of_scale > 0.0 else ""
            entries.append(LegendLine(f"→ spin{scale}", palette.SPIN))
        return entries + self._velocity_lines(theme)

    def _velocity_lines(self, theme: str, where: str = "") -> list[LegendLine]:
        """Return the lines of a legend about the arrows of velocities."""
        if self.contact is None or self.velocity is None:
            return []
        drawn = {each.path for each in self._velocities(1.0) if len(each.vectors)}
        longest = float(np.linalg.norm(self.velocity, axis=2).max(initial=0.0))
        scale = f"{_VELOCITY} radii = {self.header.units.text(longest, dimension.VELOCITY, '.3g')}"
        after = " after" if len(self.velocity) > 1 else ""
        lines = {
            BEFORE: LegendLine(f"→ velocity before{where}", _EARLIER[theme]),
            VELOCITY: LegendLine(f"→ velocity{after}{where}: {scale}", palette.INKS[theme]),
        }
        return [line for path, line in lines.items() if path in drawn]

    def _explained(self, clock: MovieClock | str, theme: str) -> Legend:
        """Return the legend of the view alone."""
        return Legend(self.lines(theme), theme).titled(self.header.title, clock)

    def _impulses(self, contact: Contact, header: Header) -> _Arrows:
        """Return the impulse on each body from its centre; if one is many times larger, only on the smaller."""
        size = float(np.linalg.norm(contact.impulse))
        reach = _impulse_radii(header.radius[list(self.bodies)])
        drawn = (reach > 0.0) & (size > 0.0)
        signs = np.array([-1.0, 1.0])[: len(reach)]
        vectors = (reach * signs)[drawn, None] * contact.impulse / (size or 1.0)
        if not drawn.any():
            return _Arrows(IMPULSE, self.position[drawn], vectors, [])
        text = in_digits(header.units, size, dimension.IMPULSE)
        together = ", friction included" if contact.friction > _ROUNDING * size else ""  # tables list the normal one
        if contact.force is None:
            return _Arrows(IMPULSE, self.position[drawn], vectors, [text + together], short=[text])
        force = in_digits(header.units, contact.force, dimension.FORCE)
        labels = [f"{force}{together}, {text} in the step"]
        return _Arrows(IMPULSE, self.position[drawn], vectors, labels, short=[force])

    def _spin_speeds(self) -> FloatArray:
        """Return the spins (2, b) rad/s before and after the impact of an instant, otherwise twice the same."""
        after = np.zeros((len(self.bodies), 3)) if self.spin is None else self.spin
        before = after if self.spin_before is None else self.spin_before
        speeds: FloatArray = np.linalg.norm([before, after], axis=2)
        speeds[speeds <= _ROUNDING * speeds.max()] = 0.0
        return speeds

    @property
    def spin_of_scale(self) -> float:
        """The spin (rad/s) whose arrow is 1.3 radii long; 0 if no arrow has a length."""
        speeds = self._spin_speeds()
        return float(speeds.max()) if speeds[1].any() else 0.0

    def _spins(self, small: float, units: UnitSystem) -> _Arrows:
        speeds = self._spin_speeds()
        after = np.zeros((len(self.bodies), 3)) if self.spin is None else self.spin
        turning = np.asarray(speeds.max(axis=0)) > 0.0
        vectors = _SPIN * small * after[turning] / (speeds.max() or 1.0)
        unit = dimension.ANGULAR_VELOCITY
        labels = [units.text(last, unit, ".3g") for last in speeds[1].tolist()]
        short = [label if last > 0.0 else "" for label, last in zip(labels, speeds[1].tolist(), strict=True)]
        if self.spin_before is None:
            labels = [f"spin {label}" for label in labels]
        else:
            first = [units.shown(speed, unit) for speed in speeds[0].tolist()]
            labels = [f"spin {one:.3g} before, {last} after" for one, last in zip(first, labels, strict=True)]
        places: list[int] = np.flatnonzero(turning).tolist()
        labels, short = ([texts[place] for place in places] for texts in (labels, short))
        return _Arrows(SPIN, self.position[turning], vectors, labels, bodies=places, short=short)

    def _angular_impulses(self, contact: Contact, header: Header) -> _Arrows:
        """Return the labels of the angular impulses of an impact, parallel to the changes of the spins."""
        size, whole = contact.friction, float(np.linalg.norm(contact.impulse))
        if contact.force is not None or self.spin is None or size <= _ROUNDING * whole:
            return _Arrows("", np.zeros((0, 3)), np.zeros((0, 3)), [])
        of_all = None if self.instant is None or self.instant.frame is None else self.instant.frame.angular_impulse
        values = size * header.radius[list(self.bodies)]  # |r × J| about the centre of each body
        # a body may have several impacts at one instant, and the spins are the spins after all these impacts
        if of_all is not None:
            values = drawing.magnitudes(of_all[list(self.bodies)])
        texts = [
            f"angular impulse {in_digits(header.units, value, dimension.ANGULAR_IMPULSE)}" for value in values.tolist()
        ]
        return _Arrows("", self.position, np.zeros_like(self.position), texts, bodies=range(len(texts)))

    def _once(self, path: str, columns: rr.ComponentColumnList, count: int) -> Iterable[Rows]:
        """Yield a row at the step or at the instant, and then an empty row, which clears it."""
        if self.instant is not None:
            empty = Index(np.array([self.step.step]), np.array([self.step.time]))
            parts = columns.partition([count, 0])
            both = [(column.component_descriptor(), column.as_arrow_array()) for column in parts]
            for row, index in enumerate((Index.within_step(self.instant.time), empty)):
                yield Rows(path, index, [BatchColumn.of_rows(what, rows.slice(row, 1)) for what, rows in both])
            return
        steps, times, each = [self.step.step], [self.step.time], [count]
        following = next((frame for frame in self.step.added if frame.step > self.step.step), None)
        later = np.flatnonzero(self.times > self.step.time)
        if following is not None:
            steps, times = [*steps, following.step], [*times, following.time]
        elif self.paths is not None and len(later):
            row = int(later[0])
            steps, times = [*steps, int(self.paths.steps[row])], [*times, float(self.times[row])]
        yield Rows(path, Index(np.array(steps), np.array(times)), columns.partition(each + [0] * (len(steps) - 1)))


def close_up(
    recording: Recording,
    header: Header,
    step: ShownStep,
    pair: Pair,
    area: Area,
    colours: BodyColours,
    instant: ShownStep | None = None,
    *,
    pauses_within: bool = False,
    clock: MovieClock | str = "",
    explained: bool = False,
    brief: bool = False,
) -> CloseUp:
    """Make the close-up view of a pair at a step.

    Parameters
    ----------
    colours
        Of the bodies of the pair.
    instant
        The time of an impact of the pair within the step. A pair that still touches at the end of the step is shown
        there.
    pauses_within
        Whether the viewer pauses at the instant.
    clock
        What the legend says about the time.
    explained
        Whether a legend is inside the view.
    brief
        Whether the legend beside the view has its numbers.
    """
    bodies = pair.bodies
    places = [recording.shown.index(body) for body in bodies]
    called = names_of(recording)
    short = [recording.bodies.name[body] or called.of(body) for body in bodies]  # titles and labels are short
    names = " and ".join(short)
    if pair.plane is not None:
        names += f" and {called.of(len(called.bodies) + pair.plane)}"
    at_end = _nearest_images(step.position[places], header.cell(step.time))
    if not pauses_within and step.frame is not None:
        contact = _contact(header, step.frame, pair, at_end, recording.origin)
        if contact is not None:  # the bodies may still touch
            other = contact.point if len(at_end) == 1 else at_end[1]
            near = (1.0 + _TOUCHING) * float(header.radius[places].sum())
            instant = None if float(np.linalg.norm(other - at_end[0])) <= near else instant
    drawn = instant or step
    frame, spin, spin_before = drawn.frame, None, None
    clock_of = TimeScale(float(recording.info["time_scale"]))
    ended = None if instant else at_impact(step, pair, header, recording.origin, step.time, clock_of, at_end=True)
    velocity = drawn.velocities if ended is None else ended.velocities
    if velocity is None and frame is not None:
        velocity = frame.velocity[None, list(bodies)]
    jumps = drawn.state if ended is None else ended.state
    if jumps is not None:
        spin_before, spin = (None, None) if jumps.spins is None else jumps.spins
    elif frame is not None and frame.angular_velocity is not None:
        spin = frame.angular_velocity[list(bodies)]
    position = _nearest_images(drawn.position[places], header.cell(drawn.time))
    contact = None if frame is None else _contact(header, frame, pair, position, recording.origin)
    found, times = None, np.zeros(0)
    if 28 * len(recording.shown) * recording.frames < _MOST_BYTES:
        found = drawn_paths(recording, places)
        times = times_of(recording, found.steps)
    seen, ends = position if pauses_within else at_end, None
    if contact is not None and np.any(contact.impulse):
        reach = _impulse_radii(header.radius[places])
        arrows = reach[reach > 0.0, None] * contact.impulse / np.linalg.norm(contact.impulse)
        ends = np.concatenate([seen[reach > 0.0] - arrows, seen[reach > 0.0] + arrows])
    if contact is not None:
        tip = contact.point + _NORMAL * header.radius[places].min() * contact.normal
        ends = tip[None] if ends is None else np.concatenate([ends, tip[None]])
    turning = [each for each in (spin, spin_before) if each is not None]
    to_eye = _direction(seen, contact, _lengths(velocity), _lengths(np.array(turning) if turning else None))
    aside = _beside(_fit(header.radius[places], seen, to_eye).view(area.aspect), contact, spin)
    if velocity is not None:
        longest = float(np.linalg.norm(velocity, axis=2).max()) or 1.0
        # bodies that are not shown whole have no arrows of velocities
        whole = _impulse_radii(header.radius[places]) > 0.0
        half = 0.5 * _VELOCITY * header.radius[places].min() * velocity[-1][whole] / longest
        off = seen[whole] + (_OFF[1] + _THICK) * header.radius[places][whole, None] * aside
        ends = np.concatenate([np.zeros((0, 3)) if ends is None else ends, off - half, off + half])
    colours = _told_apart(colours, area.theme)
    sizes, around = header.radius[places], ends if ends is not None else np.zeros((0, 3))
    shown, radii = np.concatenate([seen, around]), np.pad(_ROOM * sizes, (0, len(around)))

    def eye_of(area: Area) -> View:
        return _fit(sizes, seen, to_eye).view(area.aspect, narrow=area.rendered, tips=ends, inset=area.inset_share)

    made = CloseUp(
        header=header,
        poses=(),
        names=names,
        called=short,
        bodies=tuple(places),
        step=step,
        instant=instant,
        position=position,
        contact=contact,
        spin=spin,
        spin_before=spin_before,
        velocity=velocity,
        middle=seen.mean(axis=0),
        paths=found,
        times=times,
        origin=recording.origin,
        cell=header.cell,
        eye=eye_of(area),
        colours=colours,
        area=area,
        legend=Legend([], area.theme),
        is_brief=brief,
        aside=aside,
        corner=CORNERS[0],
    )
    if explained:
        words = made._explained(clock, area.theme).wrapped(area)
        area = replace(area, inset=words.size)
        eye = eye_of(area)
        corner = free_corner(eye, area.aspect, area.inset_share, shown, radii) or CORNERS[0]
        made = replace(made, eye=eye, area=area, legend=words, corner=corner)
    if not isinstance(clock, MovieClock) or found is None:
        return made
    eye = replace(made.eye, motion=CameraMotion.FOLLOW)
    which = np.maximum(np.searchsorted(times, clock.times, side="right") - 1, 0)
    paths_then = _nearest_images(found.position[which].astype(np.float64), header.cell(drawn.time))
    half = 0.5 * eye.height() * min(1.0, area.aspect) - float(sizes.max())
    middle = seen.mean(axis=0)
    poses = [replace(eye, target=eye.target + _followed(each, half) - middle) for each in paths_then]
    return replace(made, eye=eye, poses=poses)


def _beside(eye: View, contact: Contact | None, spin: FloatArray | None) -> FloatArray:
    """Return the direction (3,) across the normal on the screen in which no spin points: up, right, down or left."""
    right, up = eye.axes()
    across = up if contact is None or abs(contact.normal @ up) < _STEEP else right
    return np.asarray(across if spin is None or spin.sum(axis=0) @ across <= 0.0 else -across)


def _way(arrows: _Arrows) -> FloatArray:
    """Return the directions in which short labels are off their arrows."""
    return arrows.vectors if arrows.way is None else arrows.way


def _told_apart(colours: BodyColours, theme: str) -> BodyColours:
    """Return colours by which two bodies can be told apart: their own, unless these are shades of one hue.

    Colours that change with time, such as colours by speed, have a meaning, so this function leaves them unchanged.
    """
    fixed = colours.fixed
    if fixed is None or len(fixed) < 2 or not _alike(int(fixed[0]), int(fixed[1])):
        return colours
    others = palette.legible([palette.SKY, palette.CLAY, palette.INDIGO], theme)
    rest = [int(other) for other in others if not _alike(int(other), int(fixed[0]))]
    return BodyColours(colours.steps, colours.times, np.array([[fixed[0], rest[0]]], dtype=np.uint32))


def _alike(one: int, another: int) -> bool:
    """Return whether two colours are shades of one hue."""
    channels = np.array([[colour >> shift & 0xFF for shift in (24, 16, 8)] for colour in (one, another)], dtype=float)
    shares = channels / channels.sum(axis=1, keepdims=True).clip(1.0)
    return bool(np.abs(shares[0] - shares[1]).max() <= _ALIKE)


def _followed(position: FloatArray, half: float) -> FloatArray:
    """Return the point (3,) m that a camera follows, so that bodies at (b, 3) m are within ``half`` (m) of it.

    If two bodies are too far apart, the point is near the first body.
    """
    apart = position.mean(axis=0) - position[0]
    far = float(np.linalg.norm(apart))
    return np.asarray(position[0] + apart * min(1.0, half / far) if far > 0.0 else position[0])


def _impulse_radii(radius: FloatArray) -> FloatArray:
    """Return the lengths (b,) m of the arrows of impulses; 0 for a body that is too large to be shown whole."""
    return np.asarray(_IMPULSE * radius * (radius <= _MOST_UNLIKE * radius.min()))


def _lengths(vectors: FloatArray | None) -> FloatArray:
    """Return the arrows (k, 3) of vectors (..., 3) that are not short, over the length of the longest."""
    if vectors is None:
        return np.zeros((0, 3))
    each = vectors.reshape(-1, 3)
    sizes = drawing.magnitudes(each)
    longest = float(sizes.max(initial=0.0))
    return np.asarray(each[sizes > _SHORT * longest] / longest if longest > 0.0 else np.zeros((0, 3)))


def _direction(position: FloatArray, contact: Contact | None, *arrows: FloatArray) -> FloatArray | None:
    """Choose the direction to the eye of bodies at (b, 3) m: the usual one, or the nearest that shows all arrows.

    It is nearly perpendicular to the normal. ``arrows`` are (k, 3) each. Without a normal, the camera chooses.
    """
    normal = None if contact is None else contact.normal
    if len(position) == 2 and normal is None:
        apart = position[1] - position[0]
        normal = apart / max(float(np.linalg.norm(apart)), np.finfo(float).tiny)
    if normal is None:
        return None
    ways = np.stack([turned(_USUAL, UP, angle) for angle in _AROUND])
    ways -= _ASIDE * (ways @ normal)[:, None] * normal
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    drawn = np.concatenate(arrows)
    towards = np.abs(ways @ (drawn / np.linalg.norm(drawn, axis=1, keepdims=True)).T)
    seen = np.sqrt(1.0 - np.minimum(towards, 1.0) ** 2).min(axis=1, initial=1.0)
    return np.asarray(ways[int(np.argmax(np.minimum(seen, _SEEN)))])


def _fit(radius: FloatArray, position: FloatArray, to_eye: FloatArray | None) -> CameraFit:
    """Fit the camera to both bodies; if one is many times larger, to the smaller."""
    if radius.max() > _MOST_UNLIKE * radius.min():
        place = [int(np.argmin(radius))]
        return CameraFit(3.0 * radius[place], position[place], to_eye=to_eye)
    return CameraFit(_ROOM * radius, position, to_eye=to_eye)


def _nearest_images(position: FloatArray, box: FloatArray | None) -> FloatArray:
    """Return positions, (..., b, 3) m: of the first body, and of each other body's image nearest to the first."""
    if box is None:
        return position
    first = position[..., :1, :]
    return first + minimum_images(position - first, box)


def _contact(header: Header, frame: Frame, pair: Pair, position: FloatArray, origin: FloatArray) -> Contact | None:
    """Find the contact of a pair at (b, 3) m in a step; among contacts with planes, the largest impulse decides."""
    rows, n = frame.contact_rows, header.bodies
    if rows is None:
        return None
    found = rows[(rows["i"] == pair.i) & (rows["j"] >= n if pair.j is None else rows["j"] == pair.j)]
    if len(found) == 0:
        return None
    row = found[int(np.argmax(found["normal_impulse"]))]
    normal = np.array([row["nx"], row["ny"], row["nz"]])
    place = np.array([row["x"], row["y"], row["z"]]) - origin
    point = _nearest_images(np.stack([position[0], place]), header.cell(frame.time))[1]
    end = point if pair.j is None else position[1]
    impulse = row["normal_impulse"] * normal + [row["friction_x"], row["friction_y"], row["friction_z"]]
    rests = row["mode"] != IMPACT_MODE and frame.dt > 0.0
    force = float(np.linalg.norm(impulse)) / frame.dt if rests else None
    outward = -normal if pair.j is None else normal
    return Contact(point, outward, float(row["approach_speed"]), impulse, force, np.stack([position[0], end]))
