"""From TOML to a `Scene`: files, bundled scenes, overrides, and errors that name file, line and key."""

from __future__ import annotations

import copy
import difflib
import itertools
import re
import tomllib
import warnings
from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit
import tomlkit.exceptions
from pydantic import BaseModel, ValidationError

from carom.scene.bundled import bundled_scenes, crosscheck_scenes, extreme_scenes
from carom.scene.command import command
from carom.scene.conversion import Wrong, converted, place_of
from carom.scene.data.sources import BodySource, DataFiles, Found, HeldBodies, Wanted
from carom.scene.error import SceneError
from carom.scene.hint import hint, model_in
from carom.scene.lines import KeyPath, line_of
from carom.scene.materials import material_called
from carom.scene.nesting import DEEPEST, is_too_deep, line_of_long_key
from carom.scene.renamed import RENAMED, OldNameWarning, advice, old_names, other_name
from carom.scene.schema import Scene, Time
from carom.scene.schema.expect import ABOUT_THE_END
from carom.scene.schema.section_error import SectionError
from carom.scene.toml_text import toml_text
from carom.scene.units.system import UnitSystem

LARGEST_FILE = 64_000_000  # bytes; enough for 400 000 [[body]] sections, which take half a minute to read
_LARGEST_BESIDES_BODIES = 4_000_000  # characters
_LARGEST_BODY = 1000  # characters of a [[body]] with all its keys, a long name and comments
_COMMENTED = 200_000  # characters; overrides keep the comments of shorter texts, which takes a second
MOST_MESSAGES = 8
TEXTS = ("title", "description", "name")  # keys that may be empty; no value for another key removes it
RECORDED = b"RRF2"  # first bytes of a recording
_TOO_DEEP = f"tables or lists nested more than {DEEPEST} levels deep"
_INDEX = re.compile(r"[0-9]{1,9}")


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
    path = _find(source)
    text = _read(path)
    scene = scene_from_text(text, str(path), overrides, DataFiles(path.parent))
    _warn_of_old_names(text, str(path), overrides)
    return scene


def _warn_of_old_names(text: str, source: str, overrides: list[str]) -> None:
    """Give an `OldNameWarning` for each key that has a new name, in the file and in the overrides."""
    places = _Places(source, text, {})
    if any(str(old[-1]) in text for old in RENAMED):
        for old in old_names(_parse(text, source)):
            warnings.warn(f"{places.of(old)}{advice(old)}", OldNameWarning, stacklevel=4)
    for override in overrides:
        if (key := _keys(override)) in RENAMED:
            warnings.warn(f"--set {override}: {advice(key)}", OldNameWarning, stacklevel=4)


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
        return _validate(data, text, _Places(source, text, {}), bodies)
    document: Any = tomlkit.parse(text) if len(text) <= _COMMENTED else copy.deepcopy(data)
    overridden: dict[KeyPath, str] = {}
    for override in overrides:
        path = _apply_override(document, override)
        other = other_name(path)
        if other in overridden:
            raise SceneError(f"--set {overridden[other]} and --set {override}: two names of one key; give one of them")
        overridden[path] = override
        _forget_digest(document, path)
    _keep_promised_duration(document, data, overridden)
    effective = tomlkit.dumps(document) if len(text) <= _COMMENTED else _written(document)
    return _validate(_parse(effective, source), effective, _Places(source, text, overridden), bodies)


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
        raise SceneError(f"{source}: not TOML: {error}") from None
    except RecursionError:
        raise SceneError(f"{source}: {_TOO_DEEP}") from None
    if is_too_deep(data):
        raise SceneError(f"{source}: {_TOO_DEEP}")
    return data


def scene_from_dict(data: dict[str, Any], bodies: BodySource | None = None) -> Scene:
    """Build a scene from a plain dictionary; errors name the key. ``bodies`` as for `scene_from_text`."""
    if is_too_deep(data):
        raise SceneError(f"not a scene: {_TOO_DEEP}")
    try:
        text = toml_text(data)
    except TypeError:
        data = _without_arrays(data)
        text = _written(data)
    return _validate(data, text, _Places("", "", {}), bodies)


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


class _Places:
    """The place where each key was written: a line of a file, or an override."""

    def __init__(self, file: str, text: str, overrides: dict[KeyPath, str]) -> None:
        self.file = file
        self.text = text
        self.overrides = overrides

    def of(self, path: KeyPath) -> str:
        for overridden, text in self.overrides.items():
            if path[: len(overridden)] == overridden:
                return f"--set {text}: "
        if not self.file:
            return ""
        line = line_of(self.text, path)
        return f"{self.file}:{line}: " if line else f"{self.file}: "


def _find(source: str | Path) -> Path:
    try:
        return _found(source)
    except OSError as error:  # a name of 300 characters
        raise SceneError(f"{str(source)[:100]}: cannot be read: {error.strerror}") from None


def _found(source: str | Path) -> Path:
    path = Path(source)
    if path.is_dir():
        raise SceneError(f"{path}: a folder, not a scene; give a .toml file in it")
    if path.exists():
        return path
    bundled = bundled_scenes() | extreme_scenes() | crosscheck_scenes()
    if str(source) in bundled:
        return bundled[str(source)]
    near = difflib.get_close_matches(str(source), bundled, n=1) or difflib.get_close_matches(path.stem, bundled, n=1)
    hint = f'; did you mean the bundled scene "{near[0]}"?' if near else ""
    raise SceneError(f"{source}: no such file, and no bundled scene of that name{hint} (`carom scenes` lists them)")


def _read(path: Path) -> str:
    try:
        with path.open("rb") as file:
            if file.read(4) == RECORDED:
                raise SceneError(f"{path}: a recording, not a scene; {_what_to_do_with(path)}")
        if path.stat().st_size > LARGEST_FILE:
            raise SceneError(f"{path}: {path.stat().st_size} bytes are too many for a scene; at most {LARGEST_FILE}")
        return path.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise SceneError(f"{path}: not TOML: not UTF-8 text (byte {error.start})") from None
    except OSError as error:
        raise SceneError(f"{path}: cannot be read: {error.strerror}") from None


def _what_to_do_with(recording: Path) -> str:
    done = {"view": "shows it", "inspect": "says how it went", "replay": "runs it again", "resume": "continues it"}
    return ", ".join(f"`{command(name, recording)}` {what}" for name, what in done.items())


def _apply_override(document: Any, override: str) -> KeyPath:
    """Set one key of the document, keeping its comments; return the path that was set."""
    dotted, separator, text = override.partition("=")
    keys = _keys(override)
    if not separator or not all(key != "" for key in keys):
        raise SceneError(f"--set {override}: expected key=value, such as contact.restitution=0.8")
    if len(keys) > DEEPEST:
        raise SceneError(f"--set {override[:80]} …: a key of more than {DEEPEST} parts")
    node: Any = document
    for depth, key in enumerate(keys[:-1]):
        try:
            if isinstance(key, str) and key not in node:
                node[key] = tomlkit.table()
            node = node[key]
        except (KeyError, IndexError, TypeError):
            where = ".".join(map(str, keys[: depth + 1]))
            unknown = hint(keys[:1]) if keys[0] not in Scene.model_fields else ""
            raise SceneError(f"--set {override}: there is no {where} in the scene{unknown}") from None
        if not isinstance(node, (dict, list)):
            where = ".".join(map(str, keys[: depth + 1]))
            raise SceneError(f"--set {override}: {where} is a value, not a section")
    try:
        if not text.strip() and keys[-1] not in TEXTS:
            node.pop(keys[-1])
        else:
            node[keys[-1]] = _parse_value(text.strip())
        if other := other_name(keys):
            node.pop(other[-1], None)
    except (KeyError, IndexError, TypeError, ValueError):
        raise SceneError(f"--set {override}: there is no {dotted.strip()} in the scene") from None
    return keys


def _keys(override: str) -> KeyPath:
    """Return the path of the key that an override sets."""
    dotted = override.partition("=")[0].strip()
    return tuple(int(key) if _INDEX.fullmatch(key) else key for key in dotted.split("."))


def _forget_digest(document: Any, path: KeyPath) -> None:
    """Remove what is known of the former file, if an override names another file of bodies."""
    if len(path) > 2 and path[0] == "bodies" and path[2] in ("file", "snapshot"):
        for key in ("count", *(("sha256",) if path[2] == "file" else ())):
            document["bodies"][path[1]].pop(key, None)


def _keep_promised_duration(document: Any, before: dict[str, Any], overridden: Collection[KeyPath]) -> None:
    """Store the duration that the promises about the end refer to, if an override changes the duration."""
    expect, duration = before.get("expect"), _duration(before)
    if ("expect",) in overridden or not isinstance(expect, dict) or "duration" in document["expect"]:
        return
    promises = {("expect", name) for name in ABOUT_THE_END if name in expect}
    if promises.difference(overridden) and duration is not None and duration != _duration(document):
        document["expect"]["duration"] = duration


def _duration(document: Any) -> float | str | None:
    """Return the duration as written; None if it is neither a number nor a text."""
    time = document.get("time", {})
    default = f"{Time().duration!r} s" if isinstance(document.get("units"), dict) else Time().duration
    duration = time.get("duration", default) if isinstance(time, dict) else None
    return duration if isinstance(duration, int | float | str) else None


def _parse_value(text: str) -> Any:
    """Read a TOML value; a bare word is a string."""
    try:
        return tomlkit.value(text).unwrap()
    except (tomlkit.exceptions.TOMLKitError, ValueError):
        return text


def _validate(data: dict[str, Any], text: str, places: _Places, bodies: BodySource | None) -> Scene:
    numbers, units, wrong = converted(data)
    messages = {each.path: _not_a_quantity(each, places) for each in wrong}
    try:
        scene = Scene.model_validate(numbers)
    except ValidationError as error:
        for detail in error.errors():
            path = _written_path(detail, data)
            if not _is_known(path, messages):
                messages[path] = _explain(detail, path, places, data, units)
    if messages:
        more = len(messages) - MOST_MESSAGES
        shown = itertools.islice(messages.values(), MOST_MESSAGES)
        raise SceneError("\n".join([*shown, f"… and {more} more"] if more > 0 else shown))
    if scene.bodies:
        scene, text = _with_bodies(scene, units, data, text, places, bodies or DataFiles(Path()))
    if len(text) > longest_text(scene.count):
        raise SceneError(
            f"{places.file or 'the scene'}: {len(text)} characters are too many for a scene of {scene.count} bodies; "
            f"at most {longest_text(scene.count)}"
        )
    scene._toml, scene._unit_system = text, units
    return scene


def _with_bodies(
    scene: Scene, units: UnitSystem, data: dict[str, Any], text: str, places: _Places, source: BodySource
) -> tuple[Scene, str]:
    """Find the bodies of each [[bodies]]; return the scene and its text with their counts and digests."""
    found, row = list[Found](), 0
    for index, section in enumerate(scene.bodies):
        try:
            material = material_called(scene, section.material) if section.material else None
            found.append(source.find(Wanted(section, index, len(scene.body) + row, row, units, material)))
        except SceneError as error:
            raise SceneError(f"{places.of(('bodies', index, 'file'))}bodies.{index}: {error}") from None
        row += len(found[-1].columns)
    known = [{"count": len(one.columns), "sha256": one.sha256} for one in found]
    sections = tuple(section.model_copy(update=values) for section, values in zip(scene.bodies, known, strict=True))
    if sections != scene.bodies:
        document: Any = tomlkit.parse(text) if len(text) <= _COMMENTED else copy.deepcopy(data)
        for index, values in enumerate(known):
            document["bodies"][index].update(values)
        text = tomlkit.dumps(document) if len(text) <= _COMMENTED else _written(document)
        scene = scene.model_copy(update={"bodies": sections})
    files = source.files if isinstance(source, HeldBodies) else source if isinstance(source, DataFiles) else None
    scene._held = HeldBodies(sections, tuple(found), units, files)
    return scene, text


def _is_known(path: KeyPath, messages: Collection[KeyPath]) -> bool:
    """Tell whether there is a message already about a key, or about one that contains it."""
    wrong_units = path[0:1] == ("units",) and any(other[0] == "units" for other in messages)
    return wrong_units or any(path[:depth] in messages for depth in range(1, len(path) + 1))


def _not_a_quantity(wrong: Wrong, places: _Places) -> str:
    """Return one line with the place, the key, what is wrong and what would be right."""
    key = ".".join(str(part)[:80] for part in wrong.path)
    given = "" if wrong.given is None else f" = {wrong.given[:80]!r}:"
    return f"{places.of(wrong.path)}{key}{given} {wrong.message}"


def _explain(detail: Any, path: KeyPath, places: _Places, data: Any, units: UnitSystem) -> str:
    """Return one line with the place, the key, what is wrong and what would be right."""
    place, key, given = places.of(path), ".".join(str(part)[:80] for part in path), _as_written(detail, path, data)
    if detail["type"] == "extra_forbidden":
        return f"{place}unknown key {key}{hint(path)}"
    if detail["type"] == "missing" and isinstance(detail["loc"][-1], str):
        return f"{place}{key} is missing{_expected(path, units)}"
    if detail["type"] == "value_error":
        return f"{place}{key}{': ' if key else ''}{detail['ctx']['error']}"
    shown = repr(given) if isinstance(given, str) else str(given)
    return f"{place}{key} = {shown[:80]}: {_wrong(detail)}{_expected(path, units)}"


def _is_union_member(key: str | int) -> bool:
    """Tell whether a key names a member of a union, which Pydantic adds to the path and nobody wrote."""
    return isinstance(key, str) and ("[" in key or key.startswith("constrained") or key in ("float", "nan", "literal"))


def _written_path(detail: Any, data: Any) -> KeyPath:
    """Return the path as it was written: a radius given as a number has no `min`, a vector no `2`."""
    path: KeyPath = tuple(key for key in detail["loc"] if not _is_union_member(key))
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
    """Return the value at a path before its conversion, if there was one."""
    found, given = data, detail["input"]
    if not isinstance(given, int | float):
        return given
    try:
        for key in path:
            found = found[key]
    except (KeyError, IndexError, TypeError):  # a default that follows another key
        return given
    return found if isinstance(found, str | int | float) else given


def _wrong(detail: Any) -> str:
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
        case "float_type" | "int_type" | "int_from_float" | "string_type" | "bool_type":
            kinds = {
                "float": "a number",
                "int": "a whole number",
                "string": "text in quotes",
                "bool": "true or false",
            }
            return f"must be {kinds[detail['type'].split('_')[0]]}"
        case "literal_error":
            return f"must be {context['expected']}"
        case "tuple_type" if isinstance(detail["input"], dict):
            return "must be a list of sections; write it in double brackets"
        case "too_short" | "too_long" if all(isinstance(each, str) for each in detail["input"]):
            return "must be the names of three columns"
        case "too_short" | "too_long" | "tuple_type" | "missing":
            return "must be three numbers [x, y, z]"
        case "model_type" | "model_attributes_type" | "dict_type":
            return "must be a section with keys"
        case _:
            return str(detail["msg"])


def _field(path: KeyPath) -> tuple[type[BaseModel] | None, Any]:
    """Follow a path of keys through the models; return the model of the last key, and its field."""
    model: type[BaseModel] | None = Scene
    field = None
    for key in path:
        if isinstance(key, int):
            continue
        if model is None:
            return None, None
        holder, field = model, model.model_fields.get(key)
        model = model_in(field.annotation) if field is not None else None
        if field is None:
            return holder, None
    return model, field


def _expected(path: KeyPath, units: UnitSystem) -> str:
    """Return the description of a key; its numbers are in the units of the scene."""
    _, field = _field(path)
    if field is None or not field.description:
        return ""
    text, at = field.description, place_of(path)
    if at is not None and at.dimension is not None:
        unit, separator, rest = re.split(r"([,;] |$)", text, maxsplit=1)
        if unit == at.dimension.unit and not re.search("[1-9]", rest):  # a default, which is in SI
            text = f"{units.unit(at.dimension)}{separator}{rest}".removeprefix(separator)
    return f" ({path[-1]}: {text})"
