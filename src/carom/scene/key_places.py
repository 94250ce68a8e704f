"""Where the keys of a scene were written, for messages."""

from __future__ import annotations

from carom.scene.lines import KeyPath, line_of


class KeyPlaces:
    """The place where each key was written: a line of a file, or an override."""

    def __init__(self, file: str, text: str, overrides: dict[KeyPath, str]) -> None:
        self.file = file
        self.text = text
        self.overrides = overrides

    def of(self, path: KeyPath) -> str:
        """Return the place of a key as a message begins with it; empty if it is not known."""
        for overridden, text in self.overrides.items():
            if path[: len(overridden)] == overridden:
                return f"the override {text}: "
        if not self.file:
            return ""
        line = line_of(self.text, path)
        return f"{self.file}:{line}: " if line else f"{self.file}: "
