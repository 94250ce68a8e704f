"""The units of a scene, for its plain numbers, for the simulation and for printed numbers."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cached_property

from carom.scene.units.dimension import (
    BASE,
    LENGTH,
    MASS,
    NAMED,
    OF_UNIT,
    TIME,
    Dimension,
    UnitError,
    nearest_float,
    quantity,
    size_of,
    unit,
    unit_of,
)

OWN = (LENGTH, TIME, MASS)  # the dimensions in ``units = "au, day, solar mass"``
WITHOUT = "dimensionless"  # value of ``units`` for a scene without units

_IN_PRINT = ("mass", "length", "angle", "time")  # order of the base units in a product
_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


@dataclass(frozen=True)
class UnitSystem:
    """Units by their keys in [units]; SI if no unit is given.

    By default, a scene is simulated and recorded in SI, and plain numbers are converted. With `own`, the scene is
    simulated and recorded in its own units, without conversion.
    """

    given: Mapping[str, str] = field(default_factory=dict)
    own: bool = False

    @classmethod
    def of_text(cls, text: str) -> UnitSystem:
        """Read ``units = "au, day, solar mass"``; raises `UnitError` unless these are a length, a time and a mass."""
        if text.strip() == WITHOUT:
            return cls({dimension.plain: "" for dimension in OWN}, own=True)
        given: dict[str, str] = {}
        for part in text.split(","):
            try:
                kind = unit(part).dimension
            except UnitError as error:
                raise UnitError(f"{error}{_SUCH_AS}") from None
            if kind not in OWN:
                what = kind.called if kind else "neither a length, a time nor a mass"
                raise UnitError(f'"{part.strip()}" is {what}{_SUCH_AS}')
            if kind.plain in given:
                raise UnitError(f'"{part.strip()}" is a second {kind.name}{_SUCH_AS}')
            given[kind.plain] = part.strip()
        for dimension in OWN:
            if dimension.plain not in given:
                raise UnitError(f"{dimension.called} is missing{_SUCH_AS}")
        return cls(given, own=True)

    @classmethod
    def of_properties(cls, properties: Mapping[str, object]) -> UnitSystem:
        """Read the entries of `properties`, without other keys; raises `UnitError` if an entry is not a unit."""
        if "units" in properties:
            parts = str(properties["units"]).split(", ")
            given = parts if len(parts) == len(OWN) else [""] * len(OWN)
            return cls({dimension.plain: part for dimension, part in zip(OWN, given, strict=True)}, own=True)
        texts = {key: str(properties[f"units.{key}"]) for key in NAMED if f"units.{key}" in properties}
        for key, text in texts.items():
            unit_of(text, NAMED[key])
        return cls(texts)

    def properties(self) -> dict[str, str]:
        """Return entries for a recording's properties; none for SI."""
        if not self.own:
            return {f"units.{key}": text for key, text in self.given.items()}
        return {"units": WITHOUT if self.dimensionless else ", ".join(self.given[each.plain] for each in OWN)}

    @property
    def is_si(self) -> bool:
        """Whether numbers are read, stored and printed in SI."""
        return not self.given

    @property
    def named(self) -> str:
        """All units that are given, such as "au, day, solar mass"."""
        return ", ".join(text for text in self.given.values() if text)

    @property
    def recorded(self) -> str:
        """Name the units of recorded numbers: "SI", or the scene's own, such as "au, day, solar mass"."""
        return self.properties()["units"] if self.own else "SI"

    @property
    def converts(self) -> bool:
        """Whether plain numbers are converted to SI."""
        return bool(self.given) and not self.own

    @property
    def dimensionless(self) -> bool:
        """Whether the numbers have no units."""
        return self.own and not self.given[LENGTH.plain]

    def number(self, text: str, dimension: Dimension) -> float:
        """Read a quantity such as "3 km" as a number of the simulation; raises `UnitError` for any other text."""
        if self.dimensionless:
            raise UnitError(f'units = "{WITHOUT}": expected a plain number')
        value = quantity(text, dimension)
        return nearest_float(value / self.size(dimension) if self.own else value)

    def converted(self, number: float, dimension: Dimension) -> float:
        """Convert a plain number of the scene, or of an option, to the units of the simulation."""
        if not self.converts or self.size(dimension) == 1:
            return number
        try:
            return nearest_float(Fraction(float.__repr__(float(number))) * self.size(dimension))
        except (ValueError, OverflowError):  # the result is not finite, so the schema will refuse it
            return number

    def literal(self, number: float, dimension: Dimension) -> str:
        """Write a number of the simulation as a TOML value of the scene."""
        plain = float.__repr__(float(number))
        return f'"{plain} {dimension.unit}"' if self.converts else plain

    def of_si(self, number: float, dimension: Dimension) -> float:
        """Convert a number in SI to the units of the simulation."""
        return nearest_float(Fraction(repr(number)) / self.size(dimension)) if self.own else number

    def factor(self, dimension: Dimension) -> float:
        """Return the factor that converts the scene's plain numbers to the units of the simulation; 1 in SI."""
        return nearest_float(self.size(dimension)) if self.converts else 1.0

    def agrees(self, other: UnitSystem, dimension: Dimension) -> bool:
        """Return whether both systems have the same unit of a dimension."""
        return self.size(dimension) == other.size(dimension)

    def shown(self, number: float, dimension: Dimension) -> float:
        """Convert a number of the simulation to its printed unit."""
        factor = self.factor(dimension)
        return number if factor == 1.0 else number / factor

    def text(self, number: float, dimension: Dimension, form: str = ".6g") -> str:
        """Write a number of the simulation with its unit, such as "3 km"."""
        return f"{self.shown(number, dimension):{form}} {self.unit(dimension)}".rstrip()

    def vector(self, numbers: Iterable[float], dimension: Dimension) -> str:
        """Write a vector of numbers of the simulation, such as "[1.0, 2.0, 3.0] km"."""
        return f"{[self.shown(number, dimension) for number in numbers]} {self.unit(dimension)}".rstrip()

    def span(self, first: float, last: float, dimension: Dimension, form: str = ".6g") -> str:
        """Write an interval of numbers of the simulation, such as "3 to 5 km"."""
        return f"{self.shown(first, dimension):{form}} to {self.text(last, dimension, form)}"

    def unit(self, dimension: Dimension) -> str:
        """Return the name of the printed unit of a dimension; empty for pure numbers."""
        return dimension.unit if self.is_si else self._names(dimension)

    def labelled(self, label: str, dimension: Dimension) -> str:
        """Write the heading of a column of numbers, such as "t (s)"."""
        return f"{label} ({self.unit(dimension)})" if self.unit(dimension) else label

    def recorded_unit(self, si: str) -> str:
        """Name the unit of a recorded series, given its SI unit; "1" for none."""
        if not self.own or si not in OF_UNIT:
            return si
        return self._names(OF_UNIT[si]) or "1"

    def _names(self, dimension: Dimension) -> str:
        if dimension.plain in self.given:
            return self.given[dimension.plain]
        powers = dict(zip(BASE, dimension.exponents, strict=True))
        if not any(powers[name] for name in BASE if name in self.given):
            return dimension.unit
        return composed([(self.given.get(name, NAMED[name].unit), powers[name]) for name in _IN_PRINT])

    def size(self, dimension: Dimension) -> Fraction:
        """Return the exact size of the scene's unit, in SI units."""
        if dimension not in self._sizes:
            size = Fraction(1)
            if not self.dimensionless and dimension.plain in self.given:
                size = size_of(self.given[dimension.plain], dimension)
            elif not self.dimensionless:
                for name, power in zip(BASE, dimension.exponents, strict=True):
                    if power and name in self.given:
                        size *= size_of(self.given[name], NAMED[name]) ** power
            self._sizes[dimension] = size
        return self._sizes[dimension]

    @cached_property
    def _sizes(self) -> dict[Dimension, Fraction]:
        return {}


def composed(powers: Sequence[tuple[str, int]]) -> str:
    """Write a product of powers of units, such as "solar mass au²/day²"; units without a name are omitted."""
    product = " ".join(raised(name, power) for name, power in powers if name and power > 0)
    below = [raised(name, -power) for name, power in powers if name and power < 0]
    divisor = f"({' '.join(below)})" if len(below) > 1 else "".join(below)
    return f"{product or '1'}/{divisor}" if divisor else product


def raised(name: str, power: int) -> str:
    """Write a power of a unit or number; the first power is the name alone."""
    return name if power == 1 else f"{name}{str(power).translate(_RAISED)}"


_SUCH_AS = f'; expected a length, a time and a mass, such as "au, day, solar mass", or "{WITHOUT}"'


SI = UnitSystem()
_NAMES = {  # carom's names of units, by REBOUND's names
    **dict.fromkeys(("m", "cm", "km", "pc", "s", "yr", "kyr", "kg", "g"), ""),
    **{"au": "au", "aus": "au", "parsec": "pc", "hr": "h", "d": "day", "day": "day", "days": "day"},
    **dict.fromkeys(("year", "years", "yrs", "jyr"), "yr"),
    **{"myr": "Myr", "gyr": "Gyr", "gram": "g", "mearth": "M_earth", "mjupiter": "M_jupiter"},
    **dict.fromkeys(("msun", "solarmass", "sunmass", "msolar"), "M_sun"),
}
_NAMES.update({name: name for name, known in _NAMES.items() if not known})


def units_of_rebound(units: Mapping[str, str | None]) -> str:
    """Return the units of a simulation, such as "au, day, M_sun"; empty if they are missing or unknown."""
    known = [_NAMES.get(units[what] or "", "") for what in ("length", "time", "mass")]
    return ", ".join(known) if all(known) else ""
