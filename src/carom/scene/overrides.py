"""Overrides of keys, as in ``--set key=value``, and keys that were renamed."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from typing import Any

import tomlkit

from carom.errors import SceneError
from carom.scene.explanation import hint
from carom.scene.scene_file import DEEPEST, KeyPath, KeyPlaces, parse_value
from carom.scene.scene_model import SceneModel
from carom.scene.schema import Time
from carom.scene.schema.promise import ABOUT_THE_END
from carom.scene.wall_shapes import CONTENT

TEXTS = ("title", "description", "name")  # keys that may be empty; for other keys, an empty value removes the key
_INDEX = re.compile(r"[0-9]{1,9}")
RENAMED = {("record", "log_freq"): ("record", "check_every")}  # section and old key → section and new key


class OldNameWarning(FutureWarning):
    """A scene uses the old name of a key."""


def old_names(
    text: str, parsed: Callable[[], Mapping[str, Any]], places: KeyPlaces, overrides: Sequence[str]
) -> Iterator[str]:
    """Yield a sentence for each old name in the text of a scene and in overrides."""
    for old, new in RENAMED.items():
        advice = f"{'.'.join(old)} is now called {'.'.join(new)}; the old name still works"
        if old[-1] in text and old[-1] in parsed().get(old[0], {}):
            yield f"{places.of(old)}{advice}"
        yield from (f"the override {override}: {advice}" for override in overrides if _key_path(override) == old)


def apply_overrides(document: Any, before: dict[str, Any], overrides: Sequence[str]) -> dict[KeyPath, str]:
    """Set keys of a document, keeping its comments, given the data ``before``; return the overrides by their keys.

    Raises SceneError if an override is not a key and a value, or if two overrides set a key by its old and its new
    name.
    """
    overridden: dict[KeyPath, str] = {}
    for override in overrides:
        path = apply_override(document, override)
        if (other := _other_name(path)) in overridden:
            both = f"the overrides {overridden[other]} and {override}"
            raise SceneError(f"{both} are two names of one key; give one of them")
        overridden[path] = override
        _forget_file(document, path)
    _keep_promised_duration(document, before, overridden)
    return overridden


def _other_name(path: KeyPath) -> KeyPath | None:
    """Return the new name of an old key, or the old name of a new key; None for any other key."""
    pairs: list[tuple[KeyPath, KeyPath]] = [*RENAMED.items()]
    return next((other for old, new in pairs for one, other in ((old, new), (new, old)) if one == path), None)


def apply_override(document: Any, override: str) -> KeyPath:
    """Set one key of a document, keeping its comments; return its path."""
    dotted, separator, text = override.partition("=")
    keys = _key_path(override)
    if not separator or not all(key != "" for key in keys):
        raise SceneError(f"the override {override}: expected key=value, such as contact.restitution=0.8")
    if len(keys) > DEEPEST:
        raise SceneError(f"the override {override[:80]} …: a key of more than {DEEPEST} parts")
    node: Any = document
    for depth, key in enumerate(keys[:-1]):
        try:
            if isinstance(key, str) and key not in node:
                node[key] = tomlkit.table()
            node = node[key]
        except (KeyError, IndexError, TypeError):
            where = ".".join(map(str, keys[: depth + 1]))
            unknown = hint(keys[:1]) if keys[0] not in SceneModel.model_fields else ""
            raise SceneError(f"the override {override}: there is no {where} in the scene{unknown}") from None
        if not isinstance(node, (dict, list)):
            where = ".".join(map(str, keys[: depth + 1]))
            raise SceneError(f"the override {override}: {where} is a value, not a section")
    try:
        if not text.strip() and keys[-1] not in TEXTS:
            node.pop(keys[-1])
        else:
            node[keys[-1]] = parse_value(text.strip())
        if other := _other_name(keys):
            node.pop(other[-1], None)
    except (KeyError, IndexError, TypeError, ValueError):
        raise SceneError(f"the override {override}: there is no {dotted.strip()} in the scene") from None
    return keys


def _key_path(override: str) -> KeyPath:
    """Return the path of the key that an override sets."""
    dotted = override.partition("=")[0].strip()
    return tuple(int(key) if _INDEX.fullmatch(key) else key for key in dotted.split("."))


def _forget_file(document: Any, path: KeyPath) -> None:
    """Remove the data of the previous file if an override names another file of bodies or of a wall."""
    if len(path) > 2 and path[0] == "bodies" and path[2] in ("file", "snapshot", "snapshot_time"):
        for key in ("count", *(("sha256",) if path[2] == "file" else ())):
            document["bodies"][path[1]].pop(key, None)
    if len(path) == 4 and path[0] == "wall" and path[3] == "file":
        document["wall"][path[1]][path[2]].pop(CONTENT, None)


def _keep_promised_duration(document: Any, before: dict[str, Any], overridden: Collection[KeyPath]) -> None:
    """If an override changes the duration, store the original duration, to which promises about the end refer."""
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
