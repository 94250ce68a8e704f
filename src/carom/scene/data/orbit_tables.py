"""Tables of the Solar System: vector tables of JPL Horizons, and MPCORB of the Minor Planet Center.

In a vector table, each block between $$SOE and $$EOE is a body, at one of its epochs. MPCORB has one object per line,
with its elements in fixed columns.
"""

from __future__ import annotations

import csv
import datetime
import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from carom.errors import SceneError
from carom.scene.data import Arrays, DataFormat, DataTable, Raw, number_in, refuse_large, step_at
from carom.scene.data.facts import ECLIPTIC, SUN, Facts, printable
from carom.scene.units.dimension import LENGTH, TIME, size_of

_BEGIN, _END = "$$SOE", "$$EOE"
_TARGET = re.compile(r"Target body name:\s*(.*?)(?:\s{2,}|\s*\{|\s*$)", re.MULTILINE)
_CENTRE = re.compile(r"Center body name:\s*(.*?)(?:\s{2,}|\s*\{|\s*$)", re.MULTILINE)
_UNITS = re.compile(r"Output units\s*:\s*([A-Z]+)-([A-Z]+)")
_FRAME = re.compile(r"Reference frame\s*:\s*(\S.*?)\s*$", re.MULTILINE)
_NAMES = {"AU": "au", "KM": "km", "D": "day", "S": "s"}  # names of units in Horizons and in carom
_LABELLED = re.compile(r"\b(V?[XYZ])\s*=\s*(\S+)")  # a value in a table that is not CSV
_EPOCH = re.compile(r"\s*(\d{7}\.\d+)\s*=", re.MULTILINE)
_VECTOR = ("X", "Y", "Z", "VX", "VY", "VZ")
_LARGEST = 200_000_000  # largest size of a file in bytes
_PLACES = {  # element with unit → its first and last column, counted from 1
    "epoch [day]": (21, 25),
    "ma [deg]": (27, 35),
    "w [deg]": (38, 46),
    "om [deg]": (49, 57),
    "i [deg]": (60, 68),
    "e": (71, 79),
    "a [au]": (93, 103),
}
_DESIGNATION, _READABLE = slice(0, 7), slice(166, 194)
_CENTURIES = {"I": 1800, "J": 1900, "K": 2000}
_DIGITS = "0123456789ABCDEFGHIJKLMNOPQRSTUV"  # digits of months and days in packed dates
_JULIAN = 1_721_424.5  # Julian date of the day before day 1 of `datetime`
_LARGEST_TABLE = 2_000_000_000  # bytes; the whole table has 300 million


class _Block(NamedTuple):
    """The block of a body."""

    name: str
    epoch: str  # Julian day
    values: list[float]  # position and velocity
    units: tuple[str, str]  # units of lengths and times
    centre: str
    frame: str


def open_horizons(path: Path, called: str, snapshot: int) -> DataTable:
    """Open a reply of Horizons, or several in one file; ``snapshot`` selects the epoch."""
    refuse_large(called, "the file", path.stat().st_size, _LARGEST)
    parts = path.read_text(encoding="utf-8", errors="replace").split(_BEGIN)
    blocks, before = list[_Block](), parts[0]
    for part in parts[1:]:
        rows, found, after = part.partition(_END)
        if not found:
            raise SceneError(f"{called}: a block begins with {_BEGIN} but has no {_END}; the file ends early")
        blocks.append(_block(before, rows, called, snapshot, len(blocks)))
        before = after
    if not blocks:
        raise SceneError(f"{called}: no block between {_BEGIN} and {_END}")
    first = blocks[0]
    for block in blocks:
        for what, own, others in (
            ("epoch", first.epoch, block.epoch),
            ("centre", first.centre, block.centre),
            ("frame", first.frame, block.frame),
        ):
            if own != others:
                raise SceneError(
                    f"{called}: {first.name} and {block.name} differ in {what}: {own} and {others}; ask Horizons for "
                    f"all bodies with one {what}"
                )
    length, time = first.units
    # all values are in the units of the first block
    values = np.array([block.values for block in blocks])
    for row, block in enumerate(blocks):
        if block.units != first.units:
            lengths, times = (
                size_of(theirs, each) / size_of(ours, each)
                for theirs, ours, each in zip(block.units, first.units, (LENGTH, TIME), strict=True)
            )
            values[row, :3] *= float(lengths)
            values[row, 3:] *= float(lengths / times)
    names = [f"{axis} [{length}]" for axis in "xyz"] + [f"v{axis} [{length}/{time}]" for axis in "xyz"]
    arrays: dict[str, Raw] = {"name": np.array([block.name for block in blocks], dtype=object)}
    table = Arrays(arrays | dict(zip(names, values.T, strict=True)), called)
    table.facts = Facts(frame=_frame(first.frame), centre=first.centre.partition(" (")[0], epoch=number_in(first.epoch))
    about = f"relative to {first.centre or '?'}, in {first.frame or 'an unnamed frame'}"
    table.notes = (f"{called}: read as vectors of Horizons at JD {first.epoch}, {about}",)
    return table


def _frame(written: str) -> str:
    """Return the name that `Facts` uses for a frame of Horizons."""
    return ECLIPTIC if written.casefold().startswith("ecliptic of j2000") else written


def _block(before: str, rows: str, called: str, snapshot: int, index: int) -> _Block:
    """Read the vector at one epoch of a block."""

    def stated(pattern: re.Pattern[str]) -> str:
        found = pattern.findall(before)
        return printable(found[-1]) if found else ""

    name = stated(_TARGET) or f"body {index}"
    units = _UNITS.findall(before)
    if not units or not all(unit in _NAMES for unit in units[-1]):
        raise SceneError(f"{called}: no line of {name} states the output units as AU-D, KM-D or KM-S")
    title = [line for line in before.splitlines() if line.strip() and not line.startswith("*")][-1:]
    vectors = _table(title[0], rows) if title and "," in title[0] else _labelled(rows)
    if not vectors:
        raise SceneError(
            f"{called}: the block of {name} has no vectors (X, Y, Z, VX, VY, VZ); ask Horizons for VECTORS"
        )
    epoch, texts = vectors[step_at(called, snapshot, len(vectors), whose=name)]
    values = [number for number in map(number_in, texts) if number is not None]
    if len(values) != len(_VECTOR):
        raise SceneError(f"{called}: the block of {name} has values that are not numbers at JD {epoch}")
    return _Block(name, epoch, values, (_NAMES[units[-1][0]], _NAMES[units[-1][1]]), stated(_CENTRE), stated(_FRAME))


def _table(title: str, rows: str) -> list[tuple[str, Sequence[str]]]:
    """Read a comma-separated table."""
    names = [name.strip() for name in title.split(",")]
    if not set(_VECTOR) <= set(names):
        return []
    places = [names.index(name) for name in _VECTOR]
    cells = [row for row in csv.reader(rows.splitlines()) if len(row) >= len(_VECTOR)]
    return [(row[0].strip(), [row[place].strip() for place in places]) for row in cells if max(places) < len(row)]


def _labelled(rows: str) -> list[tuple[str, Sequence[str]]]:
    """Read vectors whose values have labels; a line with the epoch precedes each vector."""
    pieces = _EPOCH.split(rows)[1:]
    found = list[tuple[str, Sequence[str]]]()
    for epoch, text in zip(pieces[::2], pieces[1::2], strict=True):
        values = dict(_LABELLED.findall(text))
        if set(_VECTOR) <= set(values):
            found.append((epoch, [values[name] for name in _VECTOR]))
    return found


HORIZONS = DataFormat("a reply of Horizons", open_horizons)


def open_mpc(path: Path, called: str, snapshot: int) -> DataTable:
    """Open a table of orbits, with or without its header."""
    refuse_large(called, "the file", path.stat().st_size, _LARGEST_TABLE)
    lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    begin = next((number for number, line in enumerate(lines) if line.startswith("-----")), -1) + 1
    columns: dict[str, list[float]] = {name: [] for name in _PLACES}
    names = list[str]()
    for number, line in enumerate(lines[begin:], start=begin + 1):
        if not line.strip():  # a blank line separates numbered from unnumbered objects
            continue
        for name, (first, last) in _PLACES.items():
            text = line[first - 1 : last].strip()
            value = julian_date(text) if name == "epoch [day]" else number_in(text)
            if value is None:
                raise SceneError(
                    f"{called}: line {number} has no {name.partition(' ')[0]} in columns {first} to {last} "
                    f"({printable(line.strip())})"
                )
            columns[name].append(value)
        names.append(line[_READABLE].strip() or line[_DESIGNATION].strip())
    arrays: dict[str, Raw] = {"name": np.array(names, dtype=object)}
    table = Arrays(arrays | {name: np.array(values) for name, values in columns.items()}, called)
    table.facts = Facts(frame=ECLIPTIC, centre=SUN)
    table.notes = (f"{called}: read as MPCORB, {len(names)} orbits relative to the Sun and the ecliptic of J2000",)
    return table


def julian_date(packed: str) -> float | None:
    """Return the Julian date of a packed date, such as K24AH for 17 October 2024; None for any other text."""
    if len(packed) != len("K24AH") or packed[0] not in _CENTURIES or not packed[1:3].isdecimal():
        return None
    month, day = _DIGITS.find(packed[3]), _DIGITS.find(packed[4])
    try:
        return datetime.date(_CENTURIES[packed[0]] + int(packed[1:3]), month, day).toordinal() + _JULIAN
    except ValueError:
        return None


MPC = DataFormat("a table of orbits of the Minor Planet Center", open_mpc)
