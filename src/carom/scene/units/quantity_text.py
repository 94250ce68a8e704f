"""Quantities as texts: "3 km" and the number that it is."""

from __future__ import annotations

import re
from fractions import Fraction
from typing import NamedTuple

from carom.scene.units.dimension import Dimension
from carom.scene.units.unit import LONGEST, Unit, UnitError, unit, unit_of

_QUANTITY = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d{1,3})?)(.*)", re.DOTALL)

_THOUSANDS = re.compile(r"\s*[+-]?\d{1,3},\d{3}(,\d{3})+(?![\d,.])")
_DECIMAL_COMMA, _POINT = re.compile(r"\s*([+-]?\d+),(?=\d)"), r"\1."


def quantity(text: str, dimension: Dimension) -> Fraction:
    """Read a quantity of a dimension; returns it in SI, exactly.

    Raises
    ------
    UnitError
        If the text is not a number with a unit of that dimension. The message says what would be right.
    """
    found = _parts(text)
    if text.lstrip().startswith("["):
        raise UnitError(f"a list, in which each text needs quotes{_such_as(dimension)}")
    if _THOUSANDS.match(text):
        raise UnitError(f'commas between thousands; write "{text.replace(",", "").strip()}"')
    if text.count(",") > 1:
        raise UnitError(f"several numbers need brackets: [{text.strip()[:LONGEST]}]")
    if not found:
        raise UnitError(f"expected a number, or a text with a unit{_such_as(dimension)}")
    if _DECIMAL_COMMA.match(text):
        raise UnitError(f'a decimal comma; write "{_DECIMAL_COMMA.sub(_POINT, text).strip()}"')
    if not found[2].strip():
        raise UnitError(
            f"a text needs a unit{_such_as(dimension)}; for {dimension.unit} write the number without quotes"
        )
    try:
        return Fraction(found[1]) * unit_of(found[2], dimension).size
    except UnitError as error:
        raise UnitError(f"{error}; expected {dimension.called}{_such_as(dimension)}") from None


def _parts(text: str) -> re.Match[str] | None:
    """Split a text into a number and a unit; None if it does not begin with a number."""
    return _QUANTITY.fullmatch(text) if len(text) <= LONGEST else None


class Physical(NamedTuple):
    """A quantity of any dimension."""

    size: Fraction  # in SI
    unit: Unit
    unit_text: str  # as written


def physical(text: str) -> Physical | None:
    """Read a quantity of any dimension; None if the text is none."""
    found = _parts(text)
    if not found or not found[2].strip():
        return None
    try:
        of = unit(found[2])
    except UnitError:
        return None
    return Physical(Fraction(found[1]) * of.size, of, found[2].strip())


def nearest_float(value: Fraction) -> float:
    """Return the nearest double; infinity beyond the largest, which a scene refuses like any other infinity."""
    try:
        return float(value)
    except OverflowError:
        return float("inf") if value > 0 else float("-inf")


def _such_as(dimension: Dimension) -> str:
    return f', such as "{dimension.example}"'
