"""Tables with several steps: finds the rows of a long table, or the axis of an array, for the step that a scene reads.

A long table has a row for each body and step: the names of its bodies repeat beside a column of times. An array of
shape (steps, n, 3) may also have the bodies first; the other arrays of the file, or ``count``, decide which axis has
the steps.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from carom.arrays import BoolArray
from carom.errors import SceneError
from carom.scene.data import DataTable, Raw, numbers_of, step_at
from carom.scene.data.facts import FileColumn, column_factor, plain_name
from carom.scene.schema.body import BodyData
from carom.scene.units.dimension import TIME
from carom.scene.units.system import UnitSystem

# plain names of columns of times
_TIMES = (
    *("t", "time", "simtime", "frame", "step", "timestep", "snapshot"),
    *("jd", "jdtdb", "epochjd", "epoch", "date", "datetime"),
)
_BODIES = (
    *("id", "bodyid", "particleid", "objectid", "planetid", "starid", "noradid"),
    *("name", "names", "label", "fullname", "body", "particle", "object", "planet", "target", "hash"),
)
_BRACKETS = re.compile(r"\s*[\[(]")  # start of a remark in brackets, as in "date (JD)"
_ROUNDED = 1e-8  # relative error of a time that was printed and typed again


class Steps(NamedTuple):
    """The columns of a table that may distinguish its steps."""

    times: list[FileColumn]
    bodies: list[FileColumn]

    @property
    def names(self) -> list[str]:
        """Names of the columns to read."""
        return [column.name for column in (*self.times, *self.bodies)]


def steps_in(columns: Sequence[FileColumn]) -> Steps:
    """Return the columns of times and of bodies."""
    known = [column.with_suffix(TIME, brief=False) or column for column in columns]
    times = [column for name in _TIMES for column in known if plain_name(_BRACKETS.split(column.proper)[0]) == name]
    return Steps(times, [column for column in columns if column.plain in _BODIES])


def rows_of_step(
    section: BodyData, table: DataTable, steps: Steps, raw: Mapping[str, Raw], rows: int, units: UnitSystem
) -> tuple[BoolArray | None, str, list[str]]:
    """Choose the rows of one step of a long table.

    Returns
    -------
    mask, note, choosing
        Mask of the rows (n,), or None for all rows; a note on these rows; the columns by which they were chosen.
    """
    there = [each for each in steps.times if raw[each.name].shape == (rows,)]
    several = [each for each in there if len(_distinct(raw[each.name])) > 1]
    if section.count == rows or not several:
        if section.snapshot_time is not None and not table.timed:
            raise SceneError(f"{table.called}: carom finds no times of steps in it; choose one with snapshot = 0, 1 …")
        if section.count != rows:
            _refuse_repeated_names(table, steps, raw, rows)
        return None, "", []
    by = several[0]
    values = _distinct(raw[by.name])
    known = [each for each in steps.bodies if raw[each.name].shape == (rows,)]
    again = next((each for each in known if len(set(raw[each.name].tolist())) < rows), None)
    is_chosen = section.snapshot_time is not None or "snapshot" in section.model_fields_set
    if again is None and known and not is_chosen:
        return None, "", []
    if again is None and not is_chosen:
        raise SceneError(
            f"{table.called}: column {by.shown} has {len(values)} values and no column names the bodies; write "
            f"snapshot = -1 to read the rows of its last value, or count = {rows} if each row is a body"
        )
    index = step_at(table.called, section.snapshot, len(values))
    if section.snapshot_time is not None:
        by = next((each for each in several if each.plain in ("t", "time", "simtime")), by)
        values = _distinct(raw[by.name])
        times = numbers_of(table.called, by.name, values)
        times = times * column_factor(table.called, by, table.facts, "time", (TIME,), units)
        wanted, rounding = section.snapshot_time, _ROUNDED * float(np.abs(times).max())
        if not times.min() - rounding <= wanted <= times.max() + rounding:
            raise SceneError(
                f"{table.called}: snapshot_time = {units.text(wanted, TIME)} is outside of its {len(times)} steps, "
                f"from {units.span(float(times.min()), float(times.max()), TIME)}"
            )
        index = int(np.argmin(np.abs(times - wanted)))
    shown = _text(values[index])
    note = f"{table.called}: step {index} of {len(values)} (from 0), {by.shown} = {shown}, is read"
    return raw[by.name] == values[index], note, [by.name, *([again.name] if again else [])]


def _refuse_repeated_names(table: DataTable, steps: Steps, raw: Mapping[str, Raw], rows: int) -> None:
    """Refuse a table in which each of several names occurs equally often, although no column has times."""
    for column in steps.bodies:
        values = raw[column.name]
        counts = Counter(values.tolist()) if values.shape == (rows,) else Counter[object]()
        if 1 < len(counts) < rows and len(set(counts.values())) == 1:
            raise SceneError(
                f"{table.called}: each of {len(counts)} values of {column.shown} occurs {rows // len(counts)} times, "
                f"as if the rows were steps, but no column has times; write count = {rows} if each row is a body, "
                "or keep the rows of one step in the file"
            )


def _distinct(values: Raw) -> Raw:
    """Return the distinct values, in the order of their first rows."""
    try:
        _, first = np.unique(values, return_index=True)
    except TypeError:  # raised for texts with gaps
        _, first = np.unique(values.astype(str), return_index=True)
    return np.asarray(values[np.sort(first)])


def _text(value: object) -> str:
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)


def axis_of_steps(
    section: BodyData, table: DataTable, steps: Steps, raw: Mapping[str, Raw], dimensions: Mapping[str, int]
) -> int:
    """Return the axis of the steps in arrays with several steps, 0 or 1; raise SceneError if nothing decides.

    ``dimensions`` has, for each array, the number of axes of a single step.
    """
    stacked = [name for name, own in dimensions.items() if raw[name].ndim == own + 1]
    if not stacked:
        return 0
    shape = raw[stacked[0]].shape
    bodies = {len(raw[name]) for name, own in dimensions.items() if raw[name].ndim == own}
    bodies |= set() if section.count is None else {section.count}
    times = {len(raw[each.name]) for each in steps.times if raw[each.name].ndim == 1}
    told = bool(bodies or times)
    for axis in (0, 1):
        if told and (not bodies or shape[1 - axis] in bodies) and (not times or shape[axis] in times):
            return axis
    if told or shape[0] == 1 or "snapshot" in section.model_fields_set:
        return 0
    raise SceneError(
        f"{table.called}: {stacked[0]} has the shape {shape}: {shape[0]} steps of {shape[1]} bodies, or {shape[1]} "
        f"steps of {shape[0]}; write count = {shape[1]} or count = {shape[0]}"
    )
