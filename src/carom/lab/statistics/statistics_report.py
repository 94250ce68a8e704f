"""All statistics of a recording, as text for people, as JSON and as a table of one row for each number."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
from rich.table import Table

from carom import Recording
from carom.errors import RecordingError
from carom.extend import UnitSystem, counted, print_whole, say
from carom.lab.statistics import (
    contact_network,
    force_chains,
    free_paths,
    impact_rates,
    pair_correlation,
    stress_tensor,
    velocity_distribution,
)
from carom.lab.statistics.interval import Interval, Watcher
from carom.lab.statistics.statistic import MeasuredValue, Statistic

KINDS: Mapping[str, tuple[str, Callable[[Interval], Statistic]]] = {  # name → title, function
    "free_paths": ("free times and free paths", free_paths.measure),
    "impacts": ("impacts", impact_rates.measure),
    "velocities": ("velocity distribution", velocity_distribution.measure),
    "stress": ("stress tensor", stress_tensor.measure),
    "pair_correlation": ("pair correlation", pair_correlation.measure),
    "contacts": ("network of lasting contacts", contact_network.measure),
    "forces": ("forces and force chains", force_chains.measure),
}
MOST_ROWS = 12  # in a printed table


class Statistics(NamedTuple):
    """The statistics of an interval of a recording."""

    interval: Interval
    kinds: Mapping[str, Statistic]

    @classmethod
    def of(
        cls, recording: Recording, start: float | None, end: float | None, replay: bool, watch: Watcher
    ) -> Statistics:
        """Measure all statistics from one time to another (s).

        Raises
        ------
        RecordingError
            If the recording has no data for any statistic.
        """
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
        """Return them as JSON, in the units of the recording."""
        first, last = self.interval.time[[0, -1]].tolist()
        return {
            "units": self.units.recorded,
            "from": first,
            "to": last,
            "frames": len(self.interval.step),
            "statistics": {name: kind.document(self.units) for name, kind in self.kinds.items()},
        }

    def table(self) -> pa.Table:
        """Return them as a table in the units of the recording: a row for each number and each bin of a histogram."""
        columns = ("statistic", "quantity", "index", "low", "high", "value", "error", "unit")
        rows = [dict(zip(columns, row, strict=True)) for name in self.kinds for row in self._rows(name)]
        kinds = [pa.string()] * 3 + [pa.float64()] * 4 + [pa.string()]
        return pa.Table.from_pylist(rows, pa.schema(zip(columns, kinds, strict=True)))

    def _rows(self, name: str) -> Iterator[tuple[Any, ...]]:
        """Yield the rows of one kind."""
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

    def print(self) -> None:
        """Print them for people, in the units of the scene."""
        interval = self.interval
        frames = counted(len(interval.step), "frame")
        say(f"{interval.recording.title}: {counted(interval.bodies, 'body')}, {interval.text}, {frames}")
        for name, kind in self.kinds.items():
            say(f"\n{KINDS[name][0]}")
            if kind.missing:
                say(f"  not measured: {kind.missing}")
                continue
            shown = Table(box=None, padding=(0, 1), show_header=False)
            shown.add_column(no_wrap=True)
            shown.add_column(no_wrap=True)
            for measured in kind.values.values():
                shown.add_row(f" {measured.label}", text(measured, self.units))
            print_whole(shown)
            if kind.rows:
                print_whole(self._shown_rows(kind))
            if kind.note:
                say(f"  {kind.note}")

    def _shown_rows(self, kind: Statistic) -> Table:
        """Lay out the rows of one kind."""
        shown = Table(box=None, padding=(0, 1), header_style="bold")
        for key, value in kind.rows[0].items():
            number = isinstance(value, MeasuredValue)
            label = self.units.labelled(value.label, value.dimension) if isinstance(value, MeasuredValue) else key
            shown.add_column(label, justify="right" if number else "left", no_wrap=True)
        for row in kind.rows[:MOST_ROWS]:
            texts = (text(v, self.units, unit=False) if isinstance(v, MeasuredValue) else str(v) for v in row.values())
            shown.add_row(*texts)
        return shown


def text(measured: MeasuredValue, units: UnitSystem, *, unit: bool = True) -> str:
    """Write a number with its error and unit, in the units of the scene."""
    if isinstance(measured.value, int):
        return str(measured.value)
    name = units.unit(measured.dimension) if unit else ""
    values = [units.shown(float(value), measured.dimension) for value in np.ravel(measured.value)]
    if np.ndim(measured.value) == 0:
        error = "" if measured.error is None else f" ± {units.shown(measured.error, measured.dimension):.2g}"
        return f"{values[0]:.4g}{error} {name}".rstrip()
    rows = np.reshape(values, (-1, np.shape(measured.value)[-1]))
    lines = ["  ".join(f"{value:10.4g}" for value in row) for row in rows.tolist()]
    return "\n".join([f"{lines[0]}  {name}".rstrip(), *lines[1:]])
