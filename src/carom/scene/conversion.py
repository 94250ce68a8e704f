"""Conversion of quantities, such as "3 km" or numbers in the units of [units], to the units of the simulation."""

from __future__ import annotations

import operator
import types
import typing
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache
from typing import Any, Literal

from pydantic import BaseModel

from carom.scene.scene_file import KeyPath
from carom.scene.scene_model import SceneModel
from carom.scene.schema import Gravity
from carom.scene.units.dimension import GRAVITATIONAL_CONSTANT, NAMED, Dimension, UnitError, unit_of
from carom.scene.units.system import SI, UnitSystem
from carom.scene.wording import suggestion

_NUMBERS = {float, int}
_WRITTEN_BY_CAROM = "promise"  # a section already in the units of the simulation


@dataclass
class Wrong:
    """A text that stands where a quantity should be."""

    path: KeyPath
    given: str | None  # the given value; None if nothing was given
    message: str


@dataclass(frozen=True)
class _Place:
    """The values that a key may have: a quantity of a dimension, a word from a list, or a section."""

    dimension: Dimension | None
    words: frozenset[str] = frozenset()
    below: Mapping[str, _Place] = field(default_factory=dict)


def unit_system(units: Any, wrong: list[Wrong]) -> UnitSystem:
    """Return the units given under ``units`` in a scene; append mistakes in them to ``wrong``."""
    if isinstance(units, str):
        try:
            return UnitSystem.of_text(units)
        except UnitError as error:
            wrong.append(Wrong(("units",), units, str(error)))
        return SI
    if not isinstance(units, Mapping):
        if units is not None:
            wrong.append(Wrong(("units",), str(units), "must be a section with keys, or a string with units"))
        return SI
    given = {}
    for key, text in units.items():
        if key not in NAMED:
            near = suggestion(str(key), NAMED)
            wrong.append(Wrong(("units", key), None, f"is not a dimension; {near}"))
            continue
        try:
            if not isinstance(text, str):
                raise UnitError("must be text in quotes")
            unit_of(text, NAMED[key])
            given[key] = text.strip()
        except UnitError as error:
            expected = f'{error}; expected a unit such as "{NAMED[key].unit}"'
            wrong.append(Wrong(("units", key), str(text), expected))
    return UnitSystem(given)


def converted(data: Mapping[str, Any]) -> tuple[Mapping[str, Any], UnitSystem, list[Wrong]]:
    """Convert the quantities of a scene; unchanged values are shared with the input.

    Returns
    -------
    data, units, wrong
        The scene in the units of the simulation, these units, and the texts that are not quantities.
    """
    wrong: list[Wrong] = []
    units = unit_system(data.get("units"), wrong)
    numbers = {key: _walked(value, place(key), units, (key,), wrong) for key, value in data.items()}
    gravity = numbers.get("gravity", {})
    # the default of the gravitational constant depends on the units
    if units.own and isinstance(gravity, Mapping) and "constant" not in gravity and gravity.get("method") != "none":
        if units.dimensionless:
            missing = 'is missing; a scene with units = "dimensionless" must state it (0 is no gravity)'
            wrong.append(Wrong(("gravity", "constant"), None, missing))
        else:
            constant = units.of_si(Gravity().constant, GRAVITATIONAL_CONSTANT)
            numbers["gravity"] = {**gravity, "constant": constant}
    return numbers, units, wrong


def _walked(value: Any, at: _Place | None, units: UnitSystem, path: KeyPath, wrong: list[Wrong]) -> Any:
    """Convert a value and all values below it; values without a dimension are returned unchanged."""
    kind = type(value)
    if at is None or kind is bool or (kind in _NUMBERS and not units.converts):
        return value
    if isinstance(value, Mapping):
        changed = {}
        for key, inner in value.items():
            if (below := at.below.get(key)) and not (type(inner) in _NUMBERS and not units.converts):
                number = _walked(inner, below, units, (*path, key), wrong)
                if number is not inner:
                    changed[key] = number
        return {**value, **changed} if changed else value
    if isinstance(value, list | tuple):
        if not units.converts and _NUMBERS.issuperset(map(type, value)):
            return value
        entries = [_walked(inner, at, units, (*path, k), wrong) for k, inner in enumerate(value)]
        return entries if any(map(operator.is_not, entries, value)) else value
    if at.dimension is None:
        return value
    if isinstance(value, int | float):
        return units.converted(value, at.dimension)
    if isinstance(value, str) and value not in at.words and not (at.words and value[:1].isalpha()):
        try:
            return units.number(value, at.dimension)
        except UnitError as error:
            wrong.append(Wrong(path, value, str(error)))
    return value


def place_of(path: KeyPath) -> _Place | None:
    """Return the values that a path of keys may have; None if it contains no quantities."""
    keys = [key for key in path if isinstance(key, str)]
    at = place(keys[0]) if keys else None
    for key in keys[1:]:
        at = at and at.below.get(key)
    return at


@dataclass(frozen=True)
class _Factors(UnitSystem):
    """Multiplies plain numbers by a factor."""

    factor_of: Callable[[Dimension], float] = lambda dimension: 1.0

    @property
    def converts(self) -> bool:
        return True

    def converted(self, number: float, dimension: Dimension) -> float:
        return number * self.factor_of(dimension)


def rescaled(data: Mapping[str, Any], factor_of: Callable[[Dimension], float]) -> dict[str, Any]:
    """Return a scene in the units of the simulation, with numbers multiplied by a factor for each dimension."""
    factors, places = _Factors(factor_of=factor_of), _places(SceneModel)
    return {key: _walked(value, places.get(key), factors, (key,), []) for key, value in data.items()}


def place(key: str) -> _Place | None:
    """Return the values that a key of a scene and the keys below it may have; None if no value is a quantity."""
    return None if key == _WRITTEN_BY_CAROM else _places(SceneModel).get(key)


@cache
def _places(model: type[BaseModel]) -> dict[str, _Place]:
    """Return the values of all keys of a model that hold quantities."""
    places = {}
    for key, info in model.model_fields.items():
        dimension, words, below = None, set[str](), dict[str, _Place]()
        for part in (*info.metadata, *parts_of(info.annotation)):
            if typing.get_origin(part) is Literal:
                words.update(word for word in typing.get_args(part) if isinstance(word, str))
            elif isinstance(part, Dimension):
                dimension = part
            elif isinstance(part, type) and issubclass(part, BaseModel):
                below |= _places(part)
        if dimension or below:
            places[key] = _Place(dimension, frozenset(words), below)
    return places


def parts_of(annotation: Any) -> Iterator[Any]:
    """Return the types and the metadata in an annotation."""
    origin = typing.get_origin(annotation)
    if origin is typing.Annotated:
        yield from parts_of(annotation.__origin__)
        yield from annotation.__metadata__
    elif origin in (typing.Union, types.UnionType, tuple):
        for part in typing.get_args(annotation):
            yield from parts_of(part)
    else:
        yield annotation


def members_of_list(annotation: Any) -> tuple[Any, ...]:
    """Return the members of the tuple in an annotation, with `...` at the end for any number; () without a tuple."""
    origin, members = typing.get_origin(annotation), typing.get_args(annotation)
    if origin is tuple:
        return members
    if origin in (typing.Union, types.UnionType, typing.Annotated):
        return next((inner for part in members if (inner := members_of_list(part))), ())
    return ()
