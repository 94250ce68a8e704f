"""The dimensions of quantities with their SI units, and all units: names, sizes in SI, and texts such as "3 km".

Only this module imports pint. The definitions of units are carom's own and exact (`definitions.txt`). A conversion is a
product of fractions that is rounded once, with the same bits for every version of pint and on every machine. pint takes
a quarter of a second to import, so it is imported when the first unit is read. Prefixes are accepted only where they
are customary: with all prefixes, typing errors such as "12 hh" would be valid units (hectohours).
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from pint import UnitRegistry

BASE = ("length", "time", "mass", "angle")

_QUANTITY = r"^\s*[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?\s*\D"  # a number and the beginning of a unit

Exponents = tuple[int, int, int, int]  # powers of the dimensions in `BASE`
_SYMBOLS = "qryzafpnµμumkMGTPEZY"
_SMALL_WORDS = ("quecto", "ronto", "yocto", "zepto", "atto", "femto", "pico", "nano", "micro", "milli")
_LARGE_WORDS = ("kilo", "mega", "giga", "tera", "peta", "exa", "zetta", "yotta")
_PREFIX_WORDS = (*_SMALL_WORDS, *_LARGE_WORDS)
_FEW, _MANY = "nµμum", "kMGT"

# The prefixes of each unit. Symbols combine with symbols, words with words.
_TAKEN: dict[str, Iterable[str]] = {
    **dict.fromkeys(("m", "g", "L"), "cdh" + _SYMBOLS),
    **dict.fromkeys(("s", "J", "N", "W", "Hz", "eV"), _SYMBOLS),
    "Pa": "h" + _SYMBOLS,
    **dict.fromkeys(("pc", "yr", "ly", "t"), _MANY),
    **dict.fromkeys(("rad", "arcsec", "sec"), _FEW),
    "cal": "k",
    **dict.fromkeys(("metre", "meter", "gram", "litre", "liter"), ("centi", "deci", "hecto", *_PREFIX_WORDS)),
    **dict.fromkeys(
        ("second", "joule", "newton", "watt", "hertz", "electron_volt", "radian", "arcsecond"), _PREFIX_WORDS
    ),
    "pascal": ("hecto", *_PREFIX_WORDS),
    **dict.fromkeys(("parsec", "year", "tonne"), _LARGE_WORDS[: len(_MANY)]),
    "calorie": ("kilo",),
}
_IRREGULAR = ("s", "x", "z", "i", "ch", "y", "foot", "feet")  # endings of words that take no plural s
_SHORT = ("day", "deg", "erg", "hr", "lb", "min", "rev", "sec", "yr")  # exceptions that take a plural s


@dataclass(frozen=True, slots=True)
class Dimension:
    """A dimension, such as energy."""

    name: str
    unit: str  # SI unit in the form that is printed, and accepted in texts
    exponents: Exponents
    example: str  # an example of a quantity, as a person writes it
    plain: str = ""  # the key of [units] that sets the dimension's unit; empty for a derived unit

    def __get_pydantic_json_schema__(self, core: Any, handler: Any) -> dict[str, Any]:
        """Describe a quantity in the JSON schema: a text with a unit may replace each number."""
        return self._or_text(handler(core))

    def _or_text(self, schema: dict[str, Any]) -> dict[str, Any]:
        if "prefixItems" in schema:
            return {**schema, "prefixItems": [self._or_text(number) for number in schema["prefixItems"]]}
        text = {"type": "string", "pattern": _QUANTITY, "examples": [self.example]}
        return {"anyOf": [schema, *([{"type": "number"}] if "$ref" in schema else []), text]}

    @property
    def called(self) -> str:
        """The name with its article."""
        return f"{'an' if self.name[0] in 'aeiou' else 'a'} {self.name}"


LENGTH = Dimension("length", "m", (1, 0, 0, 0), "3 km", "length")
TIME = Dimension("time", "s", (0, 1, 0, 0), "12 h", "time")
MASS = Dimension("mass", "kg", (0, 0, 1, 0), "5 t", "mass")
ANGLE = Dimension("angle", "rad", (0, 0, 0, 1), "30 deg", "angle")
VELOCITY = Dimension("velocity", "m/s", (1, -1, 0, 0), "2 km/s", "velocity")
ACCELERATION = Dimension("acceleration", "m/s²", (1, -2, 0, 0), "9.81 m/s^2", "acceleration")
ANGULAR_VELOCITY = Dimension("angular velocity", "rad/s", (0, -1, 0, 1), "10 deg/s", "angular_velocity")
DENSITY = Dimension("density", "kg/m³", (-3, 0, 1, 0), "5 g/cm^3", "density")
GRAVITATIONAL_CONSTANT = Dimension(
    "gravitational constant", "m³ kg⁻¹ s⁻²", (3, -2, -1, 0), "4.3e-3 pc (km/s)^2 / solar mass"
)
RATE = Dimension("rate", "1/s", (0, -1, 0, 0), "50 Hz")
IMPULSE = Dimension("impulse", "N s", (1, -1, 1, 0), "3 N s")
ANGULAR_IMPULSE = Dimension("angular impulse", "N m s", (2, -1, 1, 0), "3 N m s")
FORCE = Dimension("force", "N", (1, -2, 1, 0), "3 N")
TORQUE = Dimension("torque", "N m", (2, -2, 1, 0), "3 N m")
ANGULAR_ACCELERATION = Dimension("angular acceleration", "rad/s²", (0, -2, 0, 1), "3 rad/s^2")
PRESSURE = Dimension("pressure", "Pa", (-1, -2, 1, 0), "100 kPa")
ENERGY = Dimension("energy", "J", (2, -2, 1, 0), "3 kJ", "energy")

DIMENSIONS: Sequence[Dimension] = [each for each in list(globals().values()) if isinstance(each, Dimension)]
NAMED = {dimension.plain: dimension for dimension in DIMENSIONS if dimension.plain}  # dimensions by the key of [units]
OF_UNIT = {dimension.unit: dimension for dimension in DIMENSIONS}  # by SI unit
# by exponents, with an energy in place of a torque, which has the same exponents
OF_EXPONENTS = {dimension.exponents: dimension for dimension in DIMENSIONS}


def written_names(defined: Iterable[str]) -> Iterator[str]:
    """Yield all names of the defined units: plain names, names with prefixes, and plurals."""
    for name in defined:
        takes_s = name in _SHORT or (len(name) > 3 and name.islower() and not name.endswith(_IRREGULAR))
        for prefixed in (name, *(f"{prefix}{name}" for prefix in _TAKEN.get(name, ()))):
            yield prefixed
            if takes_s:
                yield f"{prefixed}s"


# carom's names of units, by the names in data files of astropy, AMUSE, unyt, MDAnalysis and the Exoplanet Archive
_FOREIGN = {
    **dict.fromkeys(("Msun", "MSun", "solMass"), "M_sun"),
    **dict.fromkeys(("Mearth", "MEarth", "earthMass"), "M_earth"),
    **dict.fromkeys(("Mjup", "MJupiter", "jupiterMass"), "M_jupiter"),
    **dict.fromkeys(("Rsun", "RSun", "solRad"), "R_sun"),
    **dict.fromkeys(("Rearth", "REarth", "earthRad"), "R_earth"),
    **dict.fromkeys(("Rjup", "RJupiter", "jupiterRad"), "R_jupiter"),
    **{"Angstrom": "angstrom", "u": "dalton", "Da": "dalton"},
}

LONGEST = 80  # largest number of characters of a text that is read
DEFINITIONS = Path(__file__).with_name("definitions.txt")

_SUPERSCRIPTS = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")
_NAME = r"(?:[^\W\d]+|°)"
_POWER = r"(?:\s*(?:\^|\*\*)\s*|(?<=[^\W\d°)]))[+-]?\d(?!\d)"  # one digit, so that no power takes long to compute
_POWERS = re.compile(rf"({_NAME}|\)){_POWER.replace('[+-]', '([+-]').replace('(?!', ')(?!')}")
_ONE = rf"{_NAME}(?:{_POWER})?"
_TIMES = r"(?:\s*[*/·]\s*|\s+)"
_GROUP = rf"(?:{_ONE}|\(\s*{_ONE}(?:{_TIMES}{_ONE})*\s*\)(?:{_POWER})?)"
_UNIT = re.compile(rf"{_GROUP}(?:{_TIMES}{_GROUP})*")  # products and powers of names
_WORDS = re.compile(r"([^\W\d]+) (?=([^\W\d]+))")
_NAMES = re.compile(_NAME)
_PER_ONE = re.compile(rf"^/\s*({_NAME})$")  # as in "500 /s"
_BESIDE = re.compile(r"(?<=[\w°)])\s+(?=[^\W\d]|[°(])")  # the space between two factors


class UnitError(ValueError):
    """A text is not a unit, or not a unit of the expected dimension."""


class UnknownUnitError(UnitError):
    """A name is not a unit."""

    def __init__(self, name: str, known: Iterable[str]) -> None:
        near = _nearest(name, known)
        # the usual form of a name with several words; symbols with capitals are unchanged
        hint = f' (did you mean "{near.replace("_", " ") if near.islower() else near}"?)' if near else ""
        super().__init__(f'there is no unit "{name}"{hint}')
        self.name = name


@dataclass(frozen=True, slots=True)
class Unit:
    """A unit: its exact size in SI, and its dimension."""

    size: Fraction  # size in SI units
    exponents: Exponents

    @property
    def dimension(self) -> Dimension | None:
        """The dimension of the unit, if quantities of a scene may have it."""
        return OF_EXPONENTS.get(self.exponents)


@cache
def unit(text: str) -> Unit:
    """Read a unit such as "km", "g/cm^3", "m s⁻²" or "solar mass".

    Raises `UnitError` if the text is not a unit; the message names the most similar unit.
    """
    written = _joined(text.strip().translate(_SUPERSCRIPTS)) if len(text) <= LONGEST else ""
    written = _PER_ONE.sub(r"\1^-1", written)
    if not _UNIT.fullmatch(written):
        raise UnitError(f'"{text[:LONGEST]}" is not a unit')
    written = _NAMES.sub(lambda name: _FOREIGN.get(name[0], name[0]), written)
    for name in _NAMES.findall(written):
        if name not in _written():
            raise UnknownUnitError(name, _written())
    known: Any = registry()
    try:
        size, base = known.get_root_units(_with_signs(written))
        dimensions = known.get_dimensionality(base)
    except Exception:  # another package's parser may raise anything, but a user's text must never cause a traceback
        raise UnitError(f'"{text}" is not a unit') from None
    length, time, mass, angle = (int(dimensions.get(f"[{name}]", 0)) for name in BASE)
    return Unit(Fraction(size) / Fraction(1000) ** mass, (length, time, mass, angle))


def unit_of(text: str, dimension: Dimension) -> Unit:
    """Read a unit of a dimension; raises `UnitError` if the text is not a unit, or has another dimension."""
    try:
        known = unit(text)
    except UnknownUnitError as error:
        if error.name != text.strip():  # the unknown name is part of a product, and may have any dimension
            raise
        alike = set(written_names(name for name in names() if unit(name).exponents == dimension.exponents))
        raise UnknownUnitError(error.name, alike if _nearest(error.name, alike) else _written()) from None
    if known.exponents != dimension.exponents:
        what = f"{known.dimension.called}, not" if known.dimension else "not"
        raise UnitError(f'"{text.strip()}" is {what} {dimension.called}')
    return known


@cache
def registry() -> UnitRegistry[Any]:
    """Return the registry of the units that carom knows."""
    from pint import UnitRegistry  # noqa: PLC0415 - slow to import, and most scenes need none

    units: UnitRegistry[Any] = UnitRegistry(None, non_int_type=Fraction)
    for line in _definitions():
        units.define(line)
    return units


def names() -> Iterator[str]:
    """Return the names of all units, in the order of their definitions."""
    for line in _definitions():
        name, _, *others = (part.strip() for part in line.split("="))
        if not name.endswith("-"):  # a prefix
            yield from (name, *others)


def _definitions() -> list[str]:
    lines = DEFINITIONS.read_text(encoding="utf-8").splitlines()
    return [line for line in lines if line and not line.startswith("#")]


def _with_signs(written: str) -> str:
    """Write products and powers with signs: pint 0.26 reads "m (km/s)^2" as (m km/s)²."""
    return _BESIDE.sub("*", _POWERS.sub(r"\1**\2", written).replace("·", "*"))


def _joined(text: str) -> str:
    """Join words that form a single name, such as "solar mass", by underscores."""
    known = set(names())
    return _WORDS.sub(lambda pair: f"{pair[1]}{'_' if f'{pair[1]}_{pair[2]}' in known else ' '}", text)


@cache
def _written() -> frozenset[str]:
    """Return all accepted names of units, with prefixes and in the plural."""
    return frozenset(written_names(names()))


def _nearest(name: str, known: Iterable[str]) -> str:
    """Return the known name that is most similar, ignoring case; empty if no name is similar."""
    by_lower: dict[str, list[str]] = {}
    for word in sorted(known):
        by_lower.setdefault(word.lower(), []).append(word)
    near = difflib.get_close_matches(name.lower(), by_lower, n=1)
    return max(by_lower[near[0]], key=lambda word: difflib.SequenceMatcher(None, name, word).ratio()) if near else ""


_NUMBER_WITH_UNIT = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d{1,3})?)(.*)", re.DOTALL)

_THOUSANDS = re.compile(r"\s*[+-]?\d{1,3},\d{3}(,\d{3})+(?![\d,.])")
_DECIMAL_COMMA, _POINT = re.compile(r"\s*([+-]?\d+),(?=\d)"), r"\1."


def quantity(text: str, dimension: Dimension) -> Fraction:
    """Read a quantity of a dimension; return it exactly, in SI.

    Raises `UnitError` if the text is not a number with a unit of that dimension. The message names a valid form.
    """
    parts = _parts(text)
    if text.lstrip().startswith("["):
        raise UnitError(f"a list, in which each text needs quotes{_such_as(dimension)}")
    if _THOUSANDS.match(text):
        raise UnitError(f'commas between thousands; write "{text.replace(",", "").strip()}"')
    if text.count(",") > 1:
        raise UnitError(f"several numbers need brackets: [{text.strip()[:LONGEST]}]")
    if not parts:
        raise UnitError(f"expected a number, or a text with a unit{_such_as(dimension)}")
    if _DECIMAL_COMMA.match(text):
        raise UnitError(f'a decimal comma; write "{_DECIMAL_COMMA.sub(_POINT, text).strip()}"')
    if not parts[2].strip():
        raise UnitError(
            f"a text needs a unit{_such_as(dimension)}; for {dimension.unit} write the number without quotes"
        )
    try:
        return Fraction(parts[1]) * unit_of(parts[2], dimension).size
    except UnitError as error:
        raise UnitError(f"{error}; expected {dimension.called}{_such_as(dimension)}") from None


def size_of(text: str, dimension: Dimension) -> Fraction:
    """Return the size in SI of a unit that is a name, or a number of named units, such as "3.085678e21 cm"."""
    return quantity(text, dimension) if text[:1].isdigit() else unit_of(text, dimension).size


def _parts(text: str) -> re.Match[str] | None:
    """Split a text into a number and a unit; None if it does not begin with a number."""
    return _NUMBER_WITH_UNIT.fullmatch(text) if len(text) <= LONGEST else None


class Physical(NamedTuple):
    """A quantity of any dimension."""

    size: Fraction  # size in SI
    unit: Unit
    unit_text: str  # unit as written


def physical(text: str) -> Physical | None:
    """Read a quantity of any dimension; None if the text is not one."""
    parts = _parts(text)
    if not parts or not parts[2].strip():
        return None
    try:
        of = unit(parts[2])
    except UnitError:
        return None
    return Physical(Fraction(parts[1]) * of.size, of, parts[2].strip())


def nearest_float(value: Fraction) -> float:
    """Return the nearest double; infinity beyond the largest double, which a scene refuses like any infinity."""
    try:
        return float(value)
    except OverflowError:
        return float("inf") if value > 0 else float("-inf")


def _such_as(dimension: Dimension) -> str:
    return f', such as "{dimension.example}"'
