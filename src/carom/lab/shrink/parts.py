"""Drops parts of the model in the order of requirements, then every key whose default does as well."""

from __future__ import annotations

from collections.abc import Iterator

from carom.errors import SceneError
from carom.lab.shrink.literal import BODIES, Document, Path, value_at, with_value
from carom.lab.shrink.smallest import Smallest
from carom.plan.features import require
from carom.scene.load import scene_from_dict

_KEPT = {("title",), ("time", "duration")}  # keys that a scene has in any case
_KEPT_OF_BODIES = {"name", "position"}
_LISTS = ("plane", "pair", "material")  # lists of tables besides the bodies


def drop_parts(smallest: Smallest) -> bool:
    """Drop whole parts of the model; tell whether any was."""
    changed = False
    for candidate in _without_parts(smallest):
        changed |= _is_simpler(candidate, smallest) and smallest.takes_as_short(candidate)
    return changed


def set_defaults(smallest: Smallest) -> bool:
    """Leave out sections and keys whose defaults add no part of the model; tell whether any was."""
    changed = False
    for candidate in _with_defaults(smallest):
        changed |= _adds_nothing(candidate, smallest) and smallest.takes_as_short(candidate)
    return changed


def _adds_nothing(candidate: Document, smallest: Smallest) -> bool:
    """Tell whether a candidate models no part that the smallest scene does not."""
    try:
        return _modelled(candidate) <= _modelled(smallest.document)
    except SceneError:
        return False


def _is_simpler(candidate: Document, smallest: Smallest) -> bool:
    """Tell whether a candidate models fewer parts than the smallest scene, or as few with fewer keys."""
    try:
        before, after = _modelled(smallest.document), _modelled(candidate)
    except SceneError:
        return False
    return after < before or (after == before and _keys(candidate) < _keys(smallest.document))


def _keys(node: object) -> int:
    """Count the keys of a document, at all levels."""
    if isinstance(node, dict):
        return len(node) + sum(map(_keys, node.values()))
    return sum(map(_keys, node)) if isinstance(node, list) else 0


def _modelled(document: Document) -> set[str]:
    return {part.name for part in require(scene_from_dict(document)).parts if part.modelled}


def _without_parts(smallest: Smallest) -> Iterator[Document]:
    """Yield the smallest scene of the moment without one part after the other."""
    yield _changed(smallest, {("time", "accuracy"): None})
    yield _of_all_bodies(smallest, "angular_velocity")
    yield _of_all_bodies(smallest, "fixed")
    yield smallest.document | {"contact": {"enabled": False}}
    yield _changed(smallest, {("contact", "stabilisation"): "none"})
    yield smallest.document | {"gravity": {"constant": 0.0}}
    yield _changed(smallest, {("gravity", "constant"): 0.0})
    yield _changed(smallest, {("gravity", "uniform"): None})
    yield _changed(smallest, {("drag",): None})
    yield _changed(smallest, {("domain",): None})
    yield _changed(smallest, {("plane",): None})
    for key in _LISTS:
        for place in reversed(range(len(smallest.document.get(key, [])))):
            tables = smallest.document[key]
            yield _changed(smallest, {(key,): tables[:place] + tables[place + 1 :]})
    yield _changed(smallest, {("contact", "restitution"): 0.0})
    yield _changed(smallest, {("contact", "static_friction"): 0.0, ("contact", "kinetic_friction"): None})


def _with_defaults(smallest: Smallest) -> Iterator[Document]:
    """Yield the smallest scene of the moment without one section or key after the other."""
    for section in [key for key in smallest.document if key not in (BODIES, "time", *_LISTS)]:
        if (section,) not in _KEPT:
            yield _changed(smallest, {(section,): None})
    for section in list(smallest.document):
        if isinstance(smallest.document[section], dict):
            for key in list(smallest.document[section]):
                if (section, key) not in _KEPT:
                    yield _changed(smallest, {(section, key): None})
    for section in _LISTS:
        for place in range(len(smallest.document.get(section, []))):
            for key in list(smallest.document[section][place]):
                yield _changed(smallest, {(section, place, key): None})
    keys = dict.fromkeys(key for body in smallest.document[BODIES] for key in body if key not in _KEPT_OF_BODIES)
    for key in keys:
        yield _of_all_bodies(smallest, key)
        for body in range(smallest.bodies):
            if key in smallest.document[BODIES][body]:
                yield _changed(smallest, {(BODIES, body, key): None})


def _changed(smallest: Smallest, values: dict[Path, object]) -> Document:
    """Return the document with other values; a section that becomes empty is left out."""
    document = smallest.document
    for path, value in values.items():
        if value is not None or value_at(document, path) is not None:
            document = with_value(document, path, value)
    return {key: value for key, value in document.items() if value not in ({}, [])}


def _of_all_bodies(smallest: Smallest, key: str) -> Document:
    bodies = [{name: value for name, value in body.items() if name != key} for body in smallest.document[BODIES]]
    return smallest.document | {BODIES: bodies}
