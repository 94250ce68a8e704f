"""A sweep as a table, one row per run, and a figure of two columns. The figure needs `carom[plot]`."""

from __future__ import annotations

import io
import json
import math
import re
from collections import defaultdict
from collections.abc import Callable, Sequence
from operator import eq, ge, gt, le, lt, ne
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet

from carom.errors import ExperimentError
from carom.lab.sweep.manifest import Folder, SweepRun, put
from carom.lab.sweep.plan import SEED
from carom.recording.export.spreadsheet import harmless
from carom.recording.write.whole_file import whole_file
from carom.scene.units.dimension import Physical, nearest_float, physical
from carom.scene.wording import in_figure, suggestion

Row = dict[str, Any]

_LAST = ("status", "outcome", "reason", "wall_time", "fingerprint", "file", "size", "worker")
_COMPARISONS: dict[str, Callable[[Any, Any], Any]] = {"<=": le, ">=": ge, "!=": ne, "=": eq, "<": lt, ">": gt}
_CONDITION = re.compile(r"\s*([^<>=!\s]+)\s*(<=|>=|!=|=|<|>)\s*(.*?)\s*")


def rows_of(runs: Sequence[SweepRun]) -> list[Row]:
    """Return one row per run; missing values are None."""
    rows = [
        {"name": run.name, **run.parameters, SEED: run.seed, **{key: getattr(run, key) for key in _LAST}, **run.results}
        for run in runs
    ]
    keys = dict.fromkeys(key for row in rows for key in row)
    return [{key: row.get(key) for key in keys} for row in rows]


def write(folder: Folder, runs: Sequence[SweepRun]) -> None:
    """Write the table as Parquet and as CSV. Raises OSError if the disk is full."""
    table = _table(rows_of(runs))
    parquet, text = io.BytesIO(), io.BytesIO()
    pa.parquet.write_table(table, parquet)
    pa.csv.write_csv(harmless(table), text)
    for path, content in zip(folder.tables, (parquet, text), strict=True):
        put(path, content.getvalue())


def write_csv(rows: Sequence[Row], path: Path) -> None:
    """Write rows with the same keys as a CSV file, which LaTeX and pandas read."""
    with whole_file(path) as part:
        pa.csv.write_csv(harmless(_table(rows)), str(part))


def _table(rows: Sequence[Row]) -> pa.Table:
    return pa.table({key: _column([row[key] for row in rows]) for key in rows[0]})


def chosen(rows: Sequence[Row], conditions: Sequence[str], sort: str | None) -> list[Row]:
    """Return the rows that meet all conditions, sorted by a column.

    Examples of conditions are ``contact.restitution>=0.5``, ``body.0.radius<60 cm`` and ``outcome=completed``; missing
    values meet no condition. With a minus before the column, the largest value comes first. Rows without a value come
    last. Raises ExperimentError if there is no such column, or a condition cannot be read.
    """
    met = [_met(condition, rows) for condition in conditions]
    found = [row for k, row in enumerate(rows) if all(one[k] for one in met)]
    if sort is None:
        return found
    key = known(sort.removeprefix("-"), rows)
    there = [row for row in found if row[key] is not None]
    there.sort(key=lambda row: _order(row[key]), reverse=sort.startswith("-"))
    return there + [row for row in found if row[key] is None]


def known(key: str, rows: Sequence[Row]) -> str:
    """Return the name of a column. Raises ExperimentError if there is none."""
    if key in rows[0]:
        return key
    raise ExperimentError(f"{key}: no such column; {suggestion(key, list(rows[0]))}")


def _met(condition: str, rows: Sequence[Row]) -> list[bool]:
    """Return for each row whether it meets a condition; a value of a different kind meets only ``!=``."""
    matched = _CONDITION.fullmatch(condition)
    if matched is None:
        raise ExperimentError(f"--filter {condition}: expected a comparison, such as contact.restitution>=0.5")
    key, compare, wanted = known(matched[1], rows), _COMPARISONS[matched[2]], matched[3]
    values = [row[key] for row in rows]
    there = [value for value in values if value is not None]
    met = [None if value is None else _compared(value, compare, wanted) for value in values]
    if there and all(one is None for one in met):  # no value can be compared with the condition
        example, text = there[0], _text(there[0])
        if _is_number(example):
            problem = f'is numeric; got "{wanted}"'
        elif physical(text):
            problem = f'has units, such as "{text}"; got "{wanted}"'
        else:
            problem = f'is text, such as "{text}"; compare it with = or !='
        raise ExperimentError(f"--filter {key}: column {key} {problem}")
    differs = [compare is ne and value is not None for value in values]
    return [other if one is None else one for one, other in zip(met, differs, strict=True)]


def _compared(value: Any, compare: Callable[[Any, Any], Any], wanted: str) -> bool | None:
    """Compare numbers, quantities with units by their sizes, or texts; None if the two are of different kinds."""
    if _is_number(value):
        try:
            return bool(compare(value, float(wanted)))
        except ValueError:
            return None
    text = _text(value)
    quantity, other = physical(text), physical(wanted)
    if quantity and other and quantity.unit.exponents == other.unit.exponents:
        return bool(compare(quantity.size, other.size))
    return bool(compare(text, wanted)) if compare in (eq, ne) else None


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _order(value: Any) -> tuple[int, Any]:
    """Sort numbers first, then quantities with units by their sizes, then text."""
    if isinstance(value, (int, float)):
        return 0, value
    quantity = physical(_text(value))
    return (2, _text(value)) if quantity is None else (1, (quantity.unit.exponents, quantity.size))


def _column(values: list[Any]) -> pa.Array:
    """Return a column of one type; lists, and values without a common type, are written as JSON."""
    kinds = {type(value) for value in values if value is not None}
    if kinds <= {int, float} or (len(kinds) == 1 and kinds <= {bool, str}):
        return pa.array([float(value) if kinds == {int, float} and value is not None else value for value in values])
    return pa.array([None if value is None else _text(value) for value in values], pa.string())


def _text(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value)


FIGURES = ".png", ".svg", ".pdf"
MOST_LINES = 12  # largest number of lines in the legend
_DECADES = 50.0  # largest ratio of an axis's ends for which the axis is linear

Points = dict[float, list[float]]  # all values of y, by value of x


def figure(rows: Sequence[Row], x: str, y: str, varied: Sequence[str], title: str, base: Path) -> list[Path]:
    """Draw ``y`` over ``x``, with a line for each combination of the other varied values; return the files.

    A point is the mean over runs that differ only in their seeds, with a bar for the range. The files are ``base`` with
    the endings in `FIGURES`, and a table of the points with ``.csv``. Raises ExperimentError if a column is not
    numeric, or no run has both values.
    """
    from matplotlib.figure import Figure  # noqa: PLC0415 - an extra

    others = [key for key in varied if key not in (x, y, SEED)]
    lines: dict[str, Points] = defaultdict(lambda: defaultdict(list))
    values_of: dict[str, Row] = {}  # values of the other varied keys of each line
    units = {key: _unit(rows, key) for key in (x, y)}
    for row in rows:
        if row[x] is not None and row[y] is not None:
            label = ", ".join(f"{key} = {row[key]}" for key in others)
            values_of[label] = {key: row[key] for key in others}
            lines[label][_number(row, x, units[x])].append(_number(row, y, units[y]))
    if not lines:
        raise ExperimentError(f"--plot: no run has both {x} and {y}")
    drawing = Figure(figsize=(7.0, 4.2), dpi=150, layout="constrained")
    axes = drawing.add_subplot()
    table = list[Row]()
    for label, points in lines.items():
        at = sorted(points)
        means = [math.fsum(points[value]) / len(points[value]) for value in at]
        below = [mean - min(points[value]) for mean, value in zip(means, at, strict=True)]
        above = [max(points[value]) - mean for mean, value in zip(means, at, strict=True)]
        spans = zip(at, means, (min(points[value]) for value in at), (max(points[value]) for value in at), strict=True)
        table += [
            {**values_of[label], x: value, y: mean, "least": least, "largest": largest, "runs": len(points[value])}
            for value, mean, least, largest in spans
        ]
        bars, name = (below, above), in_figure(label)
        axes.errorbar(at, means, yerr=bars, label=name, marker="o", markersize=4, capsize=3, linewidth=1.2)
    axes.set(xlabel=_labelled(x, units[x]), ylabel=_labelled(y, units[y]), title=in_figure(title))
    axes.grid(visible=True, alpha=0.3)
    all_x = [value for points in lines.values() for value in points]
    all_y = [value for points in lines.values() for values in points.values() for value in values]
    for axis, values in (("x", all_x), ("y", all_y)):
        if min(values) > 0.0 and max(values) > _DECADES * min(values):
            axes.set(**{f"{axis}scale": "log"})
    if others and len(lines) <= MOST_LINES:
        axes.legend(frameon=False)
    # names of columns contain dots, so `with_suffix` would cut them
    files = [base.with_name(base.name + ending) for ending in (*FIGURES, ".csv")]
    for path in files[:-1]:
        with whole_file(path) as part:
            drawing.savefig(part)
    write_csv(table, files[-1])
    return files


def _unit(rows: Sequence[Row], key: str) -> Physical | None:
    """Return the first quantity with a unit in a column; its unit becomes the unit of the axis."""
    quantities = (physical(row[key]) for row in rows if isinstance(row[key], str))
    return next((found for found in quantities if found), None)


def _labelled(key: str, unit: Physical | None) -> str:
    return in_figure(key if unit is None else f"{key} ({unit.unit_text})")


def _number(row: Row, key: str, axis: Physical | None) -> float:
    value = row[key]
    if isinstance(value, (int, float)) and axis is None:
        return float(value)
    found = physical(value) if isinstance(value, str) else None
    if found and axis and found.unit.exponents == axis.unit.exponents:
        return nearest_float(found.size / axis.unit.size)
    raise ExperimentError(f"--plot: {key} is {value!r} in {row['name']}, which is not a number")
