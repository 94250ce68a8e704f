"""Suggestions for keys that a scene does not have."""

from __future__ import annotations

import difflib
import types
import typing
from typing import Any

from pydantic import BaseModel

from carom.scene.lines import KeyPath
from carom.scene.schema import Coefficients, Scene

LONGEST = 80  # characters of a key that are compared
MOST = 4  # places that are named
ALIKE, ALIKE_ELSEWHERE = 0.75, 0.8  # similarity that is enough in the same section, and in others
SHORTEST = 3  # characters of an abbreviated key
OTHER_WORDS = {
    "sphere": "body",
    "spheres": "body",
    "ball": "body",
    "balls": "body",
    "particle": "body",
    "particles": "group",
    "wall": "plane",
    "walls": "domain.boundary",
    "floor": "plane",
    "ground": "plane",
    "dt": "time.fixed_dt",
    "timestep": "time.fixed_dt",
    "bounce": "contact.restitution",
    "elasticity": "contact.restitution",
    "friction": "contact.static_friction",
    "diameter": "radius",
    "omega": "angular_velocity",
}


def hint(path: KeyPath) -> str:
    """Name the keys most similar to an unknown key, or all keys of its section; begins with a semicolon."""
    model = _model_of(path[:-1])
    if model is None:
        return ""
    key, here = str(path[-1])[:LONGEST], list(model.model_fields)
    if path[0] in ("body", "group") and key in Coefficients._fields:
        return f"; give it to a [[material]] that the {path[0]} names, or to all by contact.{key}"
    if near := _near(key, here, ALIKE):
        return _meant([near])
    places, other = _places(Scene), OTHER_WORDS.get(key)
    if key in places and other not in here:
        return _meant(places[key])
    if other is not None and ("." in other or other in here or len(path) == 1):
        return _meant([other])
    if near := _near(key, list(places), ALIKE_ELSEWHERE):
        return _meant(places[near])
    return f"; known here: {', '.join(here)}"


def _near(key: str, known: list[str], alike: float) -> str | None:
    """Find the most similar known key, or the only known key that begins with this one."""
    found = difflib.get_close_matches(key, known, n=1, cutoff=alike)
    longer = [name for name in known if len(key) >= SHORTEST and name.startswith(key)]
    return found[0] if found else longer[0] if len(longer) == 1 else None


def _meant(keys: list[str]) -> str:
    *others, last = (f'"{key}"' for key in keys[:MOST])
    return f"; did you mean {', '.join(others)}{' or ' if others else ''}{last}?"


def _places(model: type[BaseModel], above: str = "") -> dict[str, list[str]]:
    """Return the dotted paths of all keys of a model and of nested models, by key; 0 stands for any index."""
    places: dict[str, list[str]] = {}
    for key, field in model.model_fields.items():
        places.setdefault(key, []).append(f"{above}{key}")
        inner = model_in(field.annotation)
        if inner is not None:
            several = "0." if typing.get_origin(field.annotation) is tuple else ""
            for below, paths in _places(inner, f"{above}{key}.{several}").items():
                places.setdefault(below, []).extend(paths)
    return places


def _model_of(path: KeyPath) -> type[BaseModel] | None:
    """Return the model of a section, by its path."""
    model: type[BaseModel] | None = Scene
    for key in path:
        if model is not None and isinstance(key, str):
            field = model.model_fields.get(key)
            model = None if field is None else model_in(field.annotation)
    return model


def model_in(annotation: Any) -> type[BaseModel] | None:
    """Find the model inside an annotation such as ``tuple[Body, ...]`` or ``Region | None``."""
    if isinstance(annotation, type) and not isinstance(annotation, types.GenericAlias):
        return annotation if issubclass(annotation, BaseModel) else None
    found = (model_in(member) for member in typing.get_args(annotation))
    return next((model for model in found if model is not None), None)
