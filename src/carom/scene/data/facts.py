"""Statements of a file about its numbers, besides columns: units, angles, frame of reference, epoch, time and box.

Each reader fills a `Facts`, `column_factor` converts a column or refuses it, and `contradiction` compares the tables of
a scene. The unit of a column comes from the scene (``columns = { mass = "mass [g]" }``), or else from the column in the
file, or else from the file. Otherwise it is the scene's own unit.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import lru_cache
from typing import NamedTuple

from carom.errors import SceneError
from carom.scene.units.dimension import BASE, Dimension, Unit, UnitError, nearest_float, physical, size_of, unit
from carom.scene.units.system import OWN, SI, UnitSystem

ECLIPTIC = "ecliptic of J2000"
SUN = "Sun"
_SAME_EPOCH = 1e-5  # days within which epochs agree; printed Julian dates have seven digits or more after the point
_LONGEST_NAME = 40  # largest number of characters of a name in a message
_LONGEST_SPLIT = 200  # largest number of characters of a name in which a unit is searched
_NAMES_KEPT = 100_000  # largest number of columns' names that are remembered; a wide table has some thousands
_WITH_UNIT = re.compile(r"(.*?)\s*(?:\[([^\[\]]*)\]|\(([^()]*(?:\([^()]*\)[^()]*)*)\))\s*")  # "x [au]", "mass (kg)"
_OVER = re.compile(r"([^/]+?)\s*/\s*\(?([^()]+?)\)?")  # "x/m" and "v/(m/s)", as ISO 80000 writes headers
_INDEX = re.compile(r"[\s_:.\[(-]+([012])[\])]?\Z")  # index of a component: "Points:0", "v_2", "velocity[1]"
_SEPARATORS = re.compile(r"[\s_.:-]+")
_NO_UNIT = ("", "1", "-", "none", "dimensionless", "unitless")  # texts that mean "no unit"
# Units at the end of a name, and their spellings. Other abbreviations are left out because they are also words:
# "radius_in" is an inner radius.
_SUFFIXES = {
    **{name: name for name in ("m", "cm", "mm", "um", "nm", "km", "au", "AU", "pc", "kpc", "Mpc", "kg", "g")},
    **{name: name for name in ("s", "sec", "ms", "us", "ns", "day", "days", "yr", "kyr", "Myr", "Gyr")},
    **{name: name for name in ("deg", "degrees", "rad", "arcsec", "Msun", "Mearth", "Mjup", "Rsun", "Rearth", "Rjup")},
    **dict.fromkeys(("kms", "kmps", "km_s"), "km/s"),
    **dict.fromkeys(("cms", "cm_s"), "cm/s"),
    **dict.fromkeys(("mps", "m_s"), "m/s"),
    **dict.fromkeys(("aud", "auday", "au_d", "au_day"), "au/day"),
    **dict.fromkeys(("auyr", "au_yr"), "au/yr"),
    **dict.fromkeys(("kgm3", "kg_m3"), "kg/m^3"),
    **dict.fromkeys(("gcc", "gcm3", "g_cm3"), "g/cm^3"),
    **dict.fromkeys(("rads", "radps", "rad_s"), "rad/s"),
    **dict.fromkeys(("degs", "degps", "deg_s"), "deg/s"),
}


class FileBox(NamedTuple):
    """The box of a file, in the units of its positions; `scaled` converts it."""

    low: tuple[float, ...]  # lower corner
    size: tuple[float, ...]
    periodic: str = ""  # axes along which the box repeats, such as "xy"

    def scaled(self, factor: float) -> FileBox:
        """Return the box in other units."""
        return FileBox(
            tuple(factor * each for each in self.low), tuple(factor * each for each in self.size), self.periodic
        )


@dataclass(frozen=True)
class Facts:
    """Statements of a file about its numbers, besides the names of columns; empty if it states nothing."""

    units: UnitSystem = SI  # units of the columns that state no unit, for some dimensions or for all
    of_columns: Mapping[str, str] = field(default_factory=dict)  # units of single columns, as the file writes them
    frame: str = ""  # directions of the axes, such as "ICRF" or `ECLIPTIC`
    centre: str = ""  # body at the origin
    epoch: float | None = None  # Julian date (TDB)
    time: float | None = None  # time of the step that is read, in the file's units
    box: FileBox | None = None

    def states(self, dimension: Dimension) -> bool:
        """Return whether the file states the unit of a dimension."""
        given = self.units.given
        if dimension.plain in given:
            return bool(given[dimension.plain])
        powers = [name for name, power in zip(BASE, dimension.exponents, strict=True) if power]
        return powers != ["angle"] and all(given.get(name) for name in powers if name != "angle")


@dataclass(frozen=True)
class FileColumn:
    """A column of a file: its name, and its unit, which the name contains or the file states."""

    name: str  # name in the file
    proper: str  # name without the unit and, in HDF5, without the path
    unit: str = ""
    odd: str = ""  # text that stands in the place of a unit, but is not a unit

    @property
    def plain(self) -> str:
        """The name for comparisons: "vx" for "v_x", "V X" and "v:0"."""
        return plain_name(self.proper)

    @property
    def shown(self) -> str:
        """The name in messages, with its unit."""
        short = printable(self.name)
        return short if not self.unit or self.unit in short else f"{short} [{printable(self.unit)}]"

    def with_suffix(self, dimension: Dimension, brief: bool = True) -> FileColumn | None:
        """Read the end of the name as a unit of a dimension: "x_km", "vx_kms", "inc_deg"; None if it is not a unit.

        Two single letters, as in "m_t", are a unit only with ``brief``.
        """
        if self.unit or self.odd or len(self.proper) > _LONGEST_SPLIT:
            return None
        for place in (k for k, char in enumerate(self.proper) if char == "_"):
            base, end = self.proper[:place], self.proper[place + 1 :]
            named = _SUFFIXES.get(end) or _SUFFIXES.get(end.lower(), "")
            spellings = (named, "m/s") if end == "ms" else (named,)  # "ms" is milliseconds or metres per second
            text = next((each for each in spellings if each and _has_dimension(each, dimension)), "")
            if base and text and (brief or len(base) > 1 or len(end) > 1):
                return replace(self, proper=base, unit=text)
        return None


@lru_cache(maxsize=_NAMES_KEPT)
def plain_name(proper: str) -> str:
    """Return a name for comparisons: in lower case, without separators, with x, y, z for 0, 1, 2."""
    if found := _INDEX.search(proper):
        proper = proper[: found.start()] + "xyz"[int(found[1])]
    return _SEPARATORS.sub("", proper.strip().casefold())


def columns_of(names: Sequence[str], facts: Facts, paths: bool = False) -> list[FileColumn]:
    """Return the columns of a file; with ``paths``, the last part of a path is the name of a column."""
    return [_column(name, facts.of_columns.get(name), paths) for name in names]


def column_named(name: str, paths: bool) -> FileColumn:
    """Return a column by its name in a scene."""
    return _column(name, None, paths)


@lru_cache(maxsize=_NAMES_KEPT)
def _column(name: str, stated: str | None, paths: bool) -> FileColumn:
    proper = name.strip()
    if paths:
        parts = proper.split("/")
        proper = parts[-2] if parts[-1] == "value" and len(parts) > 1 else parts[-1]  # H5MD: position/value
    proper, text = _split(proper, paths)
    if stated is None or stated.strip().lower() in _NO_UNIT:
        return FileColumn(name, proper, text, "" if text else _bracketed(proper))
    stated = stated.strip()
    its, ours = _size(stated), _size(text)
    if text and its != ours:
        return FileColumn(name, proper, "", f"{text} and {stated}")
    return FileColumn(name, proper, stated if its else "", "" if its else stated)


def _split(name: str, paths: bool) -> tuple[str, str]:
    """Split a name into the name proper and its unit."""
    if len(name) > _LONGEST_SPLIT:
        return name, ""
    bracketed = _WITH_UNIT.fullmatch(name) if name.endswith(("]", ")")) else None
    over = None if paths else _OVER.fullmatch(name)
    for found in (bracketed, over):
        if found and found[1] and _size(text := next(part for part in found.groups()[1:] if part is not None)):
            return found[1] if paths else found[1].rstrip("/ "), text  # "v/(m/s)"
    return name, ""


def _bracketed(name: str) -> str:
    """Return a text in brackets at the end of a name that is neither a unit nor an index; empty without one."""
    found = _WITH_UNIT.fullmatch(name) if name.endswith(("]", ")")) and len(name) <= _LONGEST_SPLIT else None
    text = (found[2] or found[3] or "").strip() if found else ""
    return "" if text.lower() in (*_NO_UNIT, "0", "1", "2", "x", "y", "z") else text


def _size(text: str) -> Unit | None:
    """Return the size in SI and the dimension of a unit, or of a multiple such as "1000 km"; None if unknown."""
    if text[:1].isdigit():
        several = physical(text)
        return several and Unit(several.size, several.unit.exponents)
    try:
        return unit(text)
    except UnitError:
        return None


def _has_dimension(text: str, dimension: Dimension) -> bool:
    try:
        return unit(text).exponents == dimension.exponents
    except UnitError:
        return False


def printable(name: str) -> str:
    """Return a name from a file as one short line of text."""
    return "".join(char if char.isprintable() else "�" for char in name[:_LONGEST_NAME])


def column_factor(
    called: str, column: FileColumn, facts: Facts, quantity: str, dimensions: Sequence[Dimension], units: UnitSystem
) -> float:
    """Return the size of a column's unit in units of the simulation.

    The dimension of the quantity is the product of ``dimensions``. Raises SceneError if the unit is unknown, or does
    not fit the quantity.
    """
    if units.dimensionless:
        return 1.0
    if column.odd:
        raise SceneError(
            f"{called}: column {printable(column.name)} for {quantity}: {printable(column.odd)} is not a unit that "
            f"carom knows; name the column with its unit in the scene, such as columns = {{ {quantity} = "
            f'"{printable(column.name)} [{dimensions[0].unit}]" }}'
        )
    if column.unit:
        known = _size(column.unit)
        exponents = tuple(sum(powers) for powers in zip(*(each.exponents for each in dimensions), strict=True))
        try:
            if len(dimensions) == 1:
                size = size_of(column.unit, dimensions[0])
            elif known is not None and known.exponents == exponents:
                size = known.size
            else:
                raise UnitError(f'"{column.unit}" is not a {quantity.replace("_", " ")}')
        except UnitError as error:
            raise SceneError(f"{called}: column {printable(column.name)} for {quantity}: {error}") from None
    elif facts.units.dimensionless and not units.given:
        raise SceneError(
            f'{called}: its numbers have no units; write units = "dimensionless" at the top of the scene, or [units] '
            "with their length, time and mass"
        )
    elif all(map(facts.states, dimensions)):
        size = math.prod((facts.units.size(each) for each in dimensions), start=Fraction(1))
    else:
        return math.prod(units.factor(each) for each in dimensions)
    own = math.prod((units.size(each) for each in dimensions), start=Fraction(1)) if units.own else Fraction(1)
    return nearest_float(size / own)


def refuse_other_units(called: str, facts: Facts, units: UnitSystem, read: Iterable[Dimension]) -> None:
    """Refuse a file that has a law of motion, since its constants are taken over, if the scene has another unit."""
    its = facts.units
    if its.dimensionless or units.dimensionless or not its.given:
        return
    other = next((each for each in read if not units.agrees(its, each)), None)
    if other is not None:
        named = ", ".join(f'{each.plain} = "{its.given[each.plain]}"' for each in OWN)
        scene = "the scene has SI units" if units.is_si else f"the scene has {other.name} in {units.unit(other)}"
        raise SceneError(
            f"{called}: its numbers are in {its.named}, and {scene}; write units = "
            f'"{its.named}" at the top of the scene, or [units] with {named}'
        )


def contradiction(facts: Facts, other_called: str, other: Facts) -> str:
    """Return how the frames, centres or epochs of two files differ, and the remedy; empty if they agree."""
    for what, mine, its, remedy in (
        ("frame of reference", facts.frame, other.frame, "write both in one frame (for Horizons, REF_PLANE)"),
        ("centre", facts.centre, other.centre, "write both relative to one body (for Horizons, CENTER)"),
    ):
        if mine and its and mine.casefold() != its.casefold():
            return f"its {what} is {mine}, but {its} in {other_called}; {remedy}"
    if facts.epoch is not None and other.epoch is not None and abs(facts.epoch - other.epoch) > _SAME_EPOCH:
        return (
            f"its epoch is JD {facts.epoch:.10g}, and the epoch of {other_called} is JD {other.epoch:.10g}; choose the "
            f"snapshot of that epoch, or move orbital elements to it with orbit = {{ …, epoch = {other.epoch:.10g} }}"
        )
    return ""
