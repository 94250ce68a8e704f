"""The legend of the 3D views: the meaning of each colour, arrow and edge, and the scale of the arrows.

It has a label for each entry in the colour that it explains, and names only what is drawn. Beside several views it is a
view of its own; in a picture of a single view it is in a corner. A recording does not hold it: the viewer gets it in a
`Supplement`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import astuple, dataclass, replace
from itertools import product
from typing import Any

import numpy as np
import pyarrow as pa
import rerun as rr
import rerun.blueprint as rrb

from carom.arrays import ColourArray, FloatArray
from carom.physics.frame import Frame
from carom.recording.layout import OF_LATE, drawing
from carom.recording.layout.canvas import LEGEND, Area, View
from carom.recording.layout.drawing import REACH, magnitude_at, shape, single
from carom.recording.read.recording import Recording
from carom.recording.schema import palette, paths
from carom.recording.schema.header import STATIC_COLOURS, Header
from carom.recording.write.encoder import SPEED
from carom.scene.units import dimension

BODIES, GRAPH = "bodies", "graph"  # views
_SPACE = (BODIES, GRAPH)
MOST_NAMED = 6  # bodies that have an entry each, so that the scales of arrows remain visible

_ROW = 25.0  # points, from one line to the next
_MARGIN = 10.0  # points, around the lines
_LETTER, _WIDE, _NARROW = 7.1, 10.4, 3.9  # points, widths of letters
_WIDE_LETTERS, _NARROW_LETTERS = "mwMWNOQ→—■=+", "iljtfrI .,:'()-/|1"
_LARGE = 1.5  # radii, the longer of the two arrows that show the scale
_DIMENSIONS = {paths.TORQUE: dimension.TORQUE, paths.ANGULAR_ACCELERATION: dimension.ANGULAR_ACCELERATION}
_NAMES = {paths.TORQUE: "torque", paths.ANGULAR_ACCELERATION: "angular acceleration"}


@dataclass(frozen=True, slots=True)
class LegendLine:
    """A line of the legend."""

    text: str
    colour: int  # 0xRRGGBBAA
    views: Sequence[str] = ()  # views whose legend has this line in a picture of a single view

    @property
    def width(self) -> float:
        """Its width in points."""
        wide = sum(letter in _WIDE_LETTERS for letter in self.text)
        narrow = sum(letter in _NARROW_LETTERS for letter in self.text)
        return _WIDE * wide + _NARROW * narrow + _LETTER * (len(self.text) - wide - narrow)


@dataclass(frozen=True, slots=True)
class LegendContents:
    """What is drawn, and therefore explained, in a picture or during the run."""

    contacts: bool = False
    impulses: bool = False  # arrows, and widths of edges
    friction: bool = False
    impacts: bool = False
    torques: bool = False
    trails: bool = False

    def __or__(self, other: LegendContents) -> LegendContents:
        """Return the contents of either."""
        return LegendContents(*(one or another for one, another in zip(astuple(self), astuple(other), strict=True)))


@dataclass(frozen=True, slots=True)
class Legend:
    """The lines, from top to bottom."""

    entries: Sequence[LegendLine]
    theme: str = "dark"

    def wrapped(self, width: float) -> Legend:
        """Return the lines, broken between words where they are wider than a view of this width (points)."""
        found = list[LegendLine]()
        for entry in self.entries:
            line, *words = entry.text.split(" ")
            for word in words:
                if replace(entry, text=f"{line} {word}").width + 2.0 * _MARGIN > width and line.strip("→—■ "):
                    found.append(replace(entry, text=line))
                    line = "    "
                line = f"{line} {word}"
            found.append(replace(entry, text=line))
        return replace(self, entries=found)

    def of(self, view: str) -> Legend:
        """Return the lines about one view."""
        return replace(self, entries=[entry for entry in self.entries if view in entry.views])

    @property
    def size(self) -> tuple[float, float]:
        """Width and height of the lines, in points; zeros without any."""
        if not self.entries:
            return 0.0, 0.0
        return max(entry.width for entry in self.entries) + 2.0 * _MARGIN, _ROW * len(self.entries) + 2.0 * _MARGIN

    def view(self, area: Area) -> rrb.Spatial2DView:
        """Lay out the lines in a view of this size; lines that do not fit are below its lower edge."""
        return rrb.Spatial2DView(
            name="Legend",
            origin=LEGEND,
            background=rrb.Background(color=palette.GROUNDS[self.theme], kind=rrb.BackgroundKind.SolidColor),
            visual_bounds=rrb.VisualBounds2D(x_range=[0.0, area.width], y_range=[0.0, area.height]),
        )

    def statics(self) -> Iterator[tuple[str, rr.AsComponents]]:
        """Yield the lines as labels of invisibly small points. A label is centred below its point."""
        yield LEGEND, rr.Points2D(self._places(), radii=1e-3, **self._labels())

    def inside(self, view: View, area: Area, corner: tuple[int, int]) -> Iterator[tuple[str, rr.AsComponents]]:
        """Yield the same for a corner of a 3D view of this area."""
        if not self.entries:
            return
        start = (np.array([area.width, area.height]) - self.size) * [corner[0] > 0, corner[1] < 0]
        shift = (self._places() + start - [0.5 * area.width, 0.5 * area.height]) * [1.0, -1.0]
        places = view.target + view.height() / area.height * shift @ view.axes()
        yield LEGEND, rr.Points3D(single(places), radii=1e-6 * view.height(), **self._labels())

    def _places(self) -> FloatArray:
        """Return the points (k, 2) above the middles of the labels, from the upper left corner of the legend."""
        return np.array([(_MARGIN + 0.5 * each.width, _MARGIN + _ROW * k) for k, each in enumerate(self.entries)])

    def _labels(self) -> dict[str, Any]:
        colours = palette.readable([entry.colour for entry in self.entries], self.theme)
        return {"labels": [entry.text for entry in self.entries], "colors": colours, "show_labels": True}


def legend(
    header: Header,
    by: str,
    colours: ColourArray | None,
    references: Mapping[str, float],
    frame: Frame | None,
    drawn: LegendContents,
    *,
    named: bool = False,
    viewer_time: str = "",
    spins: FloatArray | None = None,
    field: FloatArray | None = None,
    by_stage: bool = False,
    theme: str = "dark",
) -> Legend:
    """Explain the views of a recording.

    Parameters
    ----------
    by
        The property that sets the colours of the bodies.
    colours
        (n,) colours of the bodies, if they are constant during the run.
    references
        The magnitudes in the middle of the scales, as recorded.
    frame
        The step shown; None if it is not known. Its impulses set the scale of the arrows of impulses.
    named
        Whether all bodies have their names beside them in the view of the bodies.
    viewer_time
        How the viewer's times are related to the scene's unit of time.
    spins
        (b, 3) rad/s of the bodies of the close-up, if there is one.
    field
        (3,) m/s², a uniform field.
    by_stage
        Whether the edges beside the bodies have the colours of the solver's stages.
    """
    lines = [*_bodies(header, by, colours, references, named), *_edges(header, frame, drawn, theme, by_stage)]
    if drawn.trails:
        lines.append(LegendLine("— path so far", palette.GREY, (BODIES,)))
    if drawn.torques:
        lines += _arrows(header, references)
    if spins is not None:
        fastest = float(np.linalg.norm(spins, axis=1).max(initial=0.0))
        if fastest > 0.0:
            text = header.units.text(fastest, dimension.ANGULAR_VELOCITY, ".3g")
            lines.append(LegendLine(f"→ spin, close up: 1.3 radii = {text}", palette.SPIN))
    if field is not None and np.any(field):
        size = header.units.text(float(np.linalg.norm(field)), dimension.ACCELERATION, ".4g")
        lines.append(LegendLine(f"→ gravity, {size}", palette.FIELD))
    if viewer_time:
        lines.append(LegendLine(f"time: {viewer_time}", palette.GREY))
    return Legend(lines, theme)


def _bodies(
    header: Header, by: str, colours: ColourArray | None, references: Mapping[str, float], named: bool
) -> Iterator[LegendLine]:
    """Explain the colours of bodies."""
    if by == header.coloured_by and shape(header) == "mesh":
        yield LegendLine("■ all bodies; the dark half shows how they rotate", palette.SKY, _SPACE)
    elif by == "material" and header.materials:
        for name, colour in zip(header.materials.names, header.materials.colours, strict=True):
            yield LegendLine(f"■ {name}", colour, _SPACE)
    elif by in STATIC_COLOURS and colours is not None:
        for line in _groups(header, colours):
            yield replace(line, views=(GRAPH,)) if named else line
    elif by == "speed":
        scale, middle = drawing.SPEEDS.tolist(), references.get(SPEED, 0.0)
        known = by == header.coloured_by and middle > 0.0
        text = header.units.text(middle, dimension.VELOCITY, ".3g") if known else "the median speed"
        yield from (
            LegendLine("■ slow", scale[0], _SPACE),
            LegendLine(f"■ {text}", scale[len(scale) // 2], _SPACE),
            LegendLine("■ fast", scale[-1], _SPACE),
        )
    elif by == "island":
        yield LegendLine("■ one colour: linked by contacts", palette.SKY, _SPACE)
        yield LegendLine("■ without contacts", palette.GREY, _SPACE)
    else:
        few = zip(palette.BODIES[:3], ("first", "second", "third"), strict=True)
        yield from (LegendLine(f"■ {name} colour of the graph", colour, _SPACE) for colour, name in few)
        yield LegendLine("■ without contacts", palette.GREY, _SPACE)


def _groups(header: Header, colours: ColourArray) -> Iterator[LegendLine]:
    """Explain colours by group: a line for each body if there are few, otherwise for each group."""
    names, known = list(header.names), colours.tolist()
    if len(known) <= MOST_NAMED and len(known) == len(names):
        yield from (LegendLine(f"■ {name or f'body {k}'}", known[k], _SPACE) for k, name in enumerate(names))
        return
    if len(known) != len(names):  # a clip of some bodies
        return
    groups = np.unique(header.group)
    for group in groups[groups >= 0][:MOST_NAMED].tolist():
        members = np.flatnonzero(header.group == group)
        name = names[int(members[0])].rstrip(" 0123456789-_#") or f"group {group}"
        yield LegendLine(f"■ {name}, {len(members)} bodies, in shades", known[int(members[0])], _SPACE)
    for table in groups[groups < -1].tolist():
        members = np.flatnonzero(header.group == table)
        yield LegendLine(f"■ {len(members)} bodies of a file, in shades", known[int(members[0])], _SPACE)
    single = np.flatnonzero(header.group == -1)
    yield from (LegendLine(f"■ {names[k] or f'body {k}'}", known[k], _SPACE) for k in single[:MOST_NAMED].tolist())
    if len(single) > MOST_NAMED:
        yield LegendLine(f"and {len(single) - MOST_NAMED} more, in other shades", palette.GREY, _SPACE)


def _edges(
    header: Header, frame: Frame | None, drawn: LegendContents, theme: str, by_stage: bool
) -> Iterator[LegendLine]:
    """Explain lines between touching bodies, points at impacts, and arrows of impulses."""
    by_impulse = theme == "dark" and drawn.impulses and not by_stage  # beside the bodies
    if drawn.contacts and not by_impulse:
        if theme == "dark" and not header.engine:
            yield LegendLine("— contact, coloured by the solver's stage", palette.STAGES[0], (BODIES,))
        else:
            yield LegendLine("— bodies that touch", palette.VERMILION, (BODIES, *(() if drawn.impulses else (GRAPH,))))
    if drawn.impacts:
        yield LegendLine("■ impact: size = impulse, glow = lost energy", int(drawing.COLOURS[-2]), (BODIES,))
    if not drawn.impulses:
        return
    middle = _middle(header, frame)
    levels = drawing.COLOURS.tolist() if theme == "dark" else [palette.VERMILION] * drawing.LEVELS
    normal, friction = palette.ARROWS[paths.FORCE_NORMAL], palette.ARROWS[paths.FORCE_FRICTION]
    views = (BODIES, GRAPH) if by_impulse else (GRAPH,)
    yield LegendLine("— contact: small impulse", levels[1], views)
    yield LegendLine(f"— contact: {middle or 'the median impulse'}", levels[len(levels) // 2], views)
    yield LegendLine("— contact: large impulse", levels[-1], views)
    yield LegendLine(f"→ normal impulse: 1 radius = {middle or 'the median'}", normal, (GRAPH,))
    if drawn.friction:
        yield LegendLine("→ impulse of friction, same scale", friction, (GRAPH,))


def _middle(header: Header, frame: Frame | None) -> str:
    """Write the median impulse of a step, the middle of the scale; empty without impulses."""
    rows = None if frame is None else frame.contact_rows
    if rows is None:
        return ""
    positive = rows["normal_impulse"][rows["normal_impulse"] > 0.0]
    return header.units.text(float(np.median(positive)), dimension.IMPULSE, ".3g") if len(positive) else ""


def _arrows(header: Header, references: Mapping[str, float]) -> Iterator[LegendLine]:
    """State the scales of torques and angular accelerations: arrows are not proportional to them."""
    for path, kind in _DIMENSIONS.items():
        name, colour = _NAMES[path], palette.ARROWS[path]
        if path not in references:
            yield LegendLine(f"→ {name}", colour, (GRAPH,))
            continue
        values = (magnitude_at(radii, REACH[path], float(references[path])) for radii in (1.0, _LARGE))
        (one, _, first), (more, _, unit) = (header.units.text(value, kind, ".2g").partition(" ") for value in values)
        one, more = (f"{float(text):.6g}" for text in (one, more))  # 190 in place of 1.9e+02
        one, more = one if first == unit else f"{one} {first}", f"{more} {unit}"  # the line is short
        yield LegendLine(f"→ {name}, beyond the surface:", colour, (GRAPH,))
        yield LegendLine(f"→ 1 radius = {one}, {_LARGE:g} radii = {more}", colour, (GRAPH,))


# What is drawn, at a moment or during the whole run: the legend names nothing else.

_AROUND = np.array([v for v in product((-1.0, 0.0, 1.0), repeat=3) if any(v)])
_AROUND /= np.linalg.norm(_AROUND, axis=1)[:, None]
_ROUNDING = 1e-9  # of the largest normal impulse; friction below it is rounding, and not drawn


def drawn_during(recording: Recording, header: Header) -> LegendContents:
    """Return what is drawn at some time of a run; ``header`` is that of its layout."""
    records = header.records_contacts
    impacts = records and any(entry.rows for entry in recording.store.frames_of(paths.IMPACTS))
    rubs = records and header.has_friction and _has_arrows(recording, paths.FORCE_FRICTION)
    torques = header.has_torque and _has_arrows(recording, paths.TORQUE)
    return LegendContents(header.collides, records, rubs, impacts, torques)


def _has_arrows(recording: Recording, path: str) -> bool:
    """Return whether a recorded arrow of an entity has a length."""
    entries = [entry for entry in recording.store.entries if entry.entity_path == path and not entry.is_static]
    for chunk in recording.chunks(entries):
        vectors: pa.Array = chunk.batch["Arrows3D:vectors"].flatten().flatten()
        if np.any(vectors.to_numpy()):
            return True
    return False


def drawn_at(frame: Frame, header: Header) -> LegendContents:
    """Return what is drawn at the end of a step, or at an instant, except points of impacts."""
    rows = frame.contact_rows if header.records_contacts else None
    largest = 0.0 if rows is None or not len(rows) else float(rows["normal_impulse"].max())
    rubs = False
    if rows is not None and largest > 0.0 and header.has_friction:
        friction = np.stack([rows["friction_x"], rows["friction_y"], rows["friction_z"]])
        rubs = bool(np.abs(friction).max() > _ROUNDING * largest)
    torques = header.has_torque and frame.torque is not None and bool(np.any(frame.torque))
    return LegendContents(len(frame.contacts.pairs) > 0, largest > 0.0, rubs, torques=torques)


def impact_marks(recording: Recording, header: Header, moment: float | None = None) -> FloatArray:
    """Return points (k, 3) m around the points that views draw at impacts, at a time (s) or during the whole run."""
    if not header.records_contacts:
        return np.zeros((0, 3))
    since = None if moment is None else max(0.0, moment - OF_LATE * header.duration)
    table = recording.impacts(since, moment)
    places = np.stack([table[axis].to_numpy() for axis in "xyz"], axis=1) - recording.origin
    reference = recording.arrow_references.get(paths.IMPACTS, 1.0)
    radii = drawing.point_radii(header.radius)[drawing.level(table["normal_impulse"].to_numpy(), reference)]
    return np.asarray(places[:, None] + radii[:, None, None] * _AROUND, dtype=np.float64).reshape(-1, 3)
