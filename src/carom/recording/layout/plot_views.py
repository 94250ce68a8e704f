"""The plots of the recorded series, without series that stay at 0 or constant."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType

import rerun as rr
import rerun.blueprint as rrb

from carom.recording.layout.canvas import Area
from carom.recording.layout.curve import Curve
from carom.recording.layout.legend import place_legend
from carom.recording.schema.header import Header
from carom.recording.schema.series import PLOTS, Plot, Series, all_plots, recorded

Curves = Mapping[str, Curve]  # by the paths of the series

_ROUNDING = 1e-12  # of the largest energy; a curve of smaller ones shows rounding errors
_NUMBERS = (60.0, 18.0)  # points, width of the numbers beside a plot and height of those below it


def plot_views(header: Header, curves: Curves | None, row: Area) -> list[rrb.View | rrb.Container]:
    """Lay out the plots of a recording as columns of tabs.

    Parameters
    ----------
    header
        Of the recording; it says which series there are.
    curves
        The outlines of the recorded series, None during the run. Plots whose curves all stay at 0, or at energies that
        are rounding errors, are left out.
    row
        The area of all columns together.
    """
    plots = all_plots(recorded(header))
    columns = [[plot for plot in column if shown_series(header, plot, curves)] for column in plots]
    columns = [column for column in columns if column]
    area = Area(row.width / max(1, len(columns)), row.height)
    tabs = [[_plot(header, plot, curves, area) for plot in column] for column in columns]
    return [column[0] if len(column) == 1 else rrb.Tabs(*column) for column in tabs]


def energy_view(header: Header, curves: Curves | None, area: Area) -> rrb.View:
    """Lay out the plot of the energies alone, in an area of this size: without a title, so the legend has the unit."""
    plot = PLOTS[0][0]
    unit = header.units.recorded_unit(plot.unit)
    legends = {each: f"{each.legend} ({unit})" for each in shown_series(header, plot, curves)}
    return _laid_out(plot.name_in(header.units), legends, curves, area)


def shown_series(header: Header, plot: Plot, curves: Curves | None = None) -> list[Series]:
    """Return the series of a plot that are recorded and, if the curves are known, show something."""
    every = list(recorded(header))
    series = [each for each in every if each.plot == plot]
    if curves is None:
        return series
    energies = (curves[each.path].largest for each in every if each.unit == "J" and each.path in curves)
    negligible = _ROUNDING * max(energies, default=0.0)
    return [each for each in series if _speaks(each, curves, negligible)]


def _speaks(series: Series, curves: Curves, negligible: float) -> bool:
    """Tell whether a series shows something; ``negligible`` is an energy in J."""
    curve = curves.get(series.path)
    if curve is None or curve.largest <= (negligible if series.unit == "J" else 0.0):
        return False
    return not (series.flat_is_dull and curve.is_flat)


def _plot(header: Header, plot: Plot, curves: Curves | None, area: Area) -> rrb.TimeSeriesView:
    series = shown_series(header, plot, curves)
    legends = {each: each.legend if len(series) > 1 else "" for each in series}
    return _laid_out(plot.name_in(header.units, header.engine), legends, curves, area)


def _laid_out(title: str, legends: Mapping[Series, str], curves: Curves | None, area: Area) -> rrb.TimeSeriesView:
    """Lay out the plot of some series, with the texts of its legend; empty ones are left out."""
    known = [curves[each.path] for each in legends] if curves is not None else []
    texts = [text for text in legends.values() if text]
    names = {each.path: text for each, text in legends.items() if text not in ("", each.legend)}
    return time_series_view(title, [each.path for each in legends], texts, known, area, names)


def time_series_view(
    title: str,
    paths: Sequence[str],
    legends: Sequence[str],
    curves: Sequence[Curve],
    area: Area,
    renamed: Mapping[str, str] = MappingProxyType({}),
) -> rrb.TimeSeriesView:
    """Lay out a plot whose legend covers no curve.

    Parameters
    ----------
    title
        It stands above the plot, unless the plot fills the picture.
    paths
        Of the series.
    legends
        The lines of the legend; without any the plot has none.
    curves
        The outlines of the series; empty during the run.
    area
        Of the plot.
    renamed
        By path, the names of series in the legend that differ from the recorded ones.
    """
    between_axes = Area(max(1.0, area.width - _NUMBERS[0]), max(1.0, area.height - _NUMBERS[1]))
    place = place_legend(legends, curves, between_axes)
    return rrb.TimeSeriesView(
        name=title,
        origin="/",
        contents=list(paths),
        overrides={path: rr.SeriesLines.from_fields(names=name) for path, name in renamed.items()},
        plot_legend=rrb.PlotLegend(place.corner, visible=bool(legends)),
        axis_x=whole_time(),
        axis_y=None if place.range is None else rrb.ScalarAxis(range=place.range),
    )


def whole_time() -> rrb.TimeAxis:
    """Return an axis of the whole time; by default a plot shows a minute around the cursor."""
    return rrb.TimeAxis(
        view_range=rr.TimeRange(start=rr.TimeRangeBoundary.infinite(), end=rr.TimeRangeBoundary.infinite())
    )
