"""MercuryDPM's .data files: for each step a line with the number of particles, the time and the box, then particles.

MercuryDPM's DPMBaseXBalls.icc writes these columns: 14 columns in three dimensions, and 8 in two dimensions, in which
angles and angular velocities have the opposite sign. Files of LAMMPS have the same ending; the first line shows which
program wrote a file.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple, TextIO

from carom import registry
from carom.errors import SceneError
from carom.scene.data import Arrays, DataFormat, DataTable, number_in, numbers_of, refuse_many_rows, step_at
from carom.scene.data.facts import Facts, FileBox, printable
from carom.scene.data.text_rows import TextRows

_COLUMNS = {  # columns by the number of words in a step's line
    6: ("x", "y", "vx", "vy", "radius", "angle", "-wz", "info"),
    8: (*("x", "y", "z", "vx", "vy", "vz", "radius"), *("angle x", "angle y", "angle z", "wx", "wy", "wz", "info")),
}
_LONGEST = 100_000  # largest number of characters in a line


class _Step(NamedTuple):
    """The first line of a step."""

    offset: int  # offset of the next line
    line: int  # number of the next line, from 1
    rows: int
    numbers: tuple[float, ...]  # time, lower and upper corner


def open_either(path: Path, called: str, snapshot: int) -> DataTable:
    """Open a .data file of LAMMPS or of MercuryDPM."""
    with path.open(encoding="utf-8", errors="replace", newline="\n") as file:
        if _first_line(file.readline(_LONGEST)) is None:
            other: DataFormat = registry.load("data_formats", "lmp")
            return other.open(path, called, snapshot)
        file.seek(0)
        steps = [*_steps(file, called)]
        index = step_at(called, snapshot, len(steps))
        step = steps[index]
        file.seek(step.offset)
        rows = [file.readline(_LONGEST) for _ in range(step.rows)]
    time, *corners = step.numbers
    axes = len(corners) // 2
    names = _COLUMNS[2 + 2 * axes]
    table = TextRows(called, names, rows, step.line)
    arrays = {name: numbers_of(called, name, raw) for name, raw in table.read(names).items()}
    if axes == 2:
        zero = arrays["x"] * 0.0
        arrays |= {"z": zero, "vz": zero, "wx": zero, "wy": zero, "wz": -arrays.pop("-wz")}
    low, high = ((*corners[:axes], *[0.0] * (3 - axes)), (*corners[axes:], *[0.0] * (3 - axes)))
    result = Arrays(arrays, called)
    box = FileBox(low, tuple(b - a for a, b in zip(low, high, strict=True)))
    result.facts = Facts(time=time, box=box if axes == 3 else None)
    plane = "" if axes == 3 else ", in the plane z = 0"
    result.notes = (f"{called}: step {index} of {len(steps)} (from 0) of MercuryDPM, t = {time:g}{plane}, is read",)
    return result


def _first_line(text: str) -> tuple[float, ...] | None:
    """Return the numbers in the first line of a step; None if the line begins no step."""
    words = text.split()
    numbers = [number_in(word) for word in words]
    if len(words) not in _COLUMNS or not words[0].isdecimal():
        return None
    return tuple(float(each) for each in numbers if each is not None) if None not in numbers else None


def _steps(file: TextIO, called: str) -> Iterator[_Step]:
    """Find the steps; raises SceneError if a step is incomplete."""
    line, stored = 1, os.fstat(file.fileno()).st_size
    while (text := file.readline(_LONGEST)).strip():
        numbers = _first_line(text)
        if numbers is None:
            raise SceneError(
                f"{called}: line {line} is {printable(text.strip())}, but the number of particles, the time and the "
                "box of a step of MercuryDPM are needed"
            )
        count = int(numbers[0])
        refuse_many_rows(called, count, stored)
        step = _Step(file.tell(), line + 1, count, numbers[1:])
        there = next((k for k in range(count) if not file.readline(_LONGEST)), count)
        if there < count:
            raise SceneError(f"{called}: the step from line {line} on has {there} of its {count} particles")
        yield step
        line += count + 1


def times_of(path: Path, called: str) -> list[float]:
    """Return the times of the steps of MercuryDPM; SceneError for a file of LAMMPS, which has one step."""
    with path.open(encoding="utf-8", errors="replace", newline="\n") as file:
        if _first_line(file.readline(_LONGEST)) is None:
            raise SceneError(f"{called}: a data file of LAMMPS has one step; leave snapshot_time out")
        file.seek(0)
        return [step.numbers[0] for step in _steps(file, called)]


DATA = DataFormat("a data file of LAMMPS or MercuryDPM", open_either, times_of)
