"""MPCORB, the Minor Planet Center's table of orbits: one object per line, with its elements in fixed columns."""

from __future__ import annotations

import datetime
from pathlib import Path

import numpy as np

from carom.errors import SceneError
from carom.scene.data.formats import Arrays, DataFormat, DataTable, Raw, number_in, refuse_large
from carom.scene.data.mapping import printable

_PLACES = {  # the elements with their units, first and last column, counted from 1
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
_LARGEST = 2_000_000_000  # bytes; the whole table has 300 million


def open_mpc(path: Path, called: str, snapshot: int) -> DataTable:
    """Open a table of orbits, with or without its header."""
    size = path.stat().st_size
    if size > _LARGEST:
        refuse_large(called, "file", size)
    lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    begin = next((number for number, line in enumerate(lines) if line.startswith("-----")), -1) + 1
    columns: dict[str, list[float]] = {name: [] for name in _PLACES}
    names = list[str]()
    for number, line in enumerate(lines[begin:], start=begin + 1):
        if not line.strip():  # between numbered and unnumbered objects
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
    table.notes = (f"{called}: read as MPCORB, {len(names)} orbits relative to the Sun and the ecliptic of J2000",)
    return table


def julian_date(packed: str) -> float | None:
    """Return the Julian date of a packed date, such as K24AH for 17 October 2024; None if it is not one."""
    if len(packed) != len("K24AH") or packed[0] not in _CENTURIES or not packed[1:3].isdecimal():
        return None
    month, day = _DIGITS.find(packed[3]), _DIGITS.find(packed[4])
    try:
        return datetime.date(_CENTURIES[packed[0]] + int(packed[1:3]), month, day).toordinal() + _JULIAN
    except ValueError:
        return None


MPC = DataFormat("a table of orbits of the Minor Planet Center", open_mpc)
