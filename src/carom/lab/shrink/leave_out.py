"""Passes of `carom shrink` over the document: leave out bodies, parts of the model, keys and digits."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from typing import TypeVar

import numpy as np

from carom.errors import SceneError
from carom.lab.run_summary import Observation
from carom.lab.shrink.literal import BODIES, ORIGIN, Document, KeyPath, value_at, with_bodies, with_value
from carom.lab.shrink.trials import Smallest, Trials, observe
from carom.physics.schedule import every
from carom.physics.space import Space
from carom.plan.features import require
from carom.scene.load import Scene
from carom.state.frame import Frame

Met = tuple[int, int]  # numbers of two bodies that touched in a step


def leave_out_bodies(smallest: Smallest, trials: Trials) -> bool:
    """Leave out bodies; return whether any body was left out.

    First try to keep only the bodies that show the failure, and bodies that affect them through contacts or are near
    them.
    """
    base, before = smallest.document, smallest.bodies
    suspects = {number for number, body in enumerate(base[BODIES]) if body["name"] in smallest.suspects}
    if 0 < len(suspects) < before:
        touching: list[list[Met]] = []  # touching pairs in each step

        def add(seen: Observation, frame: Frame) -> bool:
            tables = [rows for rows in (frame.impacts, frame.contact_rows) if rows is not None]
            touching.append([(int(row["i"]), int(row["j"])) for table in tables for row in table])
            return True

        observe(Space(smallest.scene, threads=1, record_contacts=True), trials.budget, add, schedule=every(0.0))
        for kept in (*cones(suspects, touching, before), *_nearest(suspects, base)):
            if smallest.takes(with_bodies(base, sorted(kept))):
                break
    base = smallest.document
    fewest(range(smallest.bodies), lambda parts: smallest.takes_first([with_bodies(base, part) for part in parts]))
    return smallest.bodies < before


def _nearest(bodies: set[int], document: Document) -> Iterator[set[int]]:
    """Yield growing sets: some bodies and their nearest neighbours."""
    position = np.array([body.get("position", ORIGIN) for body in document[BODIES]])  # (n, 3) m
    distance = np.linalg.norm(position[:, None] - position[sorted(bodies)][None], axis=2).min(axis=1)
    order = np.argsort(distance, kind="stable")
    size = len(bodies) + 4
    while size < len(order) // 2:
        yield set(order[:size].tolist())
        size *= 2


def cones(bodies: set[int], steps: list[list[Met]], count: int) -> Iterator[set[int]]:
    """Yield growing sets: some bodies, then also the bodies that touched them, then their backward cone.

    ``steps`` has the touching pairs of each step. Numbers from ``count`` on are planes, and planes have no cone.
    """
    yield set(bodies)
    every_pair = [pair for step in steps for pair in step if max(pair) < count]
    once = bodies | {end for pair in every_pair if bodies & set(pair) for end in pair}
    if once != bodies:
        yield once
    cone = set(bodies)
    for step in reversed(steps):
        size = -1
        while size != len(cone):  # contacts in one step act on each other
            size = len(cone)
            cone |= {end for pair in step if max(pair) < count and cone & set(pair) for end in pair}
    if cone != once and len(cone) < count:
        yield cone


Item = TypeVar("Item")


def fewest(items: Sequence[Item], first: Callable[[list[list[Item]]], int | None]) -> list[Item]:
    """Return a subset of failing items that still fails, and from which no item can be left out.

    This is delta debugging (Zeller & Hildebrandt, IEEE TSE 28, 183, 2002). ``first`` returns the index of the first
    failing subset among several; subsets keep the order of the items.
    """
    kept, parts = list(items), 2
    while len(kept) > 1:
        count = min(parts, len(kept))
        ends = [len(kept) * k // count for k in range(count + 1)]  # ends of pieces of nearly equal lengths
        pieces = [kept[low:high] for low, high in itertools.pairwise(ends)]
        found = first(pieces) if parts == 2 else None
        if found is not None:
            kept, parts = pieces[found], 2
            continue
        rests = [[item for piece in pieces[:k] + pieces[k + 1 :] for item in piece] for k in range(len(pieces))]
        found = first(rests)
        if found is not None:
            kept, parts = rests[found], max(2, len(pieces) - 1)
        elif len(pieces) == len(kept):
            break
        else:
            parts = 2 * parts
    return kept


# Drops parts of the model in the order of their requirements, then each key if the scene still fails with its default.
_KEPT = {("title",), ("time", "duration")}  # keys that are never dropped
_KEPT_OF_BODIES = {"name", "position"}
_LISTS = ("plane", "wall", "pair", "material")  # lists of tables other than the bodies


def drop_parts(smallest: Smallest) -> bool:
    """Drop whole parts of the model; return whether any part was dropped."""
    changed = False
    for candidate in _without_parts(smallest):
        before, after = _modelled(smallest.document), _modelled(candidate)
        fewer_keys = _keys(candidate) < _keys(smallest.document)
        if before is not None and after is not None and (after < before or (after == before and fewer_keys)):
            changed |= smallest.takes_as_short(candidate)
    return changed


def set_defaults(smallest: Smallest) -> bool:
    """Leave out sections and keys whose defaults add no part of the model; return whether anything was left out."""
    changed = False
    for candidate in _with_defaults(smallest):
        before, after = _modelled(smallest.document), _modelled(candidate)
        if before is not None and after is not None and after <= before:
            changed |= smallest.takes_as_short(candidate)
    return changed


def _keys(node: object) -> int:
    """Count the keys of a document, at all levels."""
    if isinstance(node, dict):
        return len(node) + sum(map(_keys, node.values()))
    return sum(map(_keys, node)) if isinstance(node, list) else 0


def _modelled(document: Document) -> set[str] | None:
    """Return the parts of a scene's model; None if the scene is invalid."""
    try:
        return {part.name for part in require(Scene.from_dict(document)).parts if part.modelled}
    except SceneError:
        return None


def _without_parts(smallest: Smallest) -> Iterator[Document]:
    """Yield the current smallest scene without each part in turn."""
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
    yield _changed(smallest, {("wall",): None})
    for key in _LISTS:
        for place in reversed(range(len(smallest.document.get(key, [])))):
            tables = smallest.document[key]
            yield _changed(smallest, {(key,): tables[:place] + tables[place + 1 :]})
    yield _changed(smallest, {("contact", "restitution"): 0.0})
    yield _changed(smallest, {("contact", "static_friction"): 0.0, ("contact", "kinetic_friction"): None})


def _with_defaults(smallest: Smallest) -> Iterator[Document]:
    """Yield the current smallest scene without each section or key in turn."""
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


def _changed(smallest: Smallest, values: dict[KeyPath, object]) -> Document:
    """Return the document with other values, without sections that become empty."""
    document = smallest.document
    for path, value in values.items():
        if value is not None or value_at(document, path) is not None:
            document = with_value(document, path, value)
    return {key: value for key, value in document.items() if value not in ({}, [])}


def _of_all_bodies(smallest: Smallest, key: str) -> Document:
    bodies = [{name: value for name, value in body.items() if name != key} for body in smallest.document[BODIES]]
    return smallest.document | {BODIES: bodies}


# Writes every number with the fewest digits that still show the failure.
MOST_DIGITS = 17
_FIXED_FRAME = ("plane", "wall", "domain", "drag")  # sections that tie the scene to a position or a frame of reference
_NOT_ROUNDED = {"expect"}  # sections whose numbers define a failure


def round_numbers(smallest: Smallest) -> bool:
    """Shorten numbers, first all together, then one by one; return whether any number was shortened."""
    changed = _move_frame(smallest)
    for digits in range(1, MOST_DIGITS):
        document = smallest.document
        for path in list(_paths(document)):
            document = with_value(document, path, rounded(float(value_at(document, path)), digits))
        if smallest.takes_as_short(_tidy(document)):
            changed = True
            break
    for path in list(_paths(smallest.document)):
        value = value_at(smallest.document, path)
        for digits in range(digits_of(value)) if isinstance(value, float) else ():
            if smallest.takes_as_short(_tidy(with_value(smallest.document, path, rounded(value, digits)))):
                changed = True
                break
    return changed


def rounded(value: float, digits: int) -> float:
    """Round to ``digits`` significant digits; with 0 digits, return 0."""
    return float(f"{value:.{digits - 1}e}") if digits else 0.0


def digits_of(value: float) -> int:
    """Return the number of significant digits that represent a number exactly; 0 has none."""
    return 0 if value == 0.0 else next(d for d in range(1, MOST_DIGITS + 1) if rounded(value, d) == value)


def _move_frame(smallest: Smallest) -> bool:
    """Subtract the first body's position and velocity from all bodies, if only differences matter."""
    if any(key in smallest.document for key in _FIXED_FRAME):
        return False
    changed = False
    for key in ("position", "velocity"):
        bodies = smallest.document[BODIES]
        origin = bodies[0].get(key, ORIGIN)
        if any(origin) and not any(body.get("fixed") for body in bodies):
            moved = [
                body | {key: [a - b for a, b in zip(body.get(key, ORIGIN), origin, strict=True)]} for body in bodies
            ]
            changed |= smallest.takes_as_short(_tidy(smallest.document | {BODIES: moved}))
    return changed


def _tidy(document: Document) -> Document:
    """Leave out vectors of zeros, which are the defaults."""
    bodies = [{key: value for key, value in body.items() if value != ORIGIN} for body in document[BODIES]]
    return document | {BODIES: bodies}


def _paths(node: object, above: KeyPath = ()) -> Iterator[KeyPath]:
    """Yield the paths of all floating-point numbers; integers are counts."""
    if isinstance(node, dict):
        for key, value in node.items():
            yield from _paths(value, (*above, key)) if key not in _NOT_ROUNDED else ()
    elif isinstance(node, list):
        for k, value in enumerate(node):
            yield from _paths(value, (*above, k))
    elif isinstance(node, float):
        yield above
