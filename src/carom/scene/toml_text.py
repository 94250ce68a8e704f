"""TOML text of a scene: writes documents and values, and reads single values."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import tomlkit
import tomlkit.exceptions

if TYPE_CHECKING:
    from carom.scene.schema import Scene


_BARE_KEY = re.compile(r"[A-Za-z0-9_-]+")


def toml_text(data: Mapping[str, Any]) -> str:
    """Write a document: plain keys first, then a section for each table and each table of a list.

    It takes ten microseconds per body; tomlkit, which keeps comments, takes a millisecond.

    Raises
    ------
    TypeError
        If a value has a type that scenes do not have.
    """

    def is_section(value: Any) -> bool:
        is_list = isinstance(value, list | tuple) and len(value) > 0
        return isinstance(value, Mapping) or (is_list and all(isinstance(item, Mapping) for item in value))

    lines = [f"{_key(key)} = {value_text(value)}" for key, value in data.items() if not is_section(value)]
    for key, value in data.items():
        if is_section(value):
            header = f"[{_key(key)}]" if isinstance(value, Mapping) else f"[[{_key(key)}]]"
            for table in [value] if isinstance(value, Mapping) else value:
                lines += ["", header, *(f"{_key(name)} = {value_text(inner)}" for name, inner in table.items())]
    return "\n".join(lines) + "\n"


def _key(key: Any) -> str:
    if not isinstance(key, str):
        raise TypeError(f"{key!r}: a key must be text")
    return key if _BARE_KEY.fullmatch(key) else _string(key)


def value_text(value: Any) -> str:
    """Write one value; raises TypeError like `toml_text`."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return _string(value)
    if isinstance(value, int):
        return int.__repr__(value)
    if isinstance(value, float):
        return float.__repr__(value)  # also for subclasses, such as NumPy's
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{_key(key)} = {value_text(inner)}" for key, inner in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(value_text, value)) + "]"
    raise TypeError(f"a scene has no values of type {type(value).__name__}")


def _string(text: str) -> str:
    """Quote text: TOML escapes the same characters as JSON, and DEL."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


_NUMBER = re.compile(r"[+-]?(\.[0-9]+|[0-9]+\.)([eE][+-]?[0-9]+)?")  # a number as people write it, but not valid TOML


def parse_value(text: str) -> Any:
    """Read a TOML value; a bare word is a string."""
    try:
        return tomlkit.value(text).unwrap()
    except (tomlkit.exceptions.TOMLKitError, ValueError):
        return float(text) if _NUMBER.fullmatch(text) else text


def toml_for(scene: Scene, folder: Path) -> str:
    """Return the text of a scene with names of data files relative to a folder."""
    files = None if scene.held is None else scene.held.files
    if files is None or files.folder.resolve() == folder.resolve():
        return scene.toml
    document = tomlkit.parse(scene.toml)
    for section, table in zip(scene.bodies, document["bodies"], strict=True):
        if section.file is not None and not Path(section.file).is_absolute():
            table["file"] = Path(os.path.relpath(files.folder / section.file, folder)).as_posix()
    return tomlkit.dumps(document)
