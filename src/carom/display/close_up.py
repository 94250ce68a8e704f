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
from carom.display.body_colours import BodyColours
from carom.display.close_up_arrows import (
    BEFORE,
    EARLIER,
    IMPULSE,
    NORMAL,
    NORMAL_LENGTH,
    OFF,
    ROOT,
    SPIN,
    VELOCITY,
    VELOCITY_LENGTH,
    Contact,
    ShownPair,
    contact_of,
    impulse_radii,
)
from carom.display.close_up_camera import (
    ROOM,
    beside,
    direction,
    fit,
    followed,
    lengths,
    nearest_images,
    shown_whole,
)
from carom.display.legend_layout import DrawnLabels, Legend, MovieClock
from carom.display.letters import apart, beyond, label_width
from carom.display.margins import moving
from carom.display.request import ShownStep, at_impact
from carom.display.staging import axes_and_field
from carom.display.supplement import Static
from carom.recording.layout import FIELD, faint_bodies, is_crowded, subdued
from carom.recording.layout.canvas import (
    CORNERS,
    LEGEND,
    Area,
    CameraMotion,
    LensView,
    View,
    free_corner,
    spatial_view,
    surroundings,
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

BODIES, EDGE = f"{ROOT}/bodies", f"{ROOT}/edge"
FOLLOWED, LABELS = f"{ROOT}/followed", f"{ROOT}/labels"

_MOST_BYTES = 200_000_000  # largest size of the positions that are read to follow the bodies, in bytes
_THICK, _THIN = 0.07, 0.04  # radii of arrows, in radii of the smaller body
_REACH = 3.0  # ratio of the distance of an eye that follows points to half the diagonal of their box (Rerun 0.41)
_TOUCHING = 1e-9  # fraction of a radius; a smaller gap is rounding
_ALIKE = 0.08  # two shades have one hue if their shares of red, green and blue differ by at most this
_UNSEEN = 1e-6  # size of the invisible points that the camera follows, in radii of the smaller body


@dataclass(frozen=True, slots=True)
class CloseUp:
    """Two bodies at one step."""

    header: Header
    names: str  # numbers of the bodies, or of the body and the plane
    pair: ShownPair
    bodies: tuple[int, ...]  # numbers of the bodies; a single number if the body touches a plane
    step: ShownStep
    instant: ShownStep | None  # time of an impact within the step, at which normal, impulse and spins are drawn
    middle: FloatArray  # (3,) m, centre of the bodies as they are drawn
    paths: DrawnPaths | None
    times: FloatArray  # (frames,) s, times of the paths
    origin: FloatArray  # (3,) m, origin of the recording
    cell: Callable[[float], FloatArray | None]  # see `Header.cell`; the second body is drawn at its nearest image
    eye: View
    area: Area
    legend: Legend  # legend of the view; empty, unless the view is alone in a picture
    is_brief: bool  # whether the numbers are in a legend beside the view, so that labels in the view are short
    corner: tuple[int, int]  # corner of the legend
    poses: Sequence[View]  # poses of the camera at the times of a movie's clock

    def view(self, header: Header, recoloured: bool = False) -> rrb.Spatial3DView:
        """Return a view of the two bodies as solids, with all other bodies as thin wires."""
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
        """Return the bodies that a picture of a crowd shows: the pair, and bodies that touch it; () for all."""
        frame = (self.instant or self.step).frame
        if not self.is_brief or frame is None or not is_crowded(self.header):
            return ()
        pairs = frame.contacts.pairs
        ends = np.unique(pairs[np.isin(pairs, self.bodies).any(axis=1)])
        return [*{*self.bodies, *ends[ends < self.header.bodies].tolist()}]

    def statics(self) -> Iterable[Static]:
        """Yield sizes and colours of the entities."""
        radius = single(self.pair.radius)
        small = float(radius.min())
        yield (
            BODIES,
            rr.Ellipsoids3D.from_fields(
                half_sizes=np.repeat(radius, 3).reshape(-1, 3),
                colors=self.pair.colours.fixed,
                fill_mode="TransparentFillMajorWireframe",
                line_radii=rr.Radius.ui_points(1.0),
            ),
        )
        ink = palette.INKS[self.area.theme]
        impulse, spin = palette.legible([palette.ARROWS[paths.FORCE_NORMAL], palette.SPIN], self.area.theme).tolist()
        yield FOLLOWED, rr.Points3D.from_fields(radii=_UNSEEN * small, colors=palette.GROUNDS[self.area.theme])
        yield EDGE, rr.LineStrips3D.from_fields(radii=rr.Radius.ui_points(3.0), colors=palette.VERMILION)
        yield NORMAL, rr.Arrows3D.from_fields(radii=line_radii(_THIN, small), colors=palette.VERMILION)
        yield BEFORE, rr.Arrows3D.from_fields(radii=line_radii(_THIN, small), colors=EARLIER[self.area.theme])
        yield VELOCITY, rr.Arrows3D.from_fields(radii=line_radii(_THIN, small), colors=ink)
        yield IMPULSE, rr.Arrows3D.from_fields(radii=line_radii(_THICK, small), colors=impulse)
        yield SPIN, rr.Arrows3D.from_fields(radii=line_radii(_THIN, small), colors=spin)
        # as labels of the arrows, the texts would have the colours of the arrows
        yield LABELS, rr.Points3D.from_fields(radii=_UNSEEN * small, colors=ink, show_labels=True)
        yield from self._legend().statics

    def _legend(self) -> DrawnLabels:
        """Place legend and axes, which move with the camera of a movie."""
        drawn = self.legend.inside(self.eye, self.area, self.corner, self.poses)
        if not self.legend.entries:
            return drawn
        pair = self.pair
        axes = axes_and_field(pair.units, self.eye, self.area, None, pair.position, pair.radius, self.corner)
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

    def rows(self) -> Iterable[Rows]:
        """Yield the positions of the bodies at all frames, and the contact of the step."""
        colours, instant = self.pair.colours, self.instant
        yield from self._legend().rows
        if colours.fixed is None:
            columns = rr.Ellipsoids3D.columns(colors=colours.colours.ravel())
            index = Index(colours.steps, colours.times)
            each = columns.partition([len(self.bodies)] * len(index.steps))
            yield Rows(BODIES, index, each)
        if instant is not None and instant.frame is not None:
            turns = instant.frame.orientation
            turned = None if turns is None else turns[list(self.bodies)].astype(np.float32)
            yield from self._placed(Index.within_step(instant.time), self.pair.position[None], turned)
        yield from self._at_steps()
        if self.pair.contact is not None:
            yield from self._arrows(self.pair.contact)

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
        placed = np.stack([nearest_images(place, self.cell(time)) for place, time in places])
        centres = single(placed.reshape(-1, 3))
        turns = None if turned is None else turned.reshape(-1, 4)
        columns = rr.Ellipsoids3D.columns(centers=centres, quaternions=turns)
        yield Rows(BODIES, index, columns.partition([position.shape[1]] * len(position)))
        middle = placed.mean(axis=1) + (self.eye.target - self.middle)
        corner = np.full(3, self.eye.distance / _REACH / np.sqrt(3.0))
        ends = single(np.stack([middle - corner, middle + corner], axis=1).reshape(-1, 3))
        points = rr.Points3D.columns(positions=ends).partition([2] * len(position))
        yield Rows(FOLLOWED, index, points)

    def _arrows(self, contact: Contact) -> Iterable[Rows]:
        """Draw edge, normal, impulse and spins at the step, with labels; clear them at the next frame."""
        yield from self._once(EDGE, rr.LineStrips3D.columns(strips=[single(contact.edge)]), 1)
        labelled = self.pair.arrows(contact)
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
        named = [text if k < 0 else f"{self.pair.called[k]}: {text}" for text, k in zip(texts, owners, strict=True)]
        if len(self.bodies) == 2 and not self.is_brief and max(map(label_width, named), default=0.0) < self.area.width:
            texts = named
        wanted = np.concatenate([(a.origins + a.along * a.vectors)[: len(a.labels)] for a in labelled])
        if self.is_brief:
            ways = np.concatenate([a.off[: len(a.labels)] for a in labelled])
            wanted = beyond(wanted, ways, texts, self.eye, self.area)
        written = [k for k, text in enumerate(texts) if text]
        texts, wanted = [texts[k] for k in written], wanted[written]
        places = single(apart(wanted, texts, self.eye, self.area))
        yield from self._once(LABELS, rr.Points3D.columns(positions=places, labels=texts), len(texts))

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
        The colours of the pair's bodies.
    instant
        The time of an impact of the pair within the step. A pair that still touches at the end of the step is shown at
        that end.
    pauses_within
        Whether the viewer pauses at the instant.
    clock
        What the legend says about the time.
    explained
        Whether a legend is inside the view.
    brief
        Whether a legend beside the view states the numbers of the view.
    """
    bodies = pair.bodies
    places = [recording.shown.index(body) for body in bodies]
    called = names_of(recording)
    sizes = header.radius[places]
    short = [recording.bodies.name[body] or called.of(body) for body in bodies]  # titles and labels are short
    names = " and ".join(short)
    if pair.plane is not None:
        names += f" and {called.of(len(called.bodies) + pair.plane)}"
    at_end = nearest_images(step.position[places], header.cell(step.time))
    if not pauses_within and step.frame is not None:
        contact = contact_of(header, step.frame, pair, at_end, recording.origin)
        if contact is not None:  # the bodies may still touch
            other = contact.point if len(at_end) == 1 else at_end[1]
            near = (1.0 + _TOUCHING) * float(sizes.sum())
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
    position = nearest_images(drawn.position[places], header.cell(drawn.time))
    contact = None if frame is None else contact_of(header, frame, pair, position, recording.origin)
    found, times = None, np.zeros(0)
    if 28 * len(recording.shown) * recording.frames < _MOST_BYTES:
        found = drawn_paths(recording, places)
        times = times_of(recording, found.steps)
    seen, ends = position if pauses_within else at_end, None
    if contact is not None and np.any(contact.impulse):
        reach = impulse_radii(sizes)
        arrows = reach[reach > 0.0, None] * contact.impulse / np.linalg.norm(contact.impulse)
        ends = np.concatenate([seen[reach > 0.0] - arrows, seen[reach > 0.0] + arrows])
    if contact is not None:
        tip = contact.point + NORMAL_LENGTH * sizes.min() * contact.normal
        ends = tip[None] if ends is None else np.concatenate([ends, tip[None]])
    normal = None if contact is None else contact.normal
    turning = [each for each in (spin, spin_before) if each is not None]
    to_eye = direction(seen, normal, lengths(velocity), lengths(np.array(turning) if turning else None))
    aside = beside(fit(sizes, seen, to_eye).view(area.aspect), normal, spin)
    if velocity is not None:
        longest = float(np.linalg.norm(velocity, axis=2).max()) or 1.0
        # bodies that are not shown whole have no arrows of velocities
        whole = shown_whole(sizes)
        half = 0.5 * VELOCITY_LENGTH * sizes.min() * velocity[-1][whole] / longest
        off = seen[whole] + (OFF[1] + _THICK) * sizes[whole, None] * aside
        ends = np.concatenate([np.zeros((0, 3)) if ends is None else ends, off - half, off + half])
    colours = _told_apart(colours, area.theme)
    around = ends if ends is not None else np.zeros((0, 3))
    shown, radii = np.concatenate([seen, around]), np.pad(ROOM * sizes, (0, len(around)))

    of_all = None if instant is None or instant.frame is None else instant.frame.angular_impulse

    def eye_of(area: Area) -> View:
        return fit(sizes, seen, to_eye).view(area.aspect, narrow=area.rendered, tips=ends, inset=area.inset_share)

    made = CloseUp(
        header=header,
        poses=(),
        names=names,
        pair=ShownPair(
            called=short,
            radius=sizes,
            position=position,
            contact=contact,
            spin=spin,
            spin_before=spin_before,
            velocity=velocity,
            angular_impulse=None if of_all is None else of_all[places],
            aside=aside,
            colours=colours,
            theme=area.theme,
            units=header.units,
        ),
        bodies=tuple(places),
        step=step,
        instant=instant,
        middle=seen.mean(axis=0),
        paths=found,
        times=times,
        origin=recording.origin,
        cell=header.cell,
        eye=eye_of(area),
        area=area,
        legend=Legend([], area.theme),
        is_brief=brief,
        corner=CORNERS[0],
    )
    if explained:
        words = Legend(made.pair.lines(), area.theme).titled(header.title, clock).wrapped(area)
        area = replace(area, inset=words.size)
        eye = eye_of(area)
        corner = free_corner(eye, area.aspect, area.inset_share, shown, radii) or CORNERS[0]
        made = replace(made, eye=eye, area=area, legend=words, corner=corner)
    if not isinstance(clock, MovieClock) or found is None:
        return made
    eye = replace(made.eye, motion=CameraMotion.FOLLOW)
    which = np.maximum(np.searchsorted(times, clock.times, side="right") - 1, 0)
    paths_then = nearest_images(found.position[which].astype(np.float64), header.cell(drawn.time))
    half = 0.5 * eye.height() * min(1.0, area.aspect) - float(sizes.max())
    middle = seen.mean(axis=0)
    poses = [replace(eye, target=eye.target + followed(each, half) - middle) for each in paths_then]
    return replace(made, eye=eye, poses=poses)


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
