"""Messages about the keys of a scene: the mistake, a valid value, and the key that was probably meant."""

from __future__ import annotations

import difflib
import re
import sys
import types
import typing
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from carom import registry
from carom.errors import SceneError
from carom.scene.conversion import Wrong, members_of_list, parts_of, place_of
from carom.scene.scene_file import KeyPath, KeyPlaces
from carom.scene.scene_model import SceneModel
from carom.scene.schema import Coefficients
from carom.scene.schema.quantity import SectionError
from carom.scene.units.system import UnitSystem

LONGEST = 80  # characters of a key or a given text that messages show and compare
MOST = 4  # largest number of places that a message lists
# smallest similarity at which a key is suggested: within the section, and from other sections
ALIKE, ALIKE_ELSEWHERE = 0.75, 0.8
SHORTEST = 3  # smallest number of characters of an abbreviated key
OTHER_WORDS = {
    **dict.fromkeys(("sphere", "spheres", "ball", "balls", "particle"), "body"),
    **dict.fromkeys(("floor", "ground"), "plane"),
    **dict.fromkeys(("dt", "timestep"), "time.fixed_dt"),
    **dict.fromkeys(("bounce", "elasticity", "cor"), "contact.restitution"),
    **dict.fromkeys(("friction", "mu"), "contact.static_friction"),
    **dict.fromkeys(("viscosity", "tau"), "drag.relaxation_time"),
    **dict.fromkeys(("acceleration", "field", "g"), "uniform"),  # keys of gravity
    "steps": "time.duration",
    "particles": "group",
    "diameter": "radius",
    "walls": "domain.boundary",
    "omega": "angular_velocity",
    "name": "title",
}
REMARKS = {"diameter": " It is half of the diameter."}


def hint(path: KeyPath) -> str:
    """Name the keys most similar to an unknown key, or all keys of its section; the text begins with a semicolon."""
    section = _field(path[:-1])
    model = SceneModel if len(path) == 1 else section and model_in(section.annotation)
    if model is None:
        return ""
    key, here = str(path[-1])[:LONGEST], list(model.model_fields)
    if path[:-1] == ("forces",):
        near = _near(key, here, ALIKE)
        return _meant([near]) if near else f"; no installed package has a force of that name (in {sys.prefix})"
    if path[0] in ("body", "group") and key in Coefficients._fields:
        return f"; set it in a [[material]] that the {path[0]} names, or for all bodies by contact.{key}"
    if near := _near(key, here, ALIKE):
        return _meant([near])
    choices = _chosen_by_few()
    sections = {name: model_in(model.model_fields[name].annotation) for name in choices if name in here}
    if inside := [f"{name}.{key}" for name, inner in sections.items() if inner and key in inner.model_fields]:
        return _meant(inside)
    if len(path) > 1 and (path[0] == "wall" or path[-2] == "motion" or path[-2] in choices):
        return f"; known here: {', '.join(here)}"
    places, other = _places(SceneModel), OTHER_WORDS.get(key)
    if key in places and other not in here:
        return _meant(places[key])
    if other is not None and ("." in other or other in here or len(path) == 1):
        return _meant([other]) + REMARKS.get(key, "")
    if near := _near(key, list(places), ALIKE_ELSEWHERE):
        return _meant(places[near])
    return f"; known here: {', '.join(here)}"


def _near(key: str, known: list[str], alike: float) -> str | None:
    """Return the most similar known key, or the only known key that begins with ``key``."""
    similar = difflib.get_close_matches(key, known, n=1, cutoff=alike)
    longer = [name for name in known if len(key) >= SHORTEST and name.startswith(key)]
    return similar[0] if similar else longer[0] if len(longer) == 1 else None


def _meant(keys: list[str]) -> str:
    *others, last = (f'"{key}"' for key in keys[:MOST])
    return f"; did you mean {', '.join(others)}{' or ' if others else ''}{last}?"


def _chosen_by_few() -> list[str]:
    """Return the names of all shapes of walls and of all contact laws; a scene uses few of these names."""
    return [*registry.names("walls"), *registry.names("contact_laws")]


def _places(model: type[BaseModel], above: str = "") -> dict[str, list[str]]:
    """Return the dotted paths of all keys in a model and its nested models, by key; 0 stands for any index.

    The keys of contact laws and of shapes of walls are omitted.
    """
    places: dict[str, list[str]] = {}
    for key, field in model.model_fields.items():
        places.setdefault(key, []).append(f"{above}{key}")
        inner = model_in(field.annotation)
        if inner is not None and key not in _chosen_by_few():
            several = "0." if typing.get_origin(field.annotation) is tuple else ""
            for below, paths in _places(inner, f"{above}{key}.{several}").items():
                places.setdefault(below, []).extend(paths)
    return places


def model_in(annotation: Any) -> type[BaseModel] | None:
    """Return the model in an annotation such as ``tuple[Body, ...]`` or ``Region | None``."""
    if isinstance(annotation, type) and not isinstance(annotation, types.GenericAlias):
        return annotation if issubclass(annotation, BaseModel) else None
    models = (model_in(member) for member in typing.get_args(annotation))
    return next((model for model in models if model is not None), None)


def is_known(path: KeyPath, messages: Collection[KeyPath]) -> bool:
    """Return whether a key, or a section that contains it, already has a message."""
    wrong_units = path[0:1] == ("units",) and any(other[0] == "units" for other in messages)
    return wrong_units or any(path[:depth] in messages for depth in range(1, len(path) + 1))


def not_a_quantity(wrong: Wrong, places: KeyPlaces) -> str:
    """Return a one-line message about a text that is not a quantity: place, key, mistake and a valid value."""
    key = ".".join(str(part)[:LONGEST] for part in wrong.path)
    given = "" if wrong.given is None else f" = {wrong.given[:LONGEST]!r}:"
    return f"{places.of(wrong.path)}{key}{given} {wrong.message}"


def explain(detail: Any, path: KeyPath, places: KeyPlaces, data: Any, units: UnitSystem) -> str:
    """Return a one-line message about a mistake reported by Pydantic: place, key, mistake and a valid value."""
    place, key, given = places.of(path), ".".join(str(part)[:LONGEST] for part in path), _as_written(detail, path, data)
    if detail["type"] == "extra_forbidden":
        return f"{place}unknown key {key}{hint(path)}"
    if detail["type"] == "missing" and isinstance(detail["loc"][-1], str):
        return f"{place}{key} is missing{_expected(path, units)}"
    if detail["type"] == "value_error":
        return f"{place}{key}{': ' if key else ''}{detail['ctx']['error']}"
    shown = repr(given) if isinstance(given, str) else str(given).lower() if isinstance(given, bool) else str(given)
    return f"{place}{key} = {shown[:80]}: {_wrong(detail, path)}{_expected(path, units)}"


def with_words(details: Sequence[Any]) -> Iterator[Any]:
    """Yield one detail for each mistake; if a key accepts words or numbers, the detail names both."""
    words = {detail["loc"][:-1]: detail for detail in details if detail["type"] == "literal_error"}
    numbers = {detail["loc"][:-1] for detail in details if "constrained-" in str(detail["loc"][-1:])}
    members = {detail["loc"][:-1] for detail in details}
    for detail in details:
        key = detail["loc"][:-1]
        if detail["type"] == "too_short" and detail["loc"] in members:
            continue  # Pydantic does not count wrong entries
        if key not in words or key not in numbers:
            yield detail
        elif detail is not words[key]:
            yield detail | {"words": words[key]["ctx"]["expected"]}


def written_path(detail: Any, data: Any) -> KeyPath:
    """Return the path as the user wrote it, such as ``radius``, not ``radius.min``, for a radius that is a number."""
    members = ("float", "nan", "literal")  # members of unions, which Pydantic adds to the path
    path: KeyPath = tuple(
        key
        for key in detail["loc"]
        if isinstance(key, int) or not ("[" in key or key.startswith("constrained") or key in members)
    )
    error = detail.get("ctx", {}).get("error")
    if isinstance(error, SectionError):
        path = (*path, *error.path)
    node = data
    for depth, key in enumerate(path):
        if isinstance(node, dict):
            node = node.get(key)
        elif isinstance(node, list) and isinstance(key, int) and key < len(node):
            node = node[key]
        else:
            return path[:depth]
    return path


def _as_written(detail: Any, path: KeyPath, data: Any) -> Any:
    """Return the value at a path before conversion; None if the scene had no value there."""
    node, given = data, detail["input"]
    if not isinstance(given, int | float):
        return given
    try:
        for key in path:
            node = node[key]
    except (KeyError, IndexError, TypeError):  # no value there: the default depends on another key
        return given
    return node if isinstance(node, str | int | float) else given


def _wrong(detail: Any, path: KeyPath) -> str:
    context = detail.get("ctx", {})
    match detail["type"]:
        case "greater_than":
            return f"must be more than {context['gt']:g}"
        case "greater_than_equal":
            return f"must be at least {context['ge']:g}"
        case "less_than":
            return f"must be less than {context['lt']}"
        case "less_than_equal":
            return f"must be at most {context['le']:g}"
        case "finite_number":
            return "must be a finite number"
        # a whole number that is too large may have hundreds of digits
        case "float_type" if type(detail["input"]) is int:
            return "must be a finite number"
        case "float_type" | "int_type" | "int_from_float" | "string_type" | "bool_type":
            kinds = {"float": "a number", "int": "a whole number", "string": "text in quotes", "bool": "true or false"}
            words = f"{detail['words']}, or " if "words" in detail else ""
            return f"must be {words}{kinds[detail['type'].split('_')[0]]}"
        case "literal_error":
            return f"must be {context['expected']}"
        case "too_short" if _has_any_length(path):
            return f"must have at least {context['min_length']} of them"
        case "too_long" if _has_any_length(path):
            return f"must have at most {context['max_length']} of them"
        case "too_short" | "too_long" | "tuple_type" | "missing":
            return f"must be {_list_at(path)}"
        case "model_type" | "model_attributes_type" | "dict_type":
            return "must be a section with keys"
        case _:
            return str(detail["msg"])


def _has_any_length(path: KeyPath) -> bool:
    """Return whether a key has a list of any length, within limits."""
    field = _field(path)
    return field is not None and members_of_list(field.annotation)[-1:] == (...,)


def _list_at(path: KeyPath) -> str:
    field = _field(path)
    annotation = None if field is None else field.annotation
    members = members_of_list(annotation)
    if _has_any_length(path):
        return "a list" if model_in(annotation) is None else "a list of sections; write it in double brackets"
    if len(members) == 2:
        return "a list of two"
    named = any(str in parts_of(member) for member in members)
    return "the names of three columns" if named else "three numbers [x, y, z]"


def _field(path: KeyPath) -> FieldInfo | None:
    """Return the field of the last key in a path; None if the schema has no such key."""
    model: type[BaseModel] | None = SceneModel
    field = None
    for key in path:
        if isinstance(key, str):
            field = None if model is None else model.model_fields.get(key)
            model = None if field is None else model_in(field.annotation)
    return field


def _expected(path: KeyPath, units: UnitSystem) -> str:
    """Return the description of a key; its numbers are in the units of the scene."""
    field = _field(path)
    if field is None or not field.description:
        return ""
    text, at = field.description, place_of(path)
    if at is not None and at.dimension is not None:
        unit, separator, rest = re.split(r"([,;] |$)", text, maxsplit=1)
        if unit == at.dimension.unit and not re.search("[1-9]", rest):  # the description has a default in SI
            text = f"{units.unit(at.dimension)}{separator}{rest}".removeprefix(separator)
    # name the list itself if the path ends with an index
    name = next(key for key in reversed(path) if isinstance(key, str))
    return f" ({name}: {text})"


@contextmanager
def naming_places(scene: SceneModel) -> Iterator[None]:
    """Prefix the message of a `SceneError` with the place of its key, if the scene was read from a text."""
    try:
        yield
    except SceneError as error:
        if scene.places is None or not error.key:
            raise
        raise SceneError(f"{scene.places.of(error.key)}{error}") from None


def meant_by(error: str, before: str, after: str) -> str:
    """Return a remedy for a text that is not TOML; empty if none is known.

    Parameters are the message of the parser, and the text before and after the mistake in its line.
    """
    twice = re.match(r"Cannot declare \('(\w+)',\) twice", error)
    section = SceneModel.model_fields.get(twice[1]) if twice else None
    if twice and section and members_of_list(section.annotation):
        return f"write each of several sections as [[{twice[1]}]]"
    if twice:
        return f"merge the two sections [{twice[1]}]"
    if error.startswith("Cannot overwrite a value"):
        return "a key is given twice"
    ends_with_digit = re.search(r"[=\[,{\s][-+]?\d[\d_.eE+-]*\s*$", before) is not None
    if ends_with_digit and re.match(r",\d", after):
        return "write a decimal point, not a comma"
    if ends_with_digit and re.match(r"\.(?!\d)", after):
        return "write a digit after the point, such as 1.0"
    if ends_with_digit and re.match(r"\s*[A-Za-zµ°]", after):
        return 'write a quantity in quotes, as in "3 km"'
    if re.match(r"[-+]?\.\d", after):
        return "write a digit before the point, such as 0.5"
    if boolean := re.match(r"(?i:true|false)\b", after):
        return f"write {boolean[0].lower()}, without a capital"
    word = re.match(r"[A-Za-z][\w-]*", after) if re.search(r"[=\[,]\s*$", before) else None
    return f'write text in quotes, as in "{word[0]}"' if word else ""
