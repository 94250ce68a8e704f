"""The legend of the 3D views: the meaning of each colour, arrow and edge, and the scale of the arrows.

Each entry is a label in the colour that it explains; only drawn things have entries. Beside several views the
legend is a separate view; in a picture of a single view it is in a corner. The legend is not in the recording: the
viewer gets it in a `Supplement`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import astuple, dataclass, replace
from itertools import product

import numpy as np
import pyarrow as pa

from carom.arrays import ColourArray, FloatArray
from carom.display.legend_layout import BODIES, GRAPH, SPACE, Legend, LegendLine, more_bodies
from carom.display.letters import drawable
from carom.display.motion_texts import motion_texts
from carom.recording.layout import OF_LATE, drawing, is_crowded
from carom.recording.layout.drawing import DIMENSIONS, REACH, magnitude_at, shape
from carom.recording.read.recording import Recording
from carom.recording.schema import palette, paths
from carom.recording.schema.header import STATIC_COLOURS, Header
from carom.recording.write.encoder import SPEED
from carom.scene.units import dimension
from carom.scene.units.dimension import Dimension
from carom.scene.units.system import UnitSystem, raised
from carom.scene.wording import counted
from carom.state.frame import Frame

MOST_NAMED = 7  # largest number of bodies with an entry each, so that the scales of arrows remain visible

_TINY = -6  # largest power of ten that is written as a common factor of the numbers of a scale
_KEPT = "\u00a0"  # a space at which no line is broken
_LENGTHS = {"½": 0.5, "1": 1.0, "1½": 1.5}  # lengths, in radii, of the arrows whose magnitudes show the scale
# impulse levels of the edges that the legend lists, and the word for each
_EDGES = {2: "small", 4: "medium", 6: "large"}
_WIDTHS = {2: "thin", 4: "medium", 6: "wide"}  # levels of these edges on white paper, where all edges have one colour
_PARALLEL = {paths.ANGULAR_ACCELERATION: "angular acceleration", paths.SPIN_CHANGE: "change of spin"}
_NAMES = {
    paths.TORQUE: "torque",
    paths.ANGULAR_ACCELERATION: "angular acceleration",
    paths.ANGULAR_IMPULSE: "impact's angular impulse",
    paths.SPIN_CHANGE: "impact's change of spin",
}


@dataclass(frozen=True, slots=True)
class LegendContents:
    """The things that are drawn, and therefore explained, in a picture or during the run."""

    contacts: bool = False
    impulses: bool = False  # whether arrows and widths of edges show impulses
    friction: bool = False
    impacts: bool = False
    torques: bool = False  # torques of contacts that last
    turns: bool = False  # angular impulses of impacts
    trails: bool = False

    def __or__(self, other: LegendContents) -> LegendContents:
        """Return the things that are drawn in either of two contents."""
        return LegendContents(*(one or another for one, another in zip(astuple(self), astuple(other), strict=True)))


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
    fastest: float = 0.0,
    field: FloatArray | None = None,
    by_stage: bool = False,
    both_arrows: bool = False,
    instant: bool = False,
    recent: float | None = None,
    grid: str = "",
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
    fastest
        rad/s, the spin whose arrow in the close-up is 1.3 radii long; 0 if there is none.
    field
        (3,) m/s², a uniform field.
    by_stage
        Whether the edges beside the bodies have the colours of the solver's stages.
    both_arrows
        Whether angular accelerations and changes of spin have arrows, too.
    instant
        Whether the moment is an instant within a step, at which only the bodies that meet then have edges.
    recent
        s, the time for which paths are drawn; None for the whole past.
    grid
        The side of a square of the grids that show planes, with its unit; empty without a plane.
    """
    lines = [*_bodies(header, by, colours, references, named), *_edges(header, frame, drawn, theme, by_stage)]
    if instant:
        lines.append(LegendLine("lines only where bodies touch at this instant", palette.GREY, SPACE))
    if drawn.trails:
        path = (
            "path so far" if recent is None else f"path of the last {header.units.text(recent, dimension.TIME, '.1g')}"
        )
        lines.append(LegendLine(f"— {path}", palette.GREY, (BODIES,)))
    for turning in (paths.OF_LASTING if drawn.torques else (), paths.OF_IMPACTS if drawn.turns else ()):
        lines += _arrows(header, references, turning, both_arrows, frame)
    arrows = next((k for k, line in enumerate(lines) if line.text.startswith("→")), None)
    if arrows is not None:
        lengths = f"{', '.join(_LENGTHS)} radii"
        lines.insert(arrows, LegendLine(f"arrows, lengths compressed; {lengths} are:", palette.GREY, (GRAPH,)))
    if fastest > 0.0:
        text = header.units.text(fastest, dimension.ANGULAR_VELOCITY, ".3g")
        lines.append(LegendLine(f"→ spin, close up: 1.3 radii = {text}", palette.SPIN))
    if field is not None and np.any(field):
        size = header.units.text(float(np.linalg.norm(field)), dimension.ACCELERATION, ".4g")
        lines.append(LegendLine(f"→ gravity, {size}", palette.FIELD))
    ink = palette.INKS[theme]
    lines += [LegendLine(text, ink, (BODIES,)) for text in motion_texts(header) if drawable(text)]
    if grid:
        lines.append(LegendLine(f"— grid of a plane: squares of {grid}", palette.GREY, (BODIES,), is_extra=True))
    if viewer_time:
        lines.append(LegendLine(f"time: {viewer_time}", palette.GREY))
    return Legend(lines, theme)


def _bodies(
    header: Header, by: str, colours: ColourArray | None, references: Mapping[str, float], named: bool
) -> Iterator[LegendLine]:
    """Explain the colours of bodies."""
    if by == header.coloured_by and shape(header) == "mesh":
        yield LegendLine("■ all bodies; the dark half shows how they rotate", palette.SKY, SPACE)
    elif by == "material" and header.materials:
        for name, colour in zip(header.materials.names, header.materials.colours, strict=True):
            yield LegendLine(f"■ {name}", colour, SPACE)
    elif by in STATIC_COLOURS and colours is not None:
        for line in _groups(header, colours):
            yield replace(line, views=(GRAPH,)) if named else line
    elif by == "speed":
        scale, middle = drawing.SPEEDS.tolist(), references.get(SPEED, 0.0)
        known = by == header.coloured_by and middle > 0.0
        text = header.units.text(middle, dimension.VELOCITY, ".3g") if known else "the median speed"
        yield from (
            LegendLine("■ slow", scale[0], SPACE),
            LegendLine(f"■ {text}", scale[len(scale) // 2], SPACE),
            LegendLine("■ fast", scale[-1], SPACE),
        )
    elif by == "island":
        yield LegendLine("■ one colour: linked by contacts", palette.SKY, SPACE)
        yield LegendLine("■ without contacts", palette.GREY, SPACE)
    else:
        few = zip(palette.BODIES[:3], ("first", "second", "third"), strict=True)
        yield from (LegendLine(f"■ {name} colour of the graph", colour, SPACE) for colour, name in few)
        yield LegendLine("■ without contacts", palette.GREY, SPACE)


def _groups(header: Header, colours: ColourArray) -> Iterator[LegendLine]:
    """Explain colours by group: a line for each body if there are few, otherwise for each group."""
    names, known = list(header.names), colours.tolist()
    if len(known) <= MOST_NAMED and len(known) == len(names):
        yield from (LegendLine(f"■ {name or f'body {k}'}", known[k], SPACE, 1) for k, name in enumerate(names))
        return
    if len(known) != len(names):  # a clip of selected bodies
        return
    groups = np.unique(header.group)
    left = 0
    for place, group in enumerate(groups[groups >= 0].tolist()):
        members = np.flatnonzero(header.group == group)
        if place >= MOST_NAMED:
            left += len(members)
            continue
        name = names[int(members[0])].rstrip(" 0123456789-_#") or f"group {group}"
        text = f"■ {name}, {counted(len(members), 'body')}, in shades"
        yield LegendLine(text, known[int(members[0])], SPACE, len(members))
    for table in groups[groups < -1].tolist():
        members = np.flatnonzero(header.group == table)
        text = f"■ {counted(len(members), 'body')} of a file, in shades"
        yield LegendLine(text, known[int(members[0])], SPACE, len(members))
    single = np.flatnonzero(header.group == -1)
    for k in single[:MOST_NAMED].tolist():
        yield LegendLine(f"■ {names[k] or f'body {k}'}", known[k], SPACE, 1)
    left += max(0, len(single) - MOST_NAMED)
    if left:
        yield more_bodies(left)


def _edges(
    header: Header, frame: Frame | None, drawn: LegendContents, theme: str, by_stage: bool
) -> Iterator[LegendLine]:
    """Explain lines between touching bodies, points at impacts, and arrows of impulses."""
    by_impulse = theme == "dark" and drawn.impulses and not by_stage  # edges beside the bodies
    beside = () if is_crowded(header) else (BODIES,)  # solid spheres hide lines
    if drawn.contacts and not by_impulse:
        if theme == "dark" and not header.engine:
            yield LegendLine("— contact, coloured by the solver's stage", palette.STAGES[0], beside)
        else:
            yield LegendLine("— bodies that touch", palette.VERMILION, (*beside, *(() if drawn.impulses else (GRAPH,))))
    if drawn.impacts:
        yield LegendLine("• impact: size shows its impulse", palette.ARROWS[paths.FORCE_NORMAL], (BODIES,))
    if not drawn.impulses:
        return
    middle = _middle(frame)
    levels = drawing.COLOURS.tolist() if theme == "dark" else [palette.VERMILION] * drawing.LEVELS
    normal, friction = palette.ARROWS[paths.FORCE_NORMAL], palette.ARROWS[paths.FORCE_FRICTION]
    views = (*beside, GRAPH) if by_impulse else (GRAPH,)
    drawn_levels = _levels(frame, middle)
    for level, word in _EDGES.items():
        if drawn_levels and not drawn_levels[0] <= level <= drawn_levels[-1]:
            continue
        impulse = magnitude_at(level, drawing.LEVELS, middle)
        value = _round(header, impulse, dimension.IMPULSE) if middle else f"{word} impulse"
        width = f", {_WIDTHS[level]} line" if theme == "light" else ""  # edges of one colour
        yield LegendLine(f"— contact{width}: {value}", levels[level], views)
    yield LegendLine(f"→ normal impulse: {_scale(header, paths.FORCE_NORMAL, middle)}", normal, (GRAPH,))
    if drawn.friction:
        yield LegendLine("→ impulse of friction, same scale", friction, (GRAPH,))


def _middle(frame: Frame | None) -> float:
    """Return the median impulse (N s) of a step, the middle of the scale; 0 without impulses."""
    rows = None if frame is None else frame.contact_rows
    positive = np.zeros(0) if rows is None else rows["normal_impulse"][rows["normal_impulse"] > 0.0]
    return float(np.median(positive)) if len(positive) else 0.0


def _levels(frame: Frame | None, middle: float) -> list[int]:
    """Return the levels of the edges of a step, ascending, with the middle level; none if they are not known."""
    if frame is None or frame.contact_rows is None or not middle:
        return []
    found = drawing.level(frame.contact_rows["normal_impulse"], middle).tolist()
    return sorted({*found, drawing.LEVELS // 2})


def _scale(header: Header, path: str, reference: float) -> str:
    """Write the magnitudes of the arrows that are as long as `_LENGTHS`; nothing is known without a reference."""
    if not reference:
        return "1 radius = the median"
    kind = DIMENSIONS[path]
    values = [magnitude_at(radii, REACH[path], reference) for radii in _LENGTHS.values()]
    power = 3 * int(np.floor(np.log10(header.units.shown(values[1], kind)) / 3.0))
    common = 10.0**power if power <= _TINY else 1.0
    texts = [_round(header, value / common, kind) for value in values]
    unit = texts[-1].partition(_KEPT)[2]
    listed = ", ".join([*(text.removesuffix(f"{_KEPT}{unit}") for text in texts[:-1]), texts[-1]])
    if common == 1.0:
        return listed
    factor = raised("×10", power)
    return listed.removesuffix(unit) + factor + _KEPT + unit


def _round(header: Header, value: float, kind: Dimension) -> str:
    """Write two digits of a magnitude, with spaces at which no line is broken."""
    return in_digits(header.units, value, kind, 2).replace(" ", _KEPT)


def in_digits(units: UnitSystem, value: float, kind: Dimension, digits: int = 3) -> str:
    """Write some digits of a number with its unit, and a number below a million without an exponent."""
    number, space, unit = units.text(value, kind, f".{digits}g").partition(" ")
    return f"{float(number):.6g}{space}{unit}"


def _arrows(
    header: Header, references: Mapping[str, float], entities: Sequence[str], both: bool, frame: Frame | None
) -> Iterator[LegendLine]:
    """State the scales of the arrows of torques and angular impulses, whose lengths are not proportional to them."""
    for path in entities:
        colour, other = palette.ARROWS[path], paths.PARALLEL.get(path)
        if other is None and not both:
            continue
        scale = f": {_scale(header, path, references[path])}" if path in references else ""
        drawn = None if frame is None else {paths.TORQUE: frame.torque, paths.ANGULAR_IMPULSE: frame.angular_impulse}
        vectors = None if drawn is None else drawn.get(path)
        if scale and vectors is not None:  # the scale comes from the first frame with arrows
            largest = float(drawing.magnitudes(vectors[np.isfinite(vectors).all(axis=1)]).max(initial=0.0))
            if largest > magnitude_at(max(_LENGTHS.values()), REACH[path], references[path]):
                scale += f"; here up to {_round(header, largest, DIMENSIONS[path])}"
        yield LegendLine(f"→ {_NAMES[path]}{scale}, beyond the surface", colour, (GRAPH,))
        if other is not None and not is_crowded(header):
            yield LegendLine(f"    second number beside it: {_PARALLEL[other]}", colour, (GRAPH,))
        elif other is not None and not both:
            yield LegendLine(f"    the {_PARALLEL[other]} is parallel", colour, (GRAPH,))


# The things that are drawn at a moment or during the whole run; the legend names nothing else.

_AROUND = np.array([v for v in product((-1.0, 0.0, 1.0), repeat=3) if any(v)])
_AROUND /= np.linalg.norm(_AROUND, axis=1)[:, None]
_ROUNDING = 1e-9  # fraction of the largest normal impulse; smaller friction is rounding, and is not drawn


def drawn_during(recording: Recording, header: Header) -> LegendContents:
    """Return the things that are drawn at some time of a run, given the ``header`` of the layout."""
    records = header.records_contacts
    impacts = records and any(entry.rows for entry in recording.store.frames_of(paths.IMPACTS))
    rubs = records and header.has_friction and _has_arrows(recording, paths.FORCE_FRICTION)
    torques = header.has_torque and _has_arrows(recording, paths.TORQUE)
    turns = records and header.has_torque and _has_arrows(recording, paths.ANGULAR_IMPULSE)
    return LegendContents(header.collides, records, rubs, impacts, torques, turns)


def _has_arrows(recording: Recording, path: str) -> bool:
    """Return whether a recorded arrow of an entity has a length."""
    entries = [entry for entry in recording.store.entries if entry.entity_path == path and not entry.is_static]
    for chunk in recording.chunks(entries):
        vectors: pa.Array = chunk.batch["Arrows3D:vectors"].flatten().flatten()
        if np.any(vectors.to_numpy()):
            return True
    return False


def drawn_at(frame: Frame, header: Header) -> LegendContents:
    """Return the things that are drawn at the end of a step, or at an instant, except points of impacts."""
    rows = frame.contact_rows if header.records_contacts else None
    largest = 0.0 if rows is None or not len(rows) else float(rows["normal_impulse"].max())
    rubs = False
    if rows is not None and largest > 0.0 and header.has_friction:
        friction = np.stack([rows["friction_x"], rows["friction_y"], rows["friction_z"]])
        rubs = bool(np.abs(friction).max() > _ROUNDING * largest)
    torques, turns = (
        header.has_torque and values is not None and bool(np.any(values))
        for values in (frame.torque, frame.angular_impulse)
    )
    return LegendContents(len(frame.contacts.pairs) > 0, largest > 0.0, rubs, torques=torques, turns=turns)


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
