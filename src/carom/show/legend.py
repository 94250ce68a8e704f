"""The legend beside the 3D views: the meaning of each colour, arrow and edge, and the scale of the arrows.

It is a separate view, with a label for each entry in the colour that it explains. A recording does not hold it: the
viewer gets it in a `Supplement`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from carom.arrays import ColourArray, FloatArray
from carom.physics.frame import Frame
from carom.recording.layout import colouring, drawing
from carom.recording.layout.canvas import Area
from carom.recording.layout.drawing import REACH, magnitude_at, shape
from carom.recording.schema import palette, paths
from carom.recording.schema.header import STATIC_COLOURS, Header
from carom.recording.write.encoder import SPEED
from carom.scene.units import dimension

LEGEND = "legend"
MOST_NAMED = 6  # bodies that have an entry each, so that the scales of arrows remain visible

_ROW = 25.0  # points, from one line to the next
_MARGIN = 10.0  # points, around the lines
_LETTER = 6.1  # points, mean width of a letter
_LARGE = 1.5  # radii, the longer of the two arrows that show the scale
_DIMENSIONS = {paths.TORQUE: dimension.TORQUE, paths.ANGULAR_ACCELERATION: dimension.ANGULAR_ACCELERATION}
_NAMES = {paths.TORQUE: "torque", paths.ANGULAR_ACCELERATION: "angular acceleration"}


@dataclass(frozen=True, slots=True)
class LegendLine:
    """A line of the legend."""

    text: str
    colour: int  # 0xRRGGBBAA


@dataclass(frozen=True, slots=True)
class Legend:
    """The lines, from top to bottom."""

    entries: Sequence[LegendLine]
    theme: str = "dark"

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
        texts = [entry.text for entry in self.entries]
        places = [(_MARGIN + _LETTER * len(text) / 2, _MARGIN + _ROW * k) for k, text in enumerate(texts)]
        colours = palette.legible([entry.colour for entry in self.entries], self.theme)
        yield LEGEND, rr.Points2D(places, radii=1e-3, labels=texts, colors=colours, show_labels=True)


def legend(
    header: Header,
    by: str,
    colours: ColourArray | None,
    references: Mapping[str, float],
    frame: Frame | None,
    *,
    spins: FloatArray | None = None,
    field: FloatArray | None = None,
    theme: str = "dark",
) -> Legend:
    """Explain the views of a recording.

    Parameters
    ----------
    header
        What the recording states.
    by
        The property that sets the colours of the bodies.
    colours
        (n,) colours of the bodies, if they are constant during the run.
    references
        The magnitudes in the middle of the scales, as recorded.
    frame
        The step shown; None if it is not known. Its impulses set the scale of the arrows of impulses.
    spins
        (b, 3) rad/s of the bodies of the close-up, if there is one.
    field
        (3,) m/s², a uniform field.
    """
    lines = [*_bodies(header, by, colours, references), *_edges(header, frame, theme), *_arrows(header, references)]
    if spins is not None:
        fastest = float(np.linalg.norm(spins, axis=1).max(initial=0.0))
        if fastest > 0.0:
            text = header.units.text(fastest, dimension.ANGULAR_VELOCITY, ".3g")
            lines.append(LegendLine(f"→ spin, close up: 1.3 radii = {text}", palette.SPIN))
    if field is not None and np.any(field):
        size = header.units.text(float(np.linalg.norm(field)), dimension.ACCELERATION, ".4g")
        lines.append(LegendLine(f"→ gravity, {size}", palette.FIELD))
    return Legend(lines, theme)


def _bodies(
    header: Header, by: str, colours: ColourArray | None, references: Mapping[str, float]
) -> Iterator[LegendLine]:
    """Explain the colours of bodies."""
    if by == header.coloured_by and shape(header) == "mesh":
        yield LegendLine("■ all bodies; the dark half shows how they rotate", palette.SKY)
    elif by == "material" and header.materials:
        for name, colour in zip(header.materials.names, header.materials.colours, strict=True):
            yield LegendLine(f"■ {name}", colour)
    elif by in STATIC_COLOURS and colours is not None:
        yield from _groups(header, colours)
    elif by == "speed":
        scale, middle = colouring.SPEEDS.tolist(), references.get(SPEED, 0.0)
        known = by == header.coloured_by and middle > 0.0
        text = header.units.text(middle, dimension.VELOCITY, ".3g") if known else "the median speed"
        yield from (
            LegendLine("■ slow", scale[0]),
            LegendLine(f"■ {text}", scale[len(scale) // 2]),
            LegendLine("■ fast", scale[-1]),
        )
    elif by == "island":
        yield LegendLine("■ one colour: linked by contacts", palette.SKY)
        yield LegendLine("■ without contacts", palette.GREY)
    else:
        few = zip(palette.BODIES[:3], ("first", "second", "third"), strict=True)
        yield from (LegendLine(f"■ {name} colour of the graph", colour) for colour, name in few)
        yield LegendLine("■ without contacts", palette.GREY)


def _groups(header: Header, colours: ColourArray) -> Iterator[LegendLine]:
    """Explain colours by group: a line for each body if there are few, otherwise for each group."""
    names, known = list(header.names), colours.tolist()
    if len(known) <= MOST_NAMED and len(known) == len(names):
        yield from (LegendLine(f"■ {name or f'body {k}'}", known[k]) for k, name in enumerate(names))
        return
    if len(known) != len(names):  # a clip of some bodies
        return
    groups = np.unique(header.group)
    for group in groups[groups >= 0][:MOST_NAMED].tolist():
        members = np.flatnonzero(header.group == group)
        name = names[int(members[0])].rstrip(" 0123456789-_#") or f"group {group}"
        yield LegendLine(f"■ {name}, {len(members)} bodies, in shades", known[int(members[0])])
    single = np.flatnonzero(header.group == -1)
    yield from (LegendLine(f"■ {names[k] or f'body {k}'}", known[k]) for k in single[:MOST_NAMED].tolist())
    if len(single) > MOST_NAMED:
        yield LegendLine(f"and {len(single) - MOST_NAMED} more, in other shades", palette.GREY)


def _edges(header: Header, frame: Frame | None, theme: str) -> Iterator[LegendLine]:
    """Explain lines between touching bodies, and points at impacts."""
    if not header.collides:
        return
    if header.engine or theme == "light":
        yield LegendLine("— bodies that touch", palette.VERMILION)
    else:
        yield LegendLine("— contact, coloured by the solver's stage", palette.STAGES[0])
    if not header.records_contacts:
        return
    middle = _middle(header, frame)
    levels = drawing.COLOURS.tolist() if theme == "dark" else [palette.VERMILION] * drawing.LEVELS
    yield LegendLine("— thin edge: small impulse", levels[1])
    yield LegendLine(f"— edge: {middle or 'the median impulse'}", levels[len(levels) // 2])
    yield LegendLine("— wide edge: large impulse", levels[-1])
    yield LegendLine("■ impact: size = impulse, glow = lost energy", int(drawing.COLOURS[-2]))
    yield LegendLine(f"→ normal impulse: 1 radius = {middle or 'the median'}", palette.ARROWS[paths.FORCE_NORMAL])
    if header.has_friction:
        yield LegendLine("→ impulse of friction, same scale", palette.ARROWS[paths.FORCE_FRICTION])


def _middle(header: Header, frame: Frame | None) -> str:
    """Write the median impulse of a step, the middle of the scale; empty without impulses."""
    rows = None if frame is None else frame.contact_rows
    if rows is None:
        return ""
    positive = rows["normal_impulse"][rows["normal_impulse"] > 0.0]
    return header.units.text(float(np.median(positive)), dimension.IMPULSE, ".3g") if len(positive) else ""


def _arrows(header: Header, references: Mapping[str, float]) -> Iterator[LegendLine]:
    """State the scales of torques and angular accelerations: arrows are not proportional to them.

    A recording that knows the scales of other arrows had no torques.
    """
    for path, kind in _DIMENSIONS.items() if header.has_torque else ():
        name, colour = _NAMES[path], palette.ARROWS[path]
        if path not in references:
            if not references:
                yield LegendLine(f"→ {name}", colour)
            continue
        values = (magnitude_at(radii, REACH[path], float(references[path])) for radii in (1.0, _LARGE))
        one, more = (header.units.text(value, kind, ".2g") for value in values)
        if one.partition(" ")[2] == more.partition(" ")[2]:
            one = one.partition(" ")[0]  # the line is too short
        yield LegendLine(f"→ {name}, beyond the surface:", colour)
        yield LegendLine(f"→ 1 radius = {one}, {_LARGE:g} radii = {more}", colour)
