"""Renamed keys of a scene; the old names are still read."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from carom.scene.lines import KeyPath

RENAMED: dict[KeyPath, KeyPath] = {("record", "log_freq"): ("record", "check_every")}  # old to new


class OldNameWarning(FutureWarning):
    """A scene uses the old name of a key."""


def other_name(path: KeyPath) -> KeyPath | None:
    """Return the other name of a renamed key, old for new and new for old; None for any other key."""
    return RENAMED.get(path) or next((old for old, new in RENAMED.items() if new == path), None)


def old_names(scene: Mapping[str, Any]) -> Iterator[KeyPath]:
    """Find the old names among the keys of a scene."""
    for old in RENAMED:
        node: Any = scene
        for key in old:
            node = node.get(key) if isinstance(node, Mapping) else None
        if node is not None:
            yield old


def advice(old: KeyPath) -> str:
    """Name the new name of an old one."""
    return f"{'.'.join(map(str, old))} is now called {'.'.join(map(str, RENAMED[old]))}; the old name still works"
