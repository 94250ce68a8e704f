"""All statistics of a recording, as text, JSON, a table with a row for each number, and a figure."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pyarrow as pa

from carom.errors import RecordingError
from carom.lab.figure_style import FAINT, TEXT_IN_SVG, sheet, styled
from carom.lab.statistics import Interval, Watcher
from carom.lab.statistics.motion_statistics import (
    measure_free_paths,
    measure_impacts,
    measure_stress,
    measure_velocities,
)
from carom.lab.statistics.statistic import Histogram, MeasuredValue, Statistic
from carom.lab.statistics.structure_statistics import measure_forces, measure_network, measure_pair_correlation
from carom.recording.read.recording import Recording
from carom.recording.write.whole_file import whole_file
from carom.scene.units.system import UnitSystem
from carom.scene.wording import counted, in_figure
from carom.terminal.answers import CommandAnswer, Part, ShownColumn, ShownFacts, ShownTable

if TYPE_CHECKING:
    from matplotlib.axes import Axes

KINDS: Mapping[str, tuple[str, Callable[[Interval], Statistic]]] = {  # name → title, function
    "free_paths": ("free times and free paths", measure_free_paths),
    "impacts": ("impacts", measure_impacts),
    "velocities": ("velocity distribution", measure_velocities),
    "stress": ("stress tensor", measure_stress),
    "pair_correlation": ("pair correlation", measure_pair_correlation),
    "contacts": ("network of lasting contacts", measure_network),
    "forces": ("forces and force chains", measure_forces),
}
MOST_ROWS = 12  # largest number of rows of a printed table
COLUMNS = 3
FEWEST_BINS = 3  # smallest number of bins of a panel; fewer bins show no shape
PANEL = 3.5, 2.7  # width and height of a panel in inches
MEASURED, THEORY = "#0072b2", "#d55e00"


class Statistics(NamedTuple):
    """The statistics of an interval of a recording."""

    interval: Interval
    kinds: Mapping[str, Statistic]

    @classmethod
    def of(
        cls, recording: Recording, start: float | None, end: float | None, replay: bool, watch: Watcher
    ) -> Statistics:
        """Measure all statistics between two times (s); raises RecordingError if the data suffice for none of them."""
        interval = Interval.of(recording, start, end, replay, watch)
        kinds = dict[str, Statistic]()
        for name, (_, measure) in KINDS.items():
            try:
                kinds[name] = measure(interval)
            except RecordingError as error:
                kinds[name] = Statistic(missing=str(error))
        if all(kind.missing for kind in kinds.values()):
            raise RecordingError(next(iter(kinds.values())).missing)
        return cls(interval, kinds)

    @property
    def units(self) -> UnitSystem:
        """Units of the scene."""
        return self.interval.recording.units

    def document(self) -> dict[str, Any]:
        """Return the statistics as JSON, in the units of the recording."""
        first, last = self.interval.time[[0, -1]].tolist()
        return {
            "units": self.units.recorded,
            "from": first,
            "to": last,
            "frames": len(self.interval.step),
            "statistics": {name: kind.document(self.units) for name, kind in self.kinds.items()},
        }

    def table(self) -> pa.Table:
        """Return a table in the units of the recording, with a row for each number and each bin of a histogram."""
        columns = ("statistic", "quantity", "index", "low", "high", "value", "error", "unit")
        rows = [dict(zip(columns, row, strict=True)) for name in self.kinds for row in self._rows(name)]
        kinds = [pa.string()] * 3 + [pa.float64()] * 4 + [pa.string()]
        return pa.Table.from_pylist(rows, pa.schema(zip(columns, kinds, strict=True)))

    def _rows(self, name: str) -> Iterator[tuple[Any, ...]]:
        """Yield the rows of one kind of statistic."""
        kind, units = self.kinds[name], self.units
        singles = [(key, "", value) for key, value in kind.values.items()]
        for row in kind.rows:
            place = " | ".join(str(value) for value in row.values() if not isinstance(value, MeasuredValue))
            singles += [(key, place, value) for key, value in row.items() if isinstance(value, MeasuredValue)]
        for key, place, measured in singles:
            unit = units.recorded_unit(measured.dimension.unit or "1")
            for index, value in np.ndenumerate(measured.value):
                at = " ".join(filter(None, (place, *("xyz"[k] if k < 3 else str(k) for k in index))))
                yield name, key, at, None, None, float(value), measured.error, unit
        for key, histogram in kind.histograms.items():
            unit = units.recorded_unit(histogram.dimension.unit or "1")
            edges = histogram.edges.tolist()
            for low, high, value in zip(edges[:-1], edges[1:], histogram.values.tolist(), strict=True):
                yield name, key, "", low, high, value, None, unit

    def answer(self) -> CommandAnswer:
        """Return the statistics for programs, and for people in the units of the scene."""
        return CommandAnswer(self.document(), self._parts())

    def _parts(self) -> Iterator[Part]:
        interval = self.interval
        frames = counted(len(interval.step), "frame")
        yield f"{interval.recording.title}: {counted(interval.bodies, 'body')}, {interval.text}, {frames}"
        for name, kind in self.kinds.items():
            yield f"\n{KINDS[name][0]}"
            if kind.missing:
                yield f"  not measured: {kind.missing}"
                continue
            yield ShownFacts(((each.label, text(each, self.units)) for each in kind.values.values()), whole=True)
            if kind.rows:
                columns = [self._column(key, value) for key, value in kind.rows[0].items()]
                yield ShownTable(columns, kind.rows[:MOST_ROWS], self.units, indent=True)
            if kind.note:
                yield f"  {kind.note}"

    def _column(self, key: str, first: Any) -> ShownColumn:
        """Return a column of a statistic's table, given its first value."""
        if isinstance(first, MeasuredValue):
            return ShownColumn(first.label, lambda row: text(row[key], self.units, unit=False), first.dimension)
        return ShownColumn(key, lambda row: row[key], left=True)


def text(measured: MeasuredValue, units: UnitSystem, *, unit: bool = True) -> str:
    """Write a number with its error and unit, in the units of the scene."""
    if isinstance(measured.value, int):
        return str(measured.value)
    name = units.unit(measured.dimension) if unit else ""
    values = [units.shown(float(value), measured.dimension) for value in np.ravel(measured.value)]
    if np.ndim(measured.value) == 0:
        if np.isnan(values[0]):  # there were no bodies to measure
            return "none"
        error = "" if measured.error is None else f" ± {units.shown(measured.error, measured.dimension):.2g}"
        return f"{values[0]:.4g}{error} {name}".rstrip()
    rows = np.reshape(values, (-1, np.shape(measured.value)[-1]))
    lines = ["  ".join(f"{value:10.4g}" for value in row) for row in rows.tolist()]
    return "\n".join([f"{lines[0]}  {name}".rstrip(), *lines[1:]])


def draw(statistics: Statistics, path: Path) -> None:
    """Draw all histograms into a PNG or SVG, in the units of the scene.

    Raises RecordingError if there is no histogram, ExperimentError if matplotlib is not installed.
    """
    style = styled(8, **TEXT_IN_SVG)
    known = [histogram for kind in statistics.kinds.values() for histogram in kind.histograms.values()]
    histograms = [histogram for histogram in known if len(histogram.values) >= FEWEST_BINS]
    if not histograms:
        raise RecordingError("there are too few impacts and contacts for a figure")
    interval = statistics.interval
    with style:
        figure, panels = sheet(len(histograms), min(COLUMNS, len(histograms)), PANEL)
        for axes, histogram in zip(panels, histograms, strict=True):
            _panel(axes, histogram, statistics.units)
        figure.suptitle(f"{in_figure(interval.recording.title)}, {interval.text}", fontsize=10)
        with whole_file(path) as part:
            figure.savefig(part)


def _panel(axes: Axes, histogram: Histogram, units: UnitSystem) -> None:
    """Draw one histogram as steps, with the theoretical curve through the middles of the bins."""
    one = units.shown(1.0, histogram.dimension)
    edges = histogram.edges * one
    values, expected = histogram.values, histogram.expected
    unit = units.unit(histogram.dimension)
    label = histogram.function
    if not label:  # the values are a density
        values, expected = values / one, None if expected is None else expected / one
        inverse = f"({unit})⁻¹" if "/" in unit or " " in unit else f"{unit}⁻¹"
        label = f"density / {inverse}" if unit else "density"
    axes.stairs(values, edges, color=MEASURED, fill=True, alpha=0.25)
    axes.stairs(values, edges, color=MEASURED, linewidth=1.0, label="measured")
    if expected is not None:
        axes.plot((edges[1:] + edges[:-1]) / 2, expected, color=THEORY, linewidth=1.0, label=histogram.theory)
        axes.legend(frameon=False, fontsize=7)
    if histogram.function.startswith("pair"):
        axes.axhline(1.0, color=FAINT, linewidth=0.8, linestyle=":")
    if histogram.falls and (values > 0.0).sum() >= FEWEST_BINS:
        axes.set_yscale("log")
    else:
        axes.set_ylim(bottom=0.0)
    axes.set(xlabel=f"{histogram.label} / {unit}" if unit else histogram.label, ylabel=label)
    axes.set_xlim(edges[0], edges[-1])
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(which="both", color=FAINT)
