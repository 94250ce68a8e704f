"""Where the keys of a scene were written, for messages."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cached_property
from typing import TYPE_CHECKING

from carom.errors import SceneError
from carom.scene.lines import KeyPath, lines_of

if TYPE_CHECKING:
    from carom.scene.schema import Scene


class KeyPlaces:
    """The place where each key was written: a line of a file, or an override."""

    def __init__(self, file: str, text: str, overrides: dict[KeyPath, str]) -> None:
        self.file = file
        self.text = text
        self.overrides = overrides

    def __eq__(self, other: object) -> bool:
        """Scenes are equal wherever they were written."""
        return isinstance(other, KeyPlaces)

    __hash__ = None  # type: ignore[assignment]

    @cached_property
    def _lines(self) -> dict[KeyPath, int]:
        return lines_of(self.text)

    def of(self, path: KeyPath) -> str:
        """Return the place of a key as a message begins with it; empty if it is not known."""
        for overridden, text in self.overrides.items():
            if path[: len(overridden)] == overridden:
                return f"the override {text}: "
        line = next((self._lines[path[:n]] for n in range(len(path), 0, -1) if path[:n] in self._lines), None)
        if not line:  # a section that an override makes
            for overridden, text in self.overrides.items():
                if path and overridden[: len(path)] == path:
                    return f"the override {text}: "
        if not self.file:
            return ""
        return f"{self.file}:{line}: " if line else f"{self.file}: "


@contextmanager
def naming_places(scene: Scene) -> Iterator[None]:
    """Put the place of the key of a `SceneError` before its message, where the scene was read from a text."""
    try:
        yield
    except SceneError as error:
        if scene.places is None or not error.key:
            raise
        raise SceneError(f"{scene.places.of(error.key)}{error}") from None
