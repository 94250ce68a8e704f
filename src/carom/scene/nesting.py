"""Limit on the nesting of a scene: parsing, validation and messages recurse, or take time quadratic in the depth."""

from __future__ import annotations

import re
from typing import Any

DEEPEST = 32  # levels; the deepest key that a scene has is group.0.radius.min

_PART = r"""(?:[\w-]++|"(?:[^"\\\n]|\\.)*+"|'[^'\n]*+')"""
_LONG_KEY = re.compile(rf"(?:^[ \t]*+\[{{0,2}}|[{{,])[ \t]*+(?:{_PART}[ \t]*+\.[ \t]*+){{{DEEPEST}}}", re.MULTILINE)


def line_of_long_key(text: str) -> int | None:
    """Return the 1-based line of a dotted key of more than `DEEPEST` parts, or None."""
    found = _LONG_KEY.search(text)
    return text.count("\n", 0, found.start()) + 1 if found else None


def is_too_deep(data: Any) -> bool:
    """Tell whether tables and lists are nested more than `DEEPEST` levels deep, or in themselves."""
    level = [data]
    for _ in range(DEEPEST + 1):
        inner = (child for node in level for child in (node.values() if isinstance(node, dict) else node))
        level = list({id(child): child for child in inner if isinstance(child, (dict, list, tuple))}.values())
        if not level:
            return False
    return True
