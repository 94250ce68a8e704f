"""The plots of the recorded series: legends that cover no curve, and the views.

Series that stay at 0 or do not change are omitted.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from rerun.blueprint.api import VisualizerLike
from rerun.components import AggregationPolicy
from rerun.encodings import EntityPathLike

from carom.arrays import IntArray
from carom.recording.layout.canvas import NONE, Additions, Area, taken_from
from carom.recording.schema import palette, paths
from carom.recording.schema.curve_outline import CurveOutline, Curves
from carom.recording.schema.header import Header
from carom.recording.schema.series import (
    CONTACTS,
    IMPULSES,
    IN_PLOT,
    PLOTS,
    THIN,
    Plot,
    Series,
    all_plots,
    recorded,
)


def curve_style(legend: str, colour: int, width: float = THIN) -> rr.SeriesLines:
    """Style a curve; a pixel that covers many frames shows their lowest and highest value, so that no peak is lost."""
    return rr.SeriesLines(names=legend, colors=colour, widths=width, aggregation_policy=AggregationPolicy.MinMax)


# Placement of a plot's legend, so that it covers no curve. Rerun draws the legend into a corner of the plot, over the
# curves. The size of the legend is computed from its texts, the size of the plot from the layout and its window. If a
# curve passes behind the legend, the vertical axis is extended on that side. The corner that needs the shortest axis is
# chosen.

_ROW, _FRAME = 23.0, 14.0  # px, measured: height of a line, and of the frame with its distance from the border
_LETTER, _DOT = 7.0, 44.0  # px, measured: width of a wide letter, and of the dot with the frame
_PAD = 0.05  # fraction of the range of values that is left free above and below
_FLAT = 1e-9  # fraction of a value; a smaller range is rounding, and is not magnified
# largest fraction of the plot's height for a legend; a larger legend would leave too little for the curves
_LARGEST = 0.75


@dataclass(frozen=True, slots=True)
class Place:
    """The legend's corner, and the range of the vertical axis; None if the viewer fits it to the values."""

    corner: rrb.Corner2D
    range: tuple[float, float] | None


def place_legend(legends: Sequence[str], curves: Sequence[CurveOutline], plot: Area) -> Place:
    """Choose the corner of a legend with these lines, and the range of the axis, for a plot with this area."""
    low, high = _union(curves)
    if not high >= low:
        return Place(rrb.Corner2D.LeftTop, None)
    size = max(abs(low), abs(high))
    pad = _PAD * (high - low) if high - low > _FLAT * size else size or 1.0
    bottom, top = low - pad, high + pad
    if not legends:
        return Place(rrb.Corner2D.LeftTop, (bottom, top))
    tall = min(_LARGEST, (_ROW * len(legends) + _FRAME) / plot.height)
    wide = min(1.0, _width(legends) / plot.width)
    start, end = min(curve.times()[0] for curve in curves), max(curve.times()[1] for curve in curves)
    left, right = (start, start + wide * (end - start)), (end - wide * (end - start), end)
    ranges = {}
    for corner, window in ((rrb.Corner2D.LeftTop, left), (rrb.Corner2D.RightTop, right)):
        reach = _union(curves, *window)[1]
        ranges[corner] = bottom, max(top, (reach - tall * bottom) / (1.0 - tall))
    for corner, window in ((rrb.Corner2D.RightBottom, right), (rrb.Corner2D.LeftBottom, left)):
        reach = _union(curves, *window)[0]
        ranges[corner] = min(bottom, (reach - tall * top) / (1.0 - tall)), top
    return Place(*min(ranges.items(), key=lambda place: place[1][1] - place[1][0]))


def time_beside_legend(legends: Sequence[str], nanoseconds: IntArray, width: float) -> rrb.TimeAxis:
    """Return a time axis with space for a legend beside the curves; times are in ns as recorded, the width in px."""
    start, end = nanoseconds.tolist()
    wide = min(_LARGEST, _width(legends) / width) if legends else 0.0
    return _axis(start, int(end + (end - start) * wide / (1.0 - wide)))


def _axis(start: int, end: int) -> rrb.TimeAxis:
    """Return an axis from one time to another, in ns as recorded."""
    first, last = (rr.TimeRangeBoundary.absolute(nanos=at) for at in (start, end))
    return rrb.TimeAxis(view_range=rr.TimeRange(start=first, end=last))


def _width(legends: Sequence[str]) -> float:
    return _LETTER * max(map(len, legends)) + _DOT


def _union(curves: Sequence[CurveOutline], *window: float) -> tuple[float, float]:
    """Return the lowest and the highest value of all curves in a window of time."""
    ranges = [(np.inf, -np.inf), *(curve.range(*window) for curve in curves)]
    return min(low for low, _ in ranges), max(high for _, high in ranges)


# fraction of the largest energy, the energy scale, or a radius; a smaller curve shows rounding errors
_ROUNDING = 1e-12
_SHARES = ("energy/relative_error", "step/relative_overlap")  # series in units of the energy scale or of a radius
_RATE = "step/impact_rate"
_ABOVE = 1.1  # ratio of the end of the axis to the largest impulse
_MARKER = 3.5  # points, radius of the mark of an impact
_NUMBER = 28.0  # points, half the width of a number below a plot
_NUMBERS = (60.0, 18.0)  # points, width of the numbers beside a plot, and height of the numbers below it


def plot_views(
    header: Header, curves: Curves | None, row: Area, added: Additions = NONE
) -> list[rrb.View | rrb.Container]:
    """Lay out the plots of a recording as columns of tabs, in an area for all columns; the first tab is in view.

    ``curves`` is None during the run. Plots are omitted if all their curves stay at 0, or if they show only the
    rounding of energies, errors or overlaps.
    """
    columns: list[list[Plot]] = []
    for column in all_plots(recorded(header)):
        shown = [plot for plot in column if shown_series(header, plot, curves)]
        if CONTACTS in column and header.records_contacts and (curves is None or _largest(curves, _RATE) > 0.0):
            # Impacts come first if there are any. Contacts come first as long as nothing is known, and if a plot of all
            # impacts would slow the viewer down.
            shown.insert(0 if curves is not None and paths.IMPACTS in curves else 1, IMPULSES)
        if shown:
            columns.append(shown)
    area = replace(row, width=row.width / max(1, len(columns)))
    tabs = [[_plot(header, plot, curves, area, added.span) for plot in column] for column in columns]
    if added.decades:
        tabs[0].insert(0, _decades(header, added.decades, area, added.span))
    return [column[0] if len(column) == 1 else rrb.Tabs(*column) for column in tabs]


def _largest(curves: Curves, path: str) -> float:
    return curves[path].largest if path in curves else 0.0


# Rerun 0.41 has no logarithmic axis. After an explosion, an axis of energies would show a single step, and everything
# before it as zero, so the logarithms are plotted instead.

_DECADES = 1e3  # if energies grow by more than this factor, their logarithms are plotted
DECADES = "decades"


def grows_by_decades(curves: Iterable[CurveOutline]) -> bool:
    """Return whether the largest energy exceeds a thousand times the first or the median energy."""
    outlines = list(curves)
    largest = max((curve.largest for curve in outlines), default=0.0)
    usual = max((curve.usual for curve in outlines), default=0.0)
    first = max((curve.first for curve in outlines), default=0.0)
    return np.isfinite(largest) and largest > _DECADES * min(usual, first) > 0.0


def _decades(header: Header, curves: Curves, area: Area, span: IntArray | None) -> rrb.TimeSeriesView:
    """Lay out the plot of the logarithms of energies."""
    unit = header.plot_unit(PLOTS[0][0].unit)
    legends = [each.name_in(header) for each in recorded(header) if each.path in curves]
    paths_of = [f"{DECADES}/{path}" for path in curves]
    title = "log10 of energy" if unit == "1" else f"log10 of energy in {unit}"
    return time_series_view(title, paths_of, legends, list(curves.values()), area, span=span)


def energy_view(header: Header, curves: Curves | None, area: Area, added: Additions) -> rrb.View:
    """Lay out the plot of the energies alone in an area of this size; the legend states title and unit."""
    plot = PLOTS[0][0]
    series = shown_series(header, plot, curves)
    return _laid_out(header, plot, series, curves, area, added.span, named=True, caption=added.caption)


CAPTION = "caption"  # entities of the title of a plot; the viewer sorts the lines of a legend by entity


def shown_series(header: Header, plot: Plot, curves: Curves | None = None) -> list[Series]:
    """Return the recorded series of a plot, without series whose known curves are flat."""
    every = list(recorded(header))
    series = [each for each in every if each.plot == plot]
    if curves is None:
        return series
    energies = (curves[each.path].largest for each in every if each.unit == "J" and each.path in curves)
    negligible, kept = _ROUNDING * max(energies, default=0.0), list[Series]()
    for each in series:
        curve = curves.get(each.path)
        rounding = negligible if each.unit == "J" else _ROUNDING if each.path in _SHARES else 0.0
        if curve is not None and curve.largest > rounding and not (each.flat_is_dull and curve.is_flat):
            kept.append(each)
    return kept


def _plot(header: Header, plot: Plot, curves: Curves | None, area: Area, span: IntArray | None) -> rrb.TimeSeriesView:
    if plot == IMPULSES:
        points = rr.SeriesPoints.from_fields(
            colors=palette.IMPACTS, markers="circle", marker_sizes=_MARKER, names="normal impulse"
        )
        factor = header.plot_factor(plot.unit)
        largest = 0.0 if curves is None else _largest(curves, paths.IMPACTS) / factor
        column = "normal_impulse" if factor == 1.0 else IN_PLOT
        impulses = points.visualizer(mappings=taken_from({"Scalars:scalars": column}))
        return rrb.TimeSeriesView(
            name=plot.name_in(header),
            origin="/",
            contents=[paths.IMPACTS],
            overrides={paths.IMPACTS: impulses},
            plot_legend=rrb.PlotLegend(visible=False),
            axis_x=time_axis(area, span),
            axis_y=rrb.ScalarAxis(range=(0.0, _ABOVE * largest)) if largest > 0.0 else None,
        )
    series = shown_series(header, plot, curves)
    return _laid_out(header, plot, series, curves, area, span, named=len(series) > 1 or plot.unit == "J")


def _laid_out(
    header: Header,
    plot: Plot,
    series: Sequence[Series],
    curves: Curves | None,
    area: Area,
    span: IntArray | None,
    *,
    named: bool,  # whether the plot has a legend
    caption: Sequence[str] = (),
) -> rrb.TimeSeriesView:
    """Lay out a plot of some series."""
    factor, entities = header.plot_factor(plot.unit), [each.path for each in series]
    known = [curves[each].over(factor) for each in entities] if curves is not None else []
    texts = [each.name_in(header) for each in series] if named else []
    styles = dict[EntityPathLike, VisualizerLike]()
    if factor != 1.0:
        style = rr.SeriesLines.from_fields().visualizer(mappings=taken_from({"Scalars:scalars": IN_PLOT}))
        styles |= dict.fromkeys(entities, style)
    return time_series_view(plot.name_in(header), entities, texts, known, area, styles, span, caption)


def time_series_view(
    title: str,
    entities: Sequence[str],
    legends: Sequence[str],
    curves: Sequence[CurveOutline],
    area: Area,
    styles: Mapping[EntityPathLike, VisualizerLike] = MappingProxyType({}),
    span: IntArray | None = None,
    caption: Sequence[str] = (),
) -> rrb.TimeSeriesView:
    """Lay out a plot of some entities, with its legend where it covers no known curve.

    ``styles`` override the recorded styles of the series by path; for ``span``, see `time_axis`. The legend begins with
    the lines of a ``caption``.
    """
    entities, legends = [*(f"{CAPTION}/{line}" for line in range(len(caption))), *entities], [*caption, *legends]
    between_axes = Area(max(1.0, area.width - _NUMBERS[0]), max(1.0, area.height - _NUMBERS[1]))
    place = place_legend(legends, curves, between_axes)
    return rrb.TimeSeriesView(
        name=title,
        origin="/",
        contents=list(entities),
        overrides=dict(styles),
        plot_legend=rrb.PlotLegend(place.corner, visible=bool(legends)),
        axis_x=time_axis(area, span),
        axis_y=None if place.range is None else rrb.ScalarAxis(range=place.range),
    )


def time_axis(area: Area, span: IntArray | None) -> rrb.TimeAxis:
    """Return an axis of the whole time, or of a ``span``, (2,) ns, with space for the number at the axis's end.

    The ends of a span are on one timeline, which suits pictures, where nobody selects another timeline.
    """
    if span is None:
        return whole_time()
    start, end = span.tolist()
    width = max(_NUMBER, area.width - _NUMBERS[0] - _NUMBER)
    end = start + _labelled(end - start, width)
    return _axis(start, end + int((end - start) * _NUMBER / width))


_SECOND = 10**9  # ns
# ns, possible distances between the times that Rerun 0.41 writes below a plot
_TICKS: tuple[int, ...] = (
    *(_SECOND // 10**k for k in range(9, 0, -1)),
    *(_SECOND * each for each in (1, 10, 60, 600, 3600, 43_200, 86_400)),
)
_TICK_WIDTH = 80.0  # points, smallest distance between these times; measured
_LONGER = 2.0  # largest factor by which an axis is made longer


def _labelled(length: int, width: float) -> int:
    """Return the length (ns) of an axis of some width (points), extended if the viewer would label only its start."""
    shown = [tick for tick in _TICKS if width * tick >= _TICK_WIDTH * length]
    if not shown or shown[0] <= length or shown[0] > _LONGER * length:
        return length
    return shown[0]


def whole_time() -> rrb.TimeAxis:
    """Return an axis of the whole time; by default a plot shows a minute around the cursor."""
    return rrb.TimeAxis(
        view_range=rr.TimeRange(start=rr.TimeRangeBoundary.infinite(), end=rr.TimeRangeBoundary.infinite())
    )
