"""XYZ files, plain and extended: a block of text for each step. `carom export` writes the extended form."""

from __future__ import annotations

import itertools
import re
from pathlib import Path
from typing import IO

from carom.errors import SceneError
from carom.scene.data.formats import DataFormat, DataTable, periodic_note, refuse_many_rows, step_at
from carom.scene.data.mapping import printable
from carom.scene.data.text_rows import TextRows

_LONGEST = 1_000_000  # characters in a line
_PROPERTIES = re.compile(r'\bProperties="?([^\s"]+)"?', re.IGNORECASE)
_PERIODIC = re.compile(r'\bpbc="?[^"]*T', re.IGNORECASE)
_OWN = {"velo": "velocity"}  # names of quantities in OVITO and in carom
_NAMED = {3: ("x", "y", "z"), 4: ("x", "y", "z", "w")}
_AXES = {"pos": "{}", "velocity": "v{}", "vel": "v{}", "omega": "w{}", "orientation": "q{}"}


def open_xyz(path: Path, called: str, snapshot: int) -> DataTable:
    """Open an XYZ file at one of its steps."""
    with path.open(encoding="utf-8", errors="surrogateescape", newline="\n") as file:
        places = list[tuple[int, int, int]]()  # of each step: offset, line, number of rows
        line = 1
        while True:
            offset = file.tell()
            first = file.readline(_LONGEST)
            if not first.strip():
                break
            if not first.strip().isdecimal() or len(first) > 20:
                raise SceneError(
                    f"{called}: line {line} is {printable(first.strip())}, but the number of rows is needed"
                )
            count = int(first)
            refuse_many_rows(called, count)
            places.append((offset, line, count))
            skipped = _skip(file, count + 1)
            if skipped < count + 1:
                raise SceneError(
                    f"{called}: the step from line {line} on has {max(0, skipped - 1)} of its {count} rows"
                )
            line += count + 2
        offset, line, count = places[step_at(called, snapshot, len(places))]
        file.seek(offset)
        file.readline()
        comment = file.readline(_LONGEST)
        rows = [file.readline(_LONGEST) for _ in range(count)]
    names = _names(called, comment, rows)
    table = TextRows(called, names, rows, line + 2)
    if _PERIODIC.search(comment):
        table.notes = (periodic_note(called),)
    return table


def _skip(file: IO[str], lines: int) -> int:
    """Skip lines; return the number skipped."""
    return next((k for k in range(lines) if not file.readline(_LONGEST)), lines)


def _names(called: str, comment: str, rows: list[str]) -> list[str]:
    """Return the names of the columns: those of the extended form, or a species and three coordinates."""
    found = _PROPERTIES.search(comment)
    if found is None:
        columns = len(rows[0].split()) if rows else 4
        return ["species", "x", "y", "z", *(f"column {k}" for k in range(5, columns + 1))][: max(4, columns)]
    parts = found[1].split(":")
    names = list[str]()
    for name, kind, width in itertools.zip_longest(parts[::3], parts[1::3], parts[2::3]):
        if kind not in ("S", "R", "I", "L") or not str(width).isdecimal() or not 1 <= int(width) <= 100:
            raise SceneError(f"{called}: Properties={printable(found[1])} does not name columns, such as pos:R:3")
        plain = _OWN.get(name, name)
        if int(width) == 1:
            names.append(plain)
        elif plain in _AXES and int(width) in _NAMED:
            names += [_AXES[plain].format(axis) for axis in _NAMED[int(width)]]
        else:
            names += [f"{plain} {k}" for k in range(int(width))]
    return names


XYZ = DataFormat("an XYZ file", open_xyz)
