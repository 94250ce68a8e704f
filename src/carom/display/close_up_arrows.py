"""The arrows of a close-up, with their numbers: normal, impulse, spins and velocities of two bodies."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from carom.arrays import FloatArray
from carom.contact_table import IMPACT_MODE
from carom.display.body_colours import BodyColours
from carom.display.close_up_camera import nearest_images, shown_whole
from carom.display.legend import in_digits
from carom.display.legend_layout import LegendLine
from carom.recording.layout import drawing
from carom.recording.read.named_events import Pair
from carom.recording.schema import palette, paths
from carom.recording.schema.header import Header
from carom.scene.units import dimension
from carom.scene.units.system import UnitSystem
from carom.state.frame import Frame

ROOT = "close_up"
NORMAL, IMPULSE, SPIN = (f"{ROOT}/{name}" for name in ("normal", "impulse", "spin"))
BEFORE, VELOCITY = f"{ROOT}/velocity_before", f"{ROOT}/velocity"

NORMAL_LENGTH = 0.9  # length of the normal, in radii of the smaller body
_SPIN = 1.3  # length of the faster spin's arrow, in radii of the smaller body
VELOCITY_LENGTH = 1.3  # length of the longest velocity's arrow, in radii of the smaller body
OFF = (1.2, 1.55)  # distances of the velocities before and after an impact from the centre, in radii of their body
_IMPULSE = 1.6  # length of an impulse's arrow, in radii of its body
_ROUNDING = 1e-9  # fraction of the faster spin; a spin below this fraction is rounding
# colour of velocities before an impact; velocities after it have the colour of the text
EARLIER = {"dark": palette.GREY, "light": 0xB4BAC2FF}
# fraction of the approach speed; if speeds before an impact differ by more, bodies have several impacts at an instant
_CHAINED = 0.01


@dataclass(frozen=True, slots=True)
class Contact:
    """The contact of the two bodies in the shown step."""

    point: FloatArray  # (3,) m from the recording's origin
    normal: FloatArray  # (3,) unit vector from i to j, or out of a plane or wall, like the impulse on the body
    approach_speed: float  # m/s
    impulse: FloatArray  # (3,) N s, impulse on j
    force: float | None  # N, the impulse over the step; None for an impact
    edge: FloatArray  # (2, 3) m

    @property
    def friction(self) -> float:
        """The size of the impulse of friction in N s."""
        return float(np.linalg.norm(self.impulse - (self.impulse @ self.normal) * self.normal))


@dataclass(frozen=True, slots=True)
class LabelledArrows:
    """Arrows of one entity, of which the first few have labels."""

    path: str  # empty if only their labels are drawn
    origins: FloatArray  # (n, 3) m
    vectors: FloatArray  # (n, 3) m
    labels: list[str]
    along: float = 1.0  # position of the labels, from 0 at the origins to 1 at the tips
    bodies: Sequence[int] = ()  # places in the close-up of the bodies that the labels belong to
    short: Sequence[str] = ()  # labels in a view whose legend has the other labels
    way: FloatArray | None = None  # (3,) direction from an arrow to its short label; by default beyond the tip

    @property
    def off(self) -> FloatArray:
        """The directions (n, 3) from the arrows to their short labels."""
        return self.vectors if self.way is None else np.broadcast_to(self.way, self.vectors.shape)


@dataclass(frozen=True, slots=True)
class ShownPair:
    """Two bodies, or a body on a plane, at one instant."""

    called: Sequence[str]  # (b,) names of the bodies, or their numbers
    radius: FloatArray  # (b,) m
    position: FloatArray  # (b, 3) m, where normal, impulse and spins are drawn
    contact: Contact | None  # None if the bodies do not touch in this step, or if the contacts of the step are unknown
    spin: FloatArray | None  # (b, 3) rad/s; at an instant, after the impact
    spin_before: FloatArray | None  # (b, 3) rad/s, before the impact of an instant
    velocity: FloatArray | None  # (1, b, 3) m/s or, before and after the impact of an instant, (2, b, 3)
    angular_impulse: FloatArray | None  # (b, 3) N m s, of all impacts of an instant; None if it is unknown
    # (3,) unit vector across the normal on the screen, along which velocities are shifted from their bodies
    aside: FloatArray
    colours: BodyColours  # colours of the bodies, which are the same in the other views
    theme: str
    units: UnitSystem

    def arrows(self, contact: Contact) -> list[LabelledArrows]:
        """Return normal, impulses, spins, angular impulses and velocities, with their numbers."""
        small = float(self.radius.min())
        label = "normal"
        if contact.force is None and contact.approach_speed > 0.0:  # bodies in lasting contact do not approach
            label += f", approach {self.units.text(contact.approach_speed, dimension.VELOCITY, '.3g')}"
        return [
            LabelledArrows(NORMAL, contact.point[None], NORMAL_LENGTH * small * contact.normal[None], [label], 0.5),
            self._impulses(contact),
            self._spins(small),
            self._angular_impulses(contact),
            *self._velocities(small),
        ]

    def _velocities(self, small: float) -> Iterable[LabelledArrows]:
        """Yield the velocities before an impact, and then the velocities after it or, without an impact, in the step.

        The arrows stand beside their bodies, away from impulses; a body that is too large to be shown whole has no
        arrow.
        """
        if self.velocity is None:
            return
        speeds = np.linalg.norm(self.velocity, axis=2)
        whole = shown_whole(self.radius)
        for path, velocity, speed, off in zip(
            (BEFORE, VELOCITY)[-len(speeds) :], self.velocity, speeds, OFF[-len(speeds) :], strict=True
        ):
            moving = whole & (speed > _ROUNDING * speeds.max())
            vectors = VELOCITY_LENGTH * small * velocity[moving] / (speeds.max() or 1.0)
            apart = off * self.radius[moving, None]
            texts = [in_digits(self.units, each, dimension.VELOCITY) for each in speed[moving].tolist()]
            short = texts if path == VELOCITY else []
            start = self.position[moving] + apart * self.aside - 0.5 * vectors
            yield LabelledArrows(path, start, vectors, [], 0.5, short=short, way=self.aside)

    def _speeds(self) -> list[str]:
        """Return a text for each body: its speed or, at an impact, its speeds before and after."""
        if self.velocity is None:
            return []
        speeds = np.linalg.norm(self.velocity, axis=2)
        speeds[speeds <= _ROUNDING * speeds.max(initial=0.0)] = 0.0
        texts = [in_digits(self.units, speed, dimension.VELOCITY) for speed in speeds[-1].tolist()]
        if len(speeds) == 1:
            return [f"speed {text}" for text in texts]
        first = [self.units.shown(speed, dimension.VELOCITY) for speed in speeds[0].tolist()]
        return [f"speed {one:.3g} before, {last} after" for one, last in zip(first, texts, strict=True)]

    def speed_lines(self) -> list[LegendLine]:
        """Return the lines about velocities of a legend beside all views, in the colours of this view."""
        named = zip(self.called, self._speeds(), self._hues(), strict=False)
        lines = [LegendLine(f"■ {name} close up: {text}", hue) for name, text, hue in named]
        return lines + self._velocity_lines(", close up")

    def _hues(self) -> list[int]:
        """Return the colours (b,) of the bodies; ink if they change with time."""
        fixed = self.colours.fixed
        return [palette.INKS[self.theme]] * len(self.called) if fixed is None else fixed.tolist()

    def lines(self) -> list[LegendLine]:
        """Return the lines of a legend about this view: each body with its numbers, and the arrows with numbers."""
        colours, units = self._hues(), self.units
        arrows = [] if self.contact is None else self.arrows(self.contact)
        speeds, entries = self._speeds(), list[LegendLine]()
        for place, (name, colour) in enumerate(zip(self.called, colours, strict=True)):
            own = [a.labels[a.bodies.index(place)] for a in arrows if a.labels and place in a.bodies]
            entries.append(LegendLine(f"■ {name}", colour))
            texts = (*speeds[place : place + 1], *own)
            entries += [LegendLine(f"    {text}", colour, is_extra=True) for text in texts]
        if self.contact is None:
            return entries
        if self.velocity is not None and len(self.velocity) > 1 and len(self.called) > 1:
            apart = float((self.velocity[0, 0] - self.velocity[0, 1]) @ self.contact.normal)
            if abs(apart - self.contact.approach_speed) > _CHAINED * self.contact.approach_speed:
                entries.append(LegendLine("before and after all impacts of this instant", palette.GREY))
        normal, impulse, spin, *_ = arrows
        entries.append(LegendLine(f"→ {normal.labels[0]}; — line of centres", palette.VERMILION))
        if impulse.labels:
            what = "impulse" if self.contact.force is None else "force"
            text = f"→ {what} on each body, {impulse.labels[0]}"
            entries.append(LegendLine(text, palette.ARROWS[paths.FORCE_NORMAL]))
        if spin.labels:
            fastest = units.text(self.spin_of_scale, dimension.ANGULAR_VELOCITY, ".3g")
            scale = f", {_SPIN} radii = {fastest}" if self.spin_of_scale > 0.0 else ""
            entries.append(LegendLine(f"→ spin{scale}", palette.SPIN))
        return entries + self._velocity_lines()

    def _velocity_lines(self, where: str = "") -> list[LegendLine]:
        """Return the lines of a legend about the arrows of velocities."""
        if self.contact is None or self.velocity is None:
            return []
        drawn = {each.path for each in self._velocities(1.0) if len(each.vectors)}
        longest = float(np.linalg.norm(self.velocity, axis=2).max(initial=0.0))
        scale = f"{VELOCITY_LENGTH} radii = {self.units.text(longest, dimension.VELOCITY, '.3g')}"
        after = " after" if len(self.velocity) > 1 else ""
        lines = {
            BEFORE: LegendLine(f"→ velocity before{where}", EARLIER[self.theme]),
            VELOCITY: LegendLine(f"→ velocity{after}{where}: {scale}", palette.INKS[self.theme]),
        }
        return [line for path, line in lines.items() if path in drawn]

    def _impulses(self, contact: Contact) -> LabelledArrows:
        """Return the impulse on each body from its centre; if one body is many times larger, only on the smaller."""
        size = float(np.linalg.norm(contact.impulse))
        reach = impulse_radii(self.radius)
        drawn = (reach > 0.0) & (size > 0.0)
        signs = np.array([-1.0, 1.0])[: len(reach)]
        vectors = (reach * signs)[drawn, None] * contact.impulse / (size or 1.0)
        if not drawn.any():
            return LabelledArrows(IMPULSE, self.position[drawn], vectors, [])
        text = in_digits(self.units, size, dimension.IMPULSE)
        together = ", friction included" if contact.friction > _ROUNDING * size else ""  # tables list the normal part
        if contact.force is None:
            return LabelledArrows(IMPULSE, self.position[drawn], vectors, [text + together], short=[text])
        force = in_digits(self.units, contact.force, dimension.FORCE)
        labels = [f"{force}{together}, {text} in the step"]
        return LabelledArrows(IMPULSE, self.position[drawn], vectors, labels, short=[force])

    def _spin_speeds(self) -> FloatArray:
        """Return the spins (2, b) rad/s before and after the impact of an instant; both are equal without an impact."""
        after = np.zeros((len(self.called), 3)) if self.spin is None else self.spin
        before = after if self.spin_before is None else self.spin_before
        speeds: FloatArray = np.linalg.norm([before, after], axis=2)
        speeds[speeds <= _ROUNDING * speeds.max()] = 0.0
        return speeds

    @property
    def spin_of_scale(self) -> float:
        """The spin (rad/s) whose arrow is 1.3 radii long; 0 if no arrow has a length."""
        speeds = self._spin_speeds()
        return float(speeds.max()) if speeds[1].any() else 0.0

    def _spins(self, small: float) -> LabelledArrows:
        speeds = self._spin_speeds()
        after = np.zeros((len(self.called), 3)) if self.spin is None else self.spin
        turning = np.asarray(speeds.max(axis=0)) > 0.0
        vectors = _SPIN * small * after[turning] / (speeds.max() or 1.0)
        unit = dimension.ANGULAR_VELOCITY
        labels = [self.units.text(last, unit, ".3g") for last in speeds[1].tolist()]
        short = [label if last > 0.0 else "" for label, last in zip(labels, speeds[1].tolist(), strict=True)]
        if self.spin_before is None:
            labels = [f"spin {label}" for label in labels]
        else:
            first = [self.units.shown(speed, unit) for speed in speeds[0].tolist()]
            labels = [f"spin {one:.3g} before, {last} after" for one, last in zip(first, labels, strict=True)]
        places: list[int] = np.flatnonzero(turning).tolist()
        labels, short = ([texts[place] for place in places] for texts in (labels, short))
        return LabelledArrows(SPIN, self.position[turning], vectors, labels, bodies=places, short=short)

    def _angular_impulses(self, contact: Contact) -> LabelledArrows:
        """Return the labels of the angular impulses of an impact, parallel to the changes of the spins."""
        size, whole = contact.friction, float(np.linalg.norm(contact.impulse))
        if contact.force is not None or self.spin is None or size <= _ROUNDING * whole:
            return LabelledArrows("", np.zeros((0, 3)), np.zeros((0, 3)), [])
        values = size * self.radius  # |r × J| about the centre of each body
        # a body may have several impacts at one instant, and the spins are the spins after all these impacts
        if self.angular_impulse is not None:
            values = drawing.magnitudes(self.angular_impulse)
        texts = [
            f"angular impulse {in_digits(self.units, value, dimension.ANGULAR_IMPULSE)}" for value in values.tolist()
        ]
        return LabelledArrows("", self.position, np.zeros_like(self.position), texts, bodies=range(len(texts)))


def impulse_radii(radius: FloatArray) -> FloatArray:
    """Return the lengths (b,) m of the arrows of impulses; 0 for a body that is too large to be shown whole."""
    return np.asarray(_IMPULSE * radius * shown_whole(radius))


def contact_of(header: Header, frame: Frame, pair: Pair, position: FloatArray, origin: FloatArray) -> Contact | None:
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
    point = nearest_images(np.stack([position[0], place]), header.cell(frame.time))[1]
    end = point if pair.j is None else position[1]
    impulse = row["normal_impulse"] * normal + [row["friction_x"], row["friction_y"], row["friction_z"]]
    rests = row["mode"] != IMPACT_MODE and frame.dt > 0.0
    force = float(np.linalg.norm(impulse)) / frame.dt if rests else None
    outward = -normal if pair.j is None else normal
    return Contact(point, outward, float(row["approach_speed"]), impulse, force, np.stack([position[0], end]))
