"""Values as TOML text, in ten microseconds a body; tomlkit, which keeps comments, takes a millisecond."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from typing import Any

_BARE_KEY = re.compile(r"[A-Za-z0-9_-]+")


def toml_text(data: Mapping[str, Any]) -> str:
    """Write a document: plain keys first, then a section for each table and each table of a list.

    Raises
    ------
    TypeError
        If a value has a type that scenes do not have.
    """
    return "\n".join(_lines(data)) + "\n"


def _lines(data: Mapping[str, Any]) -> Iterator[str]:
    sections = {key: value for key, value in data.items() if isinstance(value, Mapping) or _is_tables(value)}
    yield from (f"{_key(key)} = {value_text(value)}" for key, value in data.items() if key not in sections)
    for key, value in sections.items():
        header = f"[{_key(key)}]" if isinstance(value, Mapping) else f"[[{_key(key)}]]"
        for table in [value] if isinstance(value, Mapping) else value:
            yield from ("", header)
            yield from (f"{_key(name)} = {value_text(inner)}" for name, inner in table.items())


def _is_tables(value: Any) -> bool:
    return isinstance(value, list | tuple) and len(value) > 0 and all(isinstance(item, Mapping) for item in value)


def _key(key: Any) -> str:
    if not isinstance(key, str):
        raise TypeError(f"{key!r}: a key must be text")
    return key if _BARE_KEY.fullmatch(key) else _string(key)


def value_text(value: Any) -> str:
    """Write one value; raises TypeError as `toml_text`."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return _string(value)
    if isinstance(value, int):
        return int.__repr__(value)
    if isinstance(value, float):
        return float.__repr__(value)  # of subclasses, such as NumPy's, too
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{_key(key)} = {value_text(inner)}" for key, inner in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(value_text, value)) + "]"
    raise TypeError(f"a scene has no values of type {type(value).__name__}")


def _string(text: str) -> str:
    """Quote text: TOML escapes the same characters as JSON, and DEL."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
