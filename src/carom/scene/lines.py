"""Line numbers of the keys in a TOML text.

No TOML library that we know keeps the line of a key, so this module reads the text again, line by line. The result only
serves messages. Where a key is written in a form that is not followed, such as a multi-line inline table, the line of
its section is returned.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable

KeyPath = tuple[str | int, ...]

_HEADER = re.compile(r"^\s*(\[\[?)\s*([^\[\]]+?)\s*\]\]?\s*(#.*)?$")
_KEY = re.compile(r"""^\s*((?:[\w-]+|"[^"]*"|'[^']*')(?:\s*\.\s*(?:[\w-]+|"[^"]*"|'[^']*'))*)\s*=""")


def lines_of(text: str) -> dict[KeyPath, int]:
    """Return the 1-based line on which each key and each section is written first."""
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
                lines.setdefault(section, number)  # a section that was written as a list of them
            section = written = _indexed([*above, last], seen)
        elif key:
            written = (*section, *_split(key[1]))
        else:
            continue
        lines.setdefault(written, number)
    return lines


def _indexed(keys: Iterable[str | int], seen: Counter[KeyPath]) -> KeyPath:
    """Put the index of the latest section after each key that stands for several, such as ``[[group]]``."""
    path: KeyPath = ()
    for key in keys:
        path = (*path, key)
        if seen[path]:
            path = (*path, seen[path] - 1)
    return path


def _split(dotted: str) -> KeyPath:
    return tuple(part.strip().strip("\"'") for part in dotted.split("."))
