"""One column of a sweep over another. Needs `carom[plot]`."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from carom.errors import ExperimentError
from carom.lab.sweep.plan import SEED
from carom.lab.sweep.table import Row
from carom.recording.write.whole_file import whole_file
from carom.scene.units.unit import Physical, nearest_float, physical

MOST_LINES = 12  # in the legend
_DECADES = 50.0  # an axis is logarithmic if the ratio of its ends is larger

Points = dict[float, list[float]]  # all y of one x


def figure(rows: Sequence[Row], x: str, y: str, varied: Sequence[str], title: str, path: Path) -> None:
    """Draw ``y`` over ``x`` into a PNG, with a line for each combination of the other varied values.

    A point is the mean of the runs that differ only in their seeds; the bar is their range.

    Raises
    ------
    ExperimentError
        If a column is not numeric, or no run has both.
    """
    others = [key for key in varied if key not in (x, y, SEED)]
    lines: dict[str, Points] = defaultdict(lambda: defaultdict(list))
    units = {key: _unit(rows, key) for key in (x, y)}
    for row in rows:
        if row[x] is not None and row[y] is not None:
            label = ", ".join(f"{key} = {row[key]}" for key in others)
            lines[label][_number(row, x, units[x])].append(_number(row, y, units[y]))
    if not lines:
        raise ExperimentError(f"--plot: no run has both {x} and {y}")
    drawing = Figure(figsize=(7.0, 4.2), dpi=150, layout="constrained")
    axes = drawing.add_subplot()
    for label, points in lines.items():
        _line(axes, label, points)
    axes.set(xlabel=_labelled(x, units[x]), ylabel=_labelled(y, units[y]), title=title)
    axes.grid(visible=True, alpha=0.3)
    for axis, values in (("x", _all_x(lines)), ("y", _all_y(lines))):
        if min(values) > 0.0 and max(values) > _DECADES * min(values):
            axes.set(**{f"{axis}scale": "log"})
    if others and len(lines) <= MOST_LINES:
        axes.legend(frameon=False)
    with whole_file(path) as part:
        drawing.savefig(part)


def _line(axes: Any, label: str, points: Points) -> None:
    at = sorted(points)
    means = [math.fsum(points[value]) / len(points[value]) for value in at]
    below = [mean - min(points[value]) for mean, value in zip(means, at, strict=True)]
    above = [max(points[value]) - mean for mean, value in zip(means, at, strict=True)]
    axes.errorbar(at, means, yerr=(below, above), label=label, marker="o", markersize=4, capsize=3, linewidth=1.2)


def _unit(rows: Sequence[Row], key: str) -> Physical | None:
    """Return the first quantity with a unit in a column; its unit is that of the axis."""
    quantities = (physical(row[key]) for row in rows if isinstance(row[key], str))
    return next((found for found in quantities if found), None)


def _labelled(key: str, unit: Physical | None) -> str:
    return key if unit is None else f"{key} ({unit.unit_text})"


def _number(row: Row, key: str, axis: Physical | None) -> float:
    value = row[key]
    if isinstance(value, (int, float)) and axis is None:
        return float(value)
    found = physical(value) if isinstance(value, str) else None
    if found and axis and found.unit.exponents == axis.unit.exponents:
        return nearest_float(found.size / axis.unit.size)
    raise ExperimentError(f"--plot: {key} is {value!r} in {row['name']}, which is not a number")


def _all_x(lines: dict[str, Points]) -> list[float]:
    return [value for points in lines.values() for value in points]


def _all_y(lines: dict[str, Points]) -> list[float]:
    return [value for points in lines.values() for values in points.values() for value in values]
