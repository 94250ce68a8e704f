"""Plots of single bodies: the rows for the viewer, and a view for each unit."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import rerun as rr
import rerun.blueprint as rrb

from carom.recording.layout.canvas import Area
from carom.recording.layout.curve import Curve
from carom.recording.layout.plot_views import time_series_view
from carom.recording.read.body_series import BodySeries
from carom.recording.schema.palette import LINES
from carom.recording.style.curve_style import curve_style
from carom.recording.write.rows import Index, Rows
from carom.scene.units.system import SI, UnitSystem

TITLES = {"m": "Position", "m/s": "Velocity", "rad/s": "Spin"}


@dataclass(frozen=True, slots=True)
class BodyPlots:
    """The series to plot."""

    series: Sequence[BodySeries]
    system: UnitSystem = SI  # of the recording
    alone: bool = False  # whether a plot fills the picture, which then shows no title: the legend says all

    @property
    def units(self) -> list[str]:
        """The units of the plots, from left to right."""
        return [unit for unit in TITLES if any(each.quantity.unit == unit for each in self.series)]

    def rows(self) -> Iterator[Rows]:
        """Yield the values."""
        for each in self.series:
            columns = rr.Scalars.columns(scalars=each.value)
            yield Rows(_path(each), Index(each.step, each.time), columns, each.value.nbytes)

    def statics(self) -> Iterator[tuple[str, rr.AsComponents]]:
        """Yield the styles of the curves; each curve of a plot has its own colour."""
        colours = list(LINES.values())
        for unit in self.units:
            for k, each in enumerate(self._of(unit)):
                yield _path(each), curve_style(self._legend(each), colours[k % len(colours)])

    def views(self, row: Area) -> list[rrb.View]:
        """Lay out a plot for each unit, side by side in a row."""
        area = Area(row.width / max(1, len(self.units)), row.height)
        return [self.view(unit, area) for unit in self.units]

    def view(self, unit: str, area: Area) -> rrb.View:
        """Lay out the plot of a unit."""
        series = self._of(unit)
        legends = [self._legend(each) for each in series]
        title = _named(series[0]) if len(series) == 1 else TITLES[unit]
        curves = [Curve.of(each.time, each.value) for each in series]
        return time_series_view(
            self._titled(title, unit),
            [_path(each) for each in series],
            legends if self.alone or len(legends) > 1 else [],
            curves,
            area,
        )

    def _legend(self, series: BodySeries) -> str:
        return self._titled(_named(series), series.quantity.unit) if self.alone else _named(series)

    def _titled(self, title: str, unit: str) -> str:
        """Return a title with the unit in which the recording has what is in this unit of SI."""
        recorded = self.system.recorded_unit(unit)
        return title if recorded == "1" else f"{title} ({recorded})"

    def _of(self, unit: str) -> list[BodySeries]:
        return [each for each in self.series if each.quantity.unit == unit]


def _path(series: BodySeries) -> str:
    return f"plot/body{series.body}/{series.quantity.name}"


def _named(series: BodySeries) -> str:
    return f"{series.name} {series.quantity.name}"
