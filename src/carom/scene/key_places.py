"""Places of keys in the text of a scene, for messages, and the limit on their nesting.

No known TOML library keeps the line of a key, so this module scans the text again, line by line. For keys in other
forms, such as multi-line inline tables, it returns the line of their section.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from functools import cached_property
from typing import TYPE_CHECKING, Any

from carom.errors import SceneError

if TYPE_CHECKING:
    from carom.scene.schema import Scene


KeyPath = tuple[str | int, ...]

_HEADER = re.compile(r"^\s*(\[\[?)\s*([^\[\]]+?)\s*\]\]?\s*(#.*)?$")
_KEY = re.compile(r"""^\s*((?:[\w-]+|"[^"]*"|'[^']*')(?:\s*\.\s*(?:[\w-]+|"[^"]*"|'[^']*'))*)\s*=""")


def lines_of(text: str) -> dict[KeyPath, int]:
    """Return the 1-based line of the first occurrence of each key and each section."""
    lines: dict[KeyPath, int] = {}
    section: KeyPath = ()
    seen: Counter[KeyPath] = Counter()
    for number, line in enumerate(text.splitlines(), start=1):
        header, key = _HEADER.match(line), _KEY.match(line)
        if header:
            *above, last = _split(header[2])
            section = (*_indexed(above, seen), last)
            if header[1] == "[[":
                seen[section] += 1
                lines.setdefault(section, number)  # a section written as a list of sections
            section = written = _indexed([*above, last], seen)
        elif key:
            written = (*section, *_split(key[1]))
        else:
            continue
        lines.setdefault(written, number)
    return lines


def _indexed(keys: Iterable[str | int], seen: Counter[KeyPath]) -> KeyPath:
    """Insert the index of the latest section after each key of a list of sections, such as ``[[group]]``."""
    path: KeyPath = ()
    for key in keys:
        path = (*path, key)
        if seen[path]:
            path = (*path, seen[path] - 1)
    return path


def _split(dotted: str) -> KeyPath:
    return tuple(part.strip().strip("\"'") for part in dotted.split("."))


class KeyPlaces:
    """The place of each key: a line of a file, or an override."""

    def __init__(self, file: str, text: str, overrides: dict[KeyPath, str]) -> None:
        self.file = file
        self.text = text
        self.overrides = overrides

    def __eq__(self, other: object) -> bool:
        """Compare equal to any other `KeyPlaces`: places do not affect the equality of scenes."""
        return isinstance(other, KeyPlaces)

    __hash__ = None  # type: ignore[assignment]

    @cached_property
    def _lines(self) -> dict[KeyPath, int]:
        return lines_of(self.text)

    def of(self, path: KeyPath) -> str:
        """Return the place of a key, as the first words of a message; empty if unknown."""
        for overridden, text in self.overrides.items():
            if path[: len(overridden)] == overridden:
                return f"the override {text}: "
        line = next((self._lines[path[:n]] for n in range(len(path), 0, -1) if path[:n] in self._lines), None)
        if not line:  # a section created by an override
            for overridden, text in self.overrides.items():
                if path and overridden[: len(path)] == path:
                    return f"the override {text}: "
        if not self.file:
            return ""
        return f"{self.file}:{line}: " if line else f"{self.file}: "


@contextmanager
def naming_places(scene: Scene) -> Iterator[None]:
    """Prefix the message of a `SceneError` with the place of its key, if the scene was read from a text."""
    try:
        yield
    except SceneError as error:
        if scene.places is None or not error.key:
            raise
        raise SceneError(f"{scene.places.of(error.key)}{error}") from None


# Limit on the nesting: parsing, validation and messages are recursive, or take time quadratic in the depth.
DEEPEST = 32  # levels; the deepest key in a scene is group.0.radius.min

_PART = r"""(?:[\w-]++|"(?:[^"\\\n]|\\.)*+"|'[^'\n]*+')"""
_LONG_KEY = re.compile(rf"(?:^[ \t]*+\[{{0,2}}|[{{,])[ \t]*+(?:{_PART}[ \t]*+\.[ \t]*+){{{DEEPEST}}}", re.MULTILINE)


def line_of_long_key(text: str) -> int | None:
    """Return the 1-based line of a dotted key of more than `DEEPEST` parts, or None."""
    long_key = _LONG_KEY.search(text)
    return text.count("\n", 0, long_key.start()) + 1 if long_key else None


def is_too_deep(data: Any) -> bool:
    """Return whether tables and lists are nested more than `DEEPEST` levels deep, or contain themselves."""
    level = [data]
    for _ in range(DEEPEST + 1):
        inner = (child for node in level for child in (node.values() if isinstance(node, dict) else node))
        level = list({id(child): child for child in inner if isinstance(child, (dict, list, tuple))}.values())
        if not level:
            return False
    return True
