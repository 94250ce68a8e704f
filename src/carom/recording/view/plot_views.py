"""The plots of the recorded series."""

from __future__ import annotations

import rerun as rr
import rerun.blueprint as rrb

from carom.recording.schema.header import Header
from carom.recording.schema.series import PLOTS, recorded


def plot_views(header: Header) -> list[rrb.View | rrb.Container]:
    """Make a column of tabs of the plots that stand together; plots without a series are left out."""
    paths: dict[str | None, list[str]] = {}
    for series in recorded(header):
        paths.setdefault(series.plot, []).append(series.path)
    columns = [[_plot(name, paths[name]) for name in column if name in paths] for column in PLOTS]
    return [tabs[0] if len(tabs) == 1 else rrb.Tabs(*tabs) for tabs in columns if tabs]


def _plot(name: str, contents: list[str]) -> rrb.TimeSeriesView:
    legend = rrb.PlotLegend(rrb.Corner2D.LeftTop)
    return rrb.TimeSeriesView(name=name, origin="/", contents=contents, plot_legend=legend, axis_x=whole_time())


def whole_time() -> rrb.TimeAxis:
    """Show all of the time: by default a plot shows no more than a minute about the cursor."""
    return rrb.TimeAxis(
        view_range=rr.TimeRange(start=rr.TimeRangeBoundary.infinite(), end=rr.TimeRangeBoundary.infinite())
    )
