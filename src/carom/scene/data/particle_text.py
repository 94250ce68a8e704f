"""Particles in text files: dumps and data files of LAMMPS and LIGGGHTS, and XYZ files, plain and extended.

An XYZ file has a block of text for each step; `carom export` writes the extended form. carom has its own reader for
files of LAMMPS, since lammpsio omits the radii, spins and densities of spheres.
"""

from __future__ import annotations

import itertools
import mmap
import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from carom.arrays import FloatArray
from carom.errors import SceneError
from carom.scene.data import (
    Arrays,
    DataFormat,
    DataTable,
    Raw,
    number_in,
    numbers_of,
    refuse_large,
    refuse_many_rows,
    step_at,
)
from carom.scene.data.facts import Facts, FileBox, printable
from carom.scene.data.text_rows import TextRows
from carom.scene.units.system import SI, WITHOUT, UnitSystem

_STEP = b"ITEM: TIMESTEP"
# statements that precede the first step
_BEFORE = re.compile(rb"(?:ITEM: (?:UNITS|TIME)[ \t]*\r?\n[^\n]{0,100}\n)*(?=ITEM: TIMESTEP)")
_TAIL = re.compile(r"(?m)^ITEM: TIME\n")  # head of the next step, after the rows of a step
# Names of units in LAMMPS (its command `units`) and in carom; a mass in g/mol is the mass of one atom in daltons.
REDUCED = "lj"
_OF_ATOMS = {"length": "angstrom", "mass": "dalton", "density": "g/cm^3"}
UNITS = {
    "si": UnitSystem({"length": "m", "time": "s", "mass": "kg"}),
    "cgs": UnitSystem({"length": "cm", "time": "s", "mass": "g"}),
    "micro": UnitSystem({"length": "um", "time": "us", "mass": "pg"}),
    "nano": UnitSystem({"length": "nm", "time": "ns", "mass": "ag"}),
    "real": UnitSystem({**_OF_ATOMS, "time": "fs"}),
    "metal": UnitSystem({**_OF_ATOMS, "time": "ps"}),
    REDUCED: UnitSystem.of_text(WITHOUT),
}
_IN_TITLE = re.compile(rb"[^\n]*\bunits = (\w{1,20})")  # statement in the first line, as write_data writes it
_MOST_STEPS = 10_000_000
_COUNT = re.compile(rb"^\s*([0-9]{1,18})\s+atoms\b", re.MULTILINE)  # number of atoms in the header of a data file
_HEAD = 10_000  # bytes at the beginning of a data file that contain its header
_LINES = 20  # largest number of lines of a data file per atom, including bonds, angles and dihedrals
_HEADER_LINES = 1000  # largest number of further lines: header, masses, coefficients
_LONGEST = 1_000_000  # largest number of characters in a line
_DIGITS = 20  # most digits in a count of rows; numbers below 2⁶³ have at most 19
_WIDEST = 100  # largest number of values of a property in a row
_PROPERTIES = re.compile(r'\bProperties="?([^\s"]+)"?', re.IGNORECASE)
_PERIODIC = re.compile(r'\bpbc="?([TF01][TFrueals01 ]*)', re.IGNORECASE)
_LATTICE = re.compile(r'\bLattice="([^"]*)"', re.IGNORECASE)
_TIME = re.compile(r'\bTime="?([^\s"]+)', re.IGNORECASE)
_ORIGIN = re.compile(r'\bOrigin="([^"]*)"', re.IGNORECASE)
_OWN = {"velo": "velocity"}  # names of quantities in OVITO and in carom
_NAMED = {3: ("x", "y", "z"), 4: ("x", "y", "z", "w")}
_AXES = {"pos": "{}", "velocity": "v{}", "vel": "v{}", "omega": "w{}", "orientation": "q{}"}


def open_dump(path: Path, called: str, snapshot: int) -> DataTable:
    """Open one step of a dump."""
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
        before = _BEFORE.match(content)
        if before is None:
            raise SceneError(f'{called}: a dump begins with "{_STEP.decode()}"; a binary or compressed one is not read')
        once = re.search(rb"ITEM: UNITS\s+(\w+)", before[0])  # LAMMPS writes the units in the first step only
        begins, place = list[int](), before.end()
        while place >= 0 and len(begins) < _MOST_STEPS:
            begins.append(place)
            place = content.find(b"\n" + _STEP, place)
            place += place >= 0
        index = step_at(called, snapshot, len(begins))
        begin, end = begins[index], ([*begins, len(content)])[index + 1]
        refuse_large(called, "the step", end - begin)
        line = content[:begin].count(b"\n") + 1
        text = content[begin:end].decode("utf-8", "surrogateescape")
    return _Dump(called, text, line, once[1].decode() if once else "")


class _Dump(DataTable):
    """The atoms of one step, in the order of their ids; scaled positions are converted to lengths."""

    def __init__(self, called: str, text: str, line: int, units: str) -> None:
        self.called = called
        head, found, body = text.partition("ITEM: ATOMS")
        body = _TAIL.split(body)[0]
        if not found:
            raise SceneError(f'{called}: the step from line {line} on has no "ITEM: ATOMS"; the file ends early')
        items = dict[str, list[str]]()
        for item in head.split("ITEM: ")[1:]:
            title, *rows = item.splitlines()
            items[title.strip()] = rows
        step = "".join(items.get("TIMESTEP", [])[:1]).strip()
        count = "".join(items.get("NUMBER OF ATOMS", [])[:1]).strip()
        if not count.isdecimal():
            raise SceneError(f'{called}: the step from line {line} on has no "ITEM: NUMBER OF ATOMS"')
        refuse_many_rows(called, int(count), len(text))
        names, _, rows_text = body.partition("\n")
        self._written = names.split()
        rows = rows_text.splitlines()
        if len(rows) != int(count):
            raise SceneError(
                f"{called}: step {printable(step)} has {len(rows)} of its {count} atoms; the file ends early"
            )
        self._rows = TextRows(called, self._written, rows, line + head.count("\n") + 1)
        bounds = next(((title, rows) for title, rows in items.items() if title.startswith("BOX BOUNDS")), ("", []))
        self._box = _box(called, bounds[1])
        self._skewed = "xy" in bounds[0]
        self._scaled = {f"{axis}{end}": axis for axis in "xyz" for end in ("s", "su") if axis not in self._written}
        self.names = [self._scaled.get(name, name) for name in self._written]
        units = "".join(items.get("UNITS", [])[:1]).strip() or units
        self.notes = (f"{called}: step {printable(step)} of LAMMPS{f', units {printable(units)}' if units else ''}",)
        ends = bounds[0].split()[-3:]  # boundaries such as pp pp ff; old versions write no boundaries
        repeated = "".join(axis for axis, end in zip("xyz", ends, strict=False) if end in ("pp", "p"))
        box = None
        if self._box is not None and not self._skewed:
            box = FileBox(
                tuple(self._box[:, 0].tolist()), tuple((self._box[:, 1] - self._box[:, 0]).tolist()), repeated
            )
        time = "".join(items.get("TIME", [])[:1])
        self.facts = Facts(units=_units_called(called, units), time=number_in(time), box=box)

    def read(self, names: Sequence[str], texts: Sequence[str] = ()) -> dict[str, Raw]:
        """Read columns by their names."""
        written = dict(zip(self.names, self._written, strict=True))
        wanted = [written[name] for name in names]
        raw = self._rows.read([*wanted, *(["id"] if "id" in self._written else [])], [written[name] for name in texts])
        order = np.argsort(numbers_of(self.called, "id", raw["id"]), kind="stable") if "id" in raw else slice(None)
        return {name: self._length(column, raw[column])[order] for name, column in zip(names, wanted, strict=True)}

    def _length(self, column: str, raw: Raw) -> Raw:
        """Return a column, with scaled positions converted to lengths."""
        if column not in self._scaled:
            return raw
        if self._skewed or self._box is None:
            raise SceneError(
                f"{self.called}: {column} is scaled by a box that is not a cuboid; dump x, y and z instead"
            )
        low, high = self._box["xyz".index(self._scaled[column])]
        return np.asarray(low + numbers_of(self.called, column, raw) * (high - low))


def _units_called(called: str, name: str) -> UnitSystem:
    """Return the units that LAMMPS calls ``name``; if it is empty, return `SI`, in which no unit is given."""
    if name and name not in UNITS:
        raise SceneError(
            f"{called}: its numbers are in the units {printable(name)} of LAMMPS, which carom does not know; it knows "
            f"{', '.join(UNITS)}"
        )
    return UNITS.get(name, SI)


def _box(called: str, rows: Sequence[str]) -> FloatArray | None:
    """Return the bounds (3, 2) of a cuboid box."""
    try:
        bounds = np.array([[float(value) for value in row.split()[:2]] for row in rows[:3]])
    except ValueError:
        raise SceneError(f"{called}: the bounds of its box are not numbers") from None
    return bounds if bounds.shape == (3, 2) else None


class _Section(NamedTuple):
    """A section of a data file."""

    style: str  # style of the atoms, in the comment after the name of their section
    line: int  # number of its first row
    rows: list[str]


_TITLE = re.compile(r"([A-Z][A-Za-z /]*[A-Za-z])\s*(?:#\s*(.*?)\s*)?")
_COLUMNS = {  # columns of the section Atoms, by style
    "atomic": "id type x y z",
    "charge": "id type q x y z",
    "molecular": "id molecule type x y z",
    "bond": "id molecule type x y z",
    "full": "id molecule type q x y z",
    "sphere": "id type diameter density x y z",
    "granular": "id type diameter density x y z",
    "bpm/sphere": "id molecule type diameter density x y z",
}


def open_data(path: Path, called: str, snapshot: int) -> DataTable:
    """Open a data file: its sections Atoms, Velocities and Masses."""
    refuse_large(called, "the file", path.stat().st_size)
    content = path.read_bytes()
    stated = _COUNT.search(content[:_HEAD])
    if content.startswith(b"ITEM:"):
        raise SceneError(f'{called}: it begins with "ITEM:" like a dump of LAMMPS, not a data file; name it *.dump')
    if stated is None:
        raise SceneError(f'{called}: no line such as "100 atoms" in its header, which a data file of LAMMPS has')
    refuse_many_rows(called, int(stated[1]), len(content))
    if (lines := content.count(b"\n")) > _LINES * (int(stated[1]) + _HEADER_LINES):
        raise SceneError(f"{called}: {lines} lines are too many for {int(stated[1])} stated atoms: it is damaged")
    sections = _sections(content.decode("utf-8", "surrogateescape").splitlines())
    if "Atoms" not in sections:
        raise SceneError(f'{called}: no section "Atoms", which a data file of LAMMPS has')
    atoms = sections["Atoms"]
    if atoms.style not in _COLUMNS:
        styles = ", ".join(_COLUMNS)
        raise SceneError(
            f'{called}: line {atoms.line}: write the atom style after the title, such as "Atoms # sphere"; carom reads '
            f"{styles}"
        )
    if len(atoms.rows) != int(stated[1]):
        raise SceneError(
            f"{called}: its header states {int(stated[1])} atoms, but its section Atoms has {len(atoms.rows)}; the "
            "file ends early, or is damaged"
        )
    table = _rows(called, _COLUMNS[atoms.style].split(), atoms, optional=("ix", "iy", "iz"))
    arrays = table.read([name for name in table.names if name not in ("ix", "iy", "iz")])
    order = np.argsort(numbers_of(called, "id", arrays["id"]), kind="stable")
    arrays = {name: values[order] for name, values in arrays.items()}
    if "diameter" in arrays:
        points = numbers_of(called, "diameter", arrays["diameter"]) == 0.0
        if points.any():
            row = int(np.argmax(points))
            raise SceneError(f"{called}: atom {arrays['id'][row]} is a point (diameter 0); give it a diameter")
    elif "Masses" in sections:
        masses = _rows(called, ["type", "mass"], sections["Masses"])
        of_type = masses.read(["type", "mass"])
        known = dict(zip(of_type["type"].tolist(), numbers_of(called, "mass", of_type["mass"]).tolist(), strict=True))
        if missing := set(arrays["type"].tolist()) - set(known):
            raise SceneError(f"{called}: no mass of the type {printable(str(missing.pop()))} in its section Masses")
        arrays["mass"] = np.array([known[each] for each in arrays["type"].tolist()])
    if "Velocities" in sections:
        moving = _rows(called, ["id", "vx", "vy", "vz"], sections["Velocities"], optional=("wx", "wy", "wz"))
        velocities = moving.read(moving.names)
        order = np.argsort(numbers_of(called, "id", velocities["id"]), kind="stable")
        if not np.array_equal(velocities["id"][order], arrays["id"]):
            raise SceneError(f"{called}: the sections Atoms and Velocities have different ids")
        arrays |= {name: velocities[name][order] for name in moving.names if name != "id"}
    result = Arrays(arrays, called)
    units = _IN_TITLE.match(content[:_HEAD])
    result.facts = Facts(units=_units_called(called, units[1].decode() if units else ""))
    said = f", units {units[1].decode()}" if units else ""
    result.notes = (f"{called}: data file of LAMMPS, atoms of the style {atoms.style}{said}",)
    return result


def _sections(lines: Sequence[str]) -> dict[str, _Section]:
    """Find the sections of a data file, whose first line is a title."""
    found, current = dict[str, _Section](), None
    for number, line in enumerate(lines[1:], start=2):
        title = _TITLE.fullmatch(line.strip())
        if title:
            current = found[title[1]] = _Section(title[2] or "", number, [])
        elif current is not None and (text := line.partition("#")[0].strip()):
            current.rows.append(text)
    return found


def _rows(called: str, names: Sequence[str], section: _Section, optional: Sequence[str] = ()) -> TextRows:
    """Read the rows of a section; all rows have the optional columns, or no row has them."""
    more = bool(section.rows) and len(section.rows[0].split()) == len(names) + len(optional)
    return TextRows(called, [*names, *(optional if more else ())], section.rows, section.line + 2)


DUMP = DataFormat("a dump of LAMMPS", open_dump)
DATA = DataFormat("a data file of LAMMPS", open_data)


def open_xyz(path: Path, called: str, snapshot: int) -> DataTable:
    """Open an XYZ file at one of its steps."""
    with path.open(encoding="utf-8", errors="surrogateescape", newline="\n") as file:
        places = list[tuple[int, int, int]]()  # offset, line and number of rows of each step
        line, stored = 1, path.stat().st_size
        while True:
            offset = file.tell()
            first = file.readline(_LONGEST)
            if not first.strip():
                break
            if not first.strip().isdecimal() or len(first) > _DIGITS:
                raise SceneError(
                    f"{called}: line {line} is {printable(first.strip())}, but the number of rows is needed"
                )
            count = int(first)
            refuse_many_rows(called, count, stored)
            places.append((offset, line, count))
            lines = count + 1
            skipped = next((k for k in range(lines) if not file.readline(_LONGEST)), lines)
            if skipped < lines:
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
    stated = _TIME.search(comment)
    table.facts = Facts(time=number_in(stated[1]) if stated else None, box=_lattice(comment))
    return table


def _lattice(comment: str) -> FileBox | None:
    """Return the box that a comment of the extended form states; None if the box is not a cuboid."""
    found = _LATTICE.search(comment)
    vectors = [number_in(word) for word in found[1].split()] if found else []
    if len(vectors) != 9 or any(each is None or (k % 4 and each) for k, each in enumerate(vectors)):
        return None
    corner = _ORIGIN.search(comment)
    low = [number_in(word) or 0.0 for word in corner[1].split()] if corner else [0.0, 0.0, 0.0]
    repeated = _PERIODIC.search(comment)
    # the lattice repeats by default; ASE and OVITO use the same default
    signs = repeated[1].split() if repeated else ["T", "T", "T"]
    periodic = "".join(axis for axis, sign in zip("xyz", signs, strict=False) if sign.upper()[:1] in ("T", "1"))
    return FileBox((*low[:3],), tuple(float(vectors[k] or 0.0) for k in (0, 4, 8)), periodic) if len(low) == 3 else None


def _names(called: str, comment: str, rows: list[str]) -> list[str]:
    """Return the names of the columns: as the extended form states them, or a species and three coordinates."""
    found = _PROPERTIES.search(comment)
    if found is None:
        columns = len(rows[0].split()) if rows else 4
        return ["species", "x", "y", "z", *(f"column {k}" for k in range(5, columns + 1))][: max(4, columns)]
    parts = found[1].split(":")
    names = list[str]()
    for name, kind, width in itertools.zip_longest(parts[::3], parts[1::3], parts[2::3]):
        if kind not in ("S", "R", "I", "L") or not str(width).isdecimal() or not 1 <= int(width) <= _WIDEST:
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
