"""The lines of a legend, and their places in a view or in a corner of a picture."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import ArrayLike

from carom.arrays import FloatArray
from carom.display.letters import drawable, label_width, padded
from carom.display.supplement import Static
from carom.recording.layout.canvas import LEGEND, Area, View
from carom.recording.layout.drawing import single
from carom.recording.schema import palette
from carom.recording.write.rows import NO_STEPS, Index, Rows

BODIES, GRAPH = "bodies", "graph"  # views
SPACE = (BODIES, GRAPH)
CLOCK = f"{LEGEND}/clock"
_LEAST_NAMED = 2  # smallest number of lines about bodies in a legend
_ROW = 25.0  # points, distance from one line to the next
_MARGIN = 5.0  # points, margin around the lines
# width of a legend inside a picture, in points and as a share of the picture
_WIDEST, _NARROWEST, _MOST_OF_VIEW = 400.0, 200.0, 0.3


@dataclass(frozen=True, slots=True)
class LegendLine:
    """A line of the legend."""

    text: str
    colour: int  # 0xRRGGBBAA
    views: Sequence[str] = ()  # views whose legend has this line in a picture of a single view
    bodies: int = 0  # bodies that the line names, in a list that may be folded
    is_clock: bool = False  # whether its text changes with time
    is_extra: bool = False  # whether it is left out where there is no room for all lines

    @property
    def width(self) -> float:
        """Its width in points."""
        return label_width(self.text)


@dataclass(frozen=True, slots=True)
class MovieClock:
    """The texts of the clock in the legend of a movie, each with the time from which it applies."""

    times: FloatArray  # (k,) s, time from which each text applies
    texts: Sequence[str]  # (k,) texts of the clock


@dataclass(frozen=True, slots=True)
class Legend:
    """The lines, from top to bottom, with a title and, in a movie, a clock above them."""

    entries: Sequence[LegendLine]
    theme: str = "dark"
    clock: MovieClock | None = None

    def titled(self, title: str, clock: MovieClock | str = "") -> Legend:
        """Return the lines below a title and a clock; if the clock is a text, it does not change."""
        ink = palette.INKS[self.theme]
        head = [LegendLine(title, ink, SPACE)] if title and drawable(title) else []
        if isinstance(clock, MovieClock):
            head.append(LegendLine(max(clock.texts, key=label_width), ink, SPACE, is_clock=True))
        elif clock:
            head.append(LegendLine(clock, ink, SPACE))
        return replace(self, entries=[*head, *self.entries], clock=clock if isinstance(clock, MovieClock) else None)

    def grouped(self, graph: str, more: Mapping[str, Sequence[LegendLine]]) -> Legend:
        """Return the lines about all views, then groups with headings: lines about the graph only, and more lines.

        If there is no room, the headings and the optional lines of the groups are left out first.
        """
        ink, own = (
            palette.INKS[self.theme],
            [line for line in self.entries if line.views == (GRAPH,) and not line.bodies],
        )
        entries = [line for line in self.entries if line not in own]
        for heading, lines in {graph: own, **more}.items():
            entries += [LegendLine(f"{heading}:", ink, is_extra=True), *lines] if lines else []
        return replace(self, entries=entries)

    def fitted(self, area: Area) -> Legend:
        """Return a legend that fits into an area: long lines are broken, and the last of many bodies are left out."""
        entries, rows = list(self.entries), int((area.height - 2.0 * _MARGIN) / _ROW)
        while len(found := list(_wrapped(entries, area.width))) > rows:
            extra = next((k for k in reversed(range(len(entries))) if entries[k].is_extra), None)
            if extra is not None:
                del entries[extra]
                continue
            named = [k for k, entry in enumerate(entries) if entry.bodies]
            if len(named) <= _LEAST_NAMED:
                break
            last, more = (entries.pop(k) for k in (named[-1], named[-2]))
            entries.insert(named[-2], more_bodies(last.bodies + more.bodies))
        return replace(self, entries=found)

    def of(self, view: str, area: Area) -> Legend:
        """Return the lines about one view, for a corner of this area."""
        return replace(self, entries=[entry for entry in self.entries if view in entry.views]).wrapped(area)

    def wrapped(self, area: Area) -> Legend:
        """Return the lines for a corner of this area."""
        return self.fitted(replace(area, width=min(_WIDEST, max(_NARROWEST, _MOST_OF_VIEW * area.width))))

    @property
    def size(self) -> tuple[float, float]:
        """Width and height of the lines, in points; zeros without lines."""
        if not self.entries:
            return 0.0, 0.0
        return max(entry.width for entry in self.entries) + 2.0 * _MARGIN, _ROW * len(self.entries) + 2.0 * _MARGIN

    def view(self, area: Area) -> rrb.Spatial2DView:
        """Lay out the lines in a view of this size or in a larger view."""
        return rrb.Spatial2DView(
            name="Legend",
            origin=LEGEND,
            background=rrb.Background(color=palette.GROUNDS[self.theme], kind=rrb.BackgroundKind.SolidColor),
            visual_bounds=rrb.VisualBounds2D(x_range=[0.0, area.width], y_range=[0.0, area.height]),
        )

    def beside(self, area: Area) -> DrawnLabels:
        """Return the lines for a view of this area as labels of invisibly small points.

        A label is centred below its point, and its size does not depend on the size of the view. Spaces make all labels
        equally wide, so that their left ends are below one another in larger views, too.
        """
        fitted, wide = self.fitted(area), area.width - 2.0 * _MARGIN
        return fitted._drawn(
            rr.Points2D,
            1e-3,
            lambda text: padded(text, wide),
            lambda _, row, __: (0.5 * area.width, _MARGIN + _ROW * row),
        )

    def inside(self, view: View, area: Area, corner: tuple[int, int], poses: Sequence[View] = ()) -> DrawnLabels:
        """Return the labels for a corner of a 3D view; the clock is repeated for each of the ``poses``, if any."""
        start = (np.array([area.width, area.height]) - self.size) * [corner[0] > 0, corner[1] < 0]

        def place(text: str, row: int, time: int | None = None) -> FloatArray:
            pose = view if time is None or not poses else poses[time]
            point = start + np.array([_MARGIN + 0.5 * label_width(text), _MARGIN + _ROW * row])
            shift = (point - [0.5 * area.width, 0.5 * area.height]) * [1.0, -1.0]
            return np.asarray(pose.target + pose.height() / area.height * shift @ pose.axes())

        return self._drawn(rr.Points3D, 1e-6 * view.height(), str, place)

    def _drawn(
        self,
        archetype: type[rr.Points2D] | type[rr.Points3D],
        radius: float,
        written: Callable[[str], str],
        place: Callable[[str, int, int | None], ArrayLike],
    ) -> DrawnLabels:
        """Draw the lines as labels; ``place`` returns the point of a text in a row, at the k-th time of the clock."""
        colours = palette.readable([entry.colour for entry in self.entries], self.theme)
        still = [row for row, entry in enumerate(self.entries) if not entry.is_clock]
        texts = [self.entries[row].text for row in still]
        points = single(np.array([place(text, row, None) for text, row in zip(texts, still, strict=True)]))
        common: dict[str, Any] = {"radii": radius, "show_labels": True}
        statics: list[Static] = []
        if still:
            labels = [written(text) for text in texts]
            statics.append((LEGEND, archetype(points, labels=labels, colors=colours[still], **common)))
        if self.clock is None or len(still) == len(self.entries):
            return DrawnLabels(statics, [])
        row = next(row for row, entry in enumerate(self.entries) if entry.is_clock)
        statics.append((CLOCK, archetype.from_fields(colors=colours[[row]], **common)))
        points = single(np.array([place(text, row, k) for k, text in enumerate(self.clock.texts)]))
        columns = archetype.columns(positions=points, labels=[written(text) for text in self.clock.texts])
        return DrawnLabels(statics, [Rows(CLOCK, Index(NO_STEPS, self.clock.times), columns)])


class DrawnLabels(NamedTuple):
    """Static data, and rows."""

    statics: Sequence[Static]
    rows: Sequence[Rows]


def _wrapped(entries: Sequence[LegendLine], width: float) -> Iterator[LegendLine]:
    """Yield the lines, broken between words where they are wider than a view of this width (points)."""
    for entry in entries:
        line, *words = entry.text.split(" ")
        for word in words:
            if replace(entry, text=f"{line} {word}").width + 2.0 * _MARGIN > width and line.strip("→—■• "):
                yield replace(entry, text=line)
                line = "    "
            line = f"{line} {word}"
        yield replace(entry, text=line)


def more_bodies(count: int) -> LegendLine:
    """Return the line that stands for a number of further bodies."""
    return LegendLine(f"and {count} more", palette.GREY, SPACE, count)
