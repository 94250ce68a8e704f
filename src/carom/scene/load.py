"""From TOML to a `Scene`, with errors that name file, line and key."""

from __future__ import annotations

import copy
import math
import re
import tomllib
import warnings
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit
from pydantic import ValidationError

from carom.errors import SceneError
from carom.scene.conversion import converted, members_of_list
from carom.scene.data.body_sources import BodySource, DataFiles, HeldBodies, SourcedBodies, Wanted
from carom.scene.explanation import explain, is_known, not_a_quantity, with_words, written_path
from carom.scene.key_places import DEEPEST, KeyPath, KeyPlaces, is_too_deep, line_of_long_key
from carom.scene.matter import material_called
from carom.scene.overrides import (
    RENAMED,
    OldNameWarning,
    advice,
    apply_override,
    forget_digest,
    keep_promised_duration,
    key_path,
    old_names,
    other_name,
)
from carom.scene.scene_file import LARGEST_FILE, read_text, scene_path
from carom.scene.schema import Scene
from carom.scene.toml_text import toml_text
from carom.scene.units.dimension import GRAVITATIONAL_CONSTANT, LENGTH
from carom.scene.units.system import UnitSystem

_LARGEST_BESIDES_BODIES = 4_000_000  # characters
_LARGEST_BODY = 1000  # characters of a [[body]] with all its keys, a long name and comments
_COMMENTED = 200_000  # characters; overrides keep the comments of shorter texts, which takes a second
MOST_MESSAGES = 8
_MOST_DETAILS = 1000  # faults that are examined; a hostile text may have a million
_LAW = {"constant": GRAVITATIONAL_CONSTANT, "softening": LENGTH}  # keys of [gravity] that files may have
_SAME_LAW = 1e-9  # relative difference of numbers that are written with fewer digits
_TOO_DEEP = f"tables or lists nested more than {DEEPEST} levels deep"


def load_scene(source: str | Path, overrides: list[str]) -> Scene:
    """Load a scene.

    Parameters
    ----------
    source
        A path to a TOML file, or the name of a bundled scene.
    overrides
        ``key=value`` strings as given to ``--set``, e.g. ``gravity.method=direct`` or ``body.0.radius=2``.

    Raises
    ------
    SceneError
        Naming file, line and key.
    """
    path = scene_path(source)
    text = read_text(path)
    scene = scene_from_text(text, str(path), overrides, DataFiles(path.parent))
    _warn_of_old_names(text, str(path), overrides)
    return scene


def _warn_of_old_names(text: str, source: str, overrides: list[str]) -> None:
    """Give an `OldNameWarning` for each key that has a new name, in the file and in the overrides."""
    places = KeyPlaces(source, text, {})
    if any(str(old[-1]) in text for old in RENAMED):
        for old in old_names(_parse(text, source)):
            warnings.warn(f"{places.of(old)}{advice(old)}", OldNameWarning, stacklevel=4)
    for override in overrides:
        if (key := key_path(override)) in RENAMED:
            warnings.warn(f"the override {override}: {advice(key)}", OldNameWarning, stacklevel=4)


def scene_from_text(
    text: str, source: str, overrides: list[str] | None = None, bodies: BodySource | None = None
) -> Scene:
    """Build a scene from TOML text, such as that in a recording.

    Parameters
    ----------
    text
        At most as long as `longest_text` allows. Overrides drop the comments of a long text.
    source
        Its name in messages.
    overrides
        As for `load_scene`.
    bodies
        Where the bodies of [[bodies]] are; by default in files of the current folder.

    Raises
    ------
    SceneError
        Naming the source, the line and the key.
    """
    if len(text) > LARGEST_FILE:
        raise SceneError(f"{source}: {len(text)} characters are too many for a scene; at most {LARGEST_FILE}")
    data = _parse(text, source)
    if not overrides:
        return _validate(data, text, KeyPlaces(source, text, {}), bodies)
    document: Any = tomlkit.parse(text) if len(text) <= _COMMENTED else copy.deepcopy(data)
    overridden: dict[KeyPath, str] = {}
    for override in overrides:
        path = apply_override(document, override)
        other = other_name(path)
        if other in overridden:
            both = f"the overrides {overridden[other]} and {override}"
            raise SceneError(f"{both}: two names of one key; give one of them")
        overridden[path] = override
        forget_digest(document, path)
    keep_promised_duration(document, data, overridden)
    effective = tomlkit.dumps(document) if len(text) <= _COMMENTED else _written(document)
    return _validate(_parse(effective, source), effective, KeyPlaces(source, text, overridden), bodies)


def longest_text(bodies: int) -> int:
    """Return the largest number of characters in a scene, so that every scene that runs can be read back."""
    return min(LARGEST_FILE, _LARGEST_BESIDES_BODIES + _LARGEST_BODY * bodies)


def _parse(text: str, source: str) -> dict[str, Any]:
    """Read TOML, at most `DEEPEST` levels of it."""
    line = line_of_long_key(text)
    if line is not None:
        raise SceneError(f"{source}:{line}: a key of more than {DEEPEST} parts")
    try:
        data = tomllib.loads(text)
    except ValueError as error:  # not only TOMLDecodeError: Python refuses whole numbers of thousands of digits
        digits = re.search(r"\d{4301}", text) if "digits" in str(error) else None
        if digits:
            line = text.count("\n", 0, digits.start()) + 1
            raise SceneError(f"{source}:{line}: not TOML: a whole number of more than 4300 digits") from None
        at = re.search(r"\(at line (\d+), column (\d+)\)$", str(error))
        place = f"{source}:{at[1]}" if at else source
        comma = at is not None and _is_decimal_comma(text, int(at[1]), int(at[2]))
        meant = "; write a decimal point, not a comma" if comma else _meant(str(error))
        raise SceneError(f"{place}: not TOML: {error}{meant}") from None
    except RecursionError:
        raise SceneError(f"{source}: {_TOO_DEEP}") from None
    if is_too_deep(data):
        raise SceneError(f"{source}: {_TOO_DEEP}")
    return data


def _is_decimal_comma(text: str, line: int, column: int) -> bool:
    """Tell whether a comma between two digits is at a place of a text; lines and columns count from 1."""
    return bool(re.fullmatch(r"\d,\d", text.split("\n")[line - 1][column - 2 : column + 1]))


def _meant(error: str) -> str:
    """Say what was probably meant, by the message of the parser."""
    twice = re.match(r"Cannot declare \('(\w+)',\) twice", error)
    if twice and members_of_list(Scene.model_fields[twice[1]].annotation if twice[1] in Scene.model_fields else None):
        return f"; write each of several sections as [[{twice[1]}]]"
    if twice:
        return f"; merge the two sections [{twice[1]}]"
    return "; a key is given twice" if error.startswith("Cannot overwrite a value") else ""


def scene_from_dict(data: dict[str, Any], bodies: BodySource | None = None) -> Scene:
    """Build a scene from a plain dictionary; errors name the key. ``bodies`` as for `scene_from_text`."""
    if is_too_deep(data):
        raise SceneError(f"not a scene: {_TOO_DEEP}")
    try:
        text = toml_text(data)
    except TypeError:
        data = _without_arrays(data)
        text = _written(data)
    try:
        text.encode()
    except UnicodeEncodeError as error:
        raise SceneError(
            f"a text has {text[error.start]!a}, which is half of a character: no file can hold it"
        ) from None
    return _validate(data, text, KeyPlaces("", "", {}), bodies)


def _without_arrays(value: Any) -> Any:
    """Return a value with lists and numbers in place of NumPy's arrays and numbers."""
    if isinstance(value, dict):
        return {key: _without_arrays(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_without_arrays(inner) for inner in value]
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else value


def _written(data: dict[str, Any]) -> str:
    try:
        return toml_text(data)
    except TypeError as error:
        raise SceneError(f"not a scene: {error}") from None


def _validate(data: dict[str, Any], text: str, places: KeyPlaces, bodies: BodySource | None) -> Scene:
    numbers, units, wrong = converted(data)
    more = max(0, len(wrong) - _MOST_DETAILS)
    messages: dict[KeyPath, Callable[[], str]] = {
        each.path: partial(not_a_quantity, each, places) for each in wrong[:_MOST_DETAILS]
    }
    try:
        scene = Scene.model_validate(numbers)
    except ValidationError as error:
        details = error.errors(include_url=False)
        more += max(0, len(details) - _MOST_DETAILS)
        for detail in with_words(details[:_MOST_DETAILS]):
            path = written_path(detail, data)
            if not is_known(path, messages):
                messages[path] = partial(explain, detail, path, places, data, units)
    _refuse(list(messages.values()), more)
    if scene.bodies:
        scene, text = _with_bodies(scene, units, data, text, places, bodies or DataFiles(Path()))
    if len(text) > longest_text(scene.count):
        raise SceneError(
            f"{places.file or 'the scene'}: {len(text)} characters are too many for a scene of {scene.count} bodies; "
            f"at most {longest_text(scene.count)}"
        )
    scene._toml, scene._unit_system, scene._places = text, units, places
    return scene


def _refuse(messages: Sequence[Callable[[], str]], more: int = 0) -> None:
    """Refuse a scene with all that is wrong with it, one line each; those that are not shown are not worked out.

    ``more`` is the number of faults without a message.
    """
    if messages:
        more += len(messages) - MOST_MESSAGES
        shown = [message() for message in messages[:MOST_MESSAGES]]
        raise SceneError("\n".join([*shown, f"… and {more} more"] if more > 0 else shown))


def _with_bodies(
    scene: Scene, units: UnitSystem, data: dict[str, Any], text: str, places: KeyPlaces, source: BodySource
) -> tuple[Scene, str]:
    """Find the bodies of each [[bodies]]; return the scene and its text with their counts and digests."""
    found, row, wrong = list[SourcedBodies](), 0, list[Callable[[], str]]()
    for index, section in enumerate(scene.bodies):
        try:
            material = material_called(scene, section.material) if section.material else None
            found.append(source.find(Wanted(section, index, len(scene.body) + row, row, units, material)))
            row += len(found[-1].columns)
        except SceneError as error:
            wrong.append(partial(str, f"{places.of(('bodies', index, 'file'))}bodies.{index}: {error}"))
            row += section.count or 0
    _refuse(wrong)
    taken = _take_over_laws(scene, units, data, places, found)
    known = [{"count": len(one.columns), "sha256": one.sha256} for one in found]
    sections = tuple(section.model_copy(update=values) for section, values in zip(scene.bodies, known, strict=True))
    if sections != scene.bodies or taken:
        document: Any = tomlkit.parse(text) if len(text) <= _COMMENTED else copy.deepcopy(data)
        for index, values in enumerate(known):
            document["bodies"][index].update(values)
        for key, number in taken.items():
            apply_override(document, f"gravity.{key}={number!r}")
        text = tomlkit.dumps(document) if len(text) <= _COMMENTED else _written(document)
        numbers = {key: units.converted(number, _LAW[key]) for key, number in taken.items()}
        gravity = scene.gravity.model_copy(update=numbers)
        scene = scene.model_copy(update={"bodies": sections, "gravity": gravity})
    files = source.files if isinstance(source, HeldBodies) else source if isinstance(source, DataFiles) else None
    scene._held = HeldBodies(sections, tuple(found), units, files)
    return scene, text


def _take_over_laws(
    scene: Scene, units: UnitSystem, data: dict[str, Any], places: KeyPlaces, found: list[SourcedBodies]
) -> dict[str, float]:
    """Compare what moves the bodies in their files with the scene; add notes to what was found.

    Returns
    -------
    taken
        Plain numbers for those keys of [gravity] that the scene leaves out and a file has.

    Raises
    ------
    SceneError
        If the scene contradicts a file, or two files contradict each other.
    """
    given: Any = data.get("gravity", {})
    is_off = scene.gravity.method == "none" or ("constant" in given and scene.gravity.constant == 0.0)
    taken, wrong = dict[str, float](), list[Callable[[], str]]()
    for index, one in enumerate(found):
        law, notes, refuted = one.law, list[str](), ""
        if law is None:
            continue
        if is_off and law.constant > 0.0:
            notes.append(f"G = {law.constant:g} is not used, because the scene has no gravity between bodies")
        for key, dimension in () if is_off else _LAW.items():
            number = float(getattr(law, key))
            if key not in given and key not in taken and (number > 0.0 or key == "constant"):
                taken[key] = number
            own = taken.get(key, units.shown(getattr(scene.gravity, key), dimension))
            if taken.get(key) == number:
                notes.append(f"gravity.{key} = {number:g} is taken from it")
            elif number == 0.0 and key == "softening" and own > 0.0:
                notes.append(f"it has no softening, and the scene has {own:g}")
            elif not math.isclose(own, number, rel_tol=_SAME_LAW):
                refuted = f"gravity.{key} is {number!r} in it, and {own!r} here; leave gravity.{key} out, or set that"
        if law.periodic and scene.domain.boundary != "periodic":
            refuted = 'its box is periodic; set domain.boundary = "periodic" and domain.size'
        if not law.collides and scene.contact.enabled:
            notes.append("its bodies pass through each other; contact.enabled = false does the same here")
        called = scene.bodies[index].called
        found[index] = one._replace(notes=(*one.notes, *(f"{called}: {note}" for note in notes)))
        if refuted:
            place = f"{places.of(('bodies', index, 'file'))}bodies.{index}: {called}: "
            wrong.append(partial(str, place + refuted))
    _refuse(wrong)
    return taken
