"""Which line of a TOML text a key stands on.

No TOML library that we know keeps the line of a key, so this reads the text once more, line by line. It is only
used to point a person at a place: where a key is written in a way that it does not follow (a multi-line inline
table, say), the line of the section stands in.
"""

from __future__ import annotations

import re
from collections import Counter

KeyPath = tuple[str | int, ...]

_HEADER = re.compile(r"^\s*(\[\[?)\s*([^\[\]]+?)\s*\]\]?\s*(#.*)?$")
_KEY = re.compile(r"""^\s*((?:[\w-]+|"[^"]*"|'[^']*')(?:\s*\.\s*(?:[\w-]+|"[^"]*"|'[^']*'))*)\s*=""")


def line_of(text: str, path: KeyPath) -> int | None:
    """Return the 1-based line of the longest written prefix of ``path``, or None."""
    best: tuple[int, int] = (0, 0)
    section: KeyPath = ()
    seen: Counter[KeyPath] = Counter()
    for number, line in enumerate(text.splitlines(), start=1):
        header, key = _HEADER.match(line), _KEY.match(line)
        if header:
            section = _split(header[2])
            if header[1] == "[[":
                seen[section] += 1
                section = (*section, seen[section] - 1)
            written = section
        elif key:
            written = (*section, *_split(key[1]))
        else:
            continue
        if path[: len(written)] == written and len(written) > best[0]:
            best = (len(written), number)
    return best[1] or None


def _split(dotted: str) -> KeyPath:
    return tuple(part.strip().strip("\"'") for part in dotted.split("."))
