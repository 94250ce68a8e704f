"""The exceptions of this package."""

from __future__ import annotations

from pathlib import Path


class RecordingError(Exception):
    """A recording cannot be written, read or shown; the message says why in one sentence."""


class ExistsError(RecordingError):
    """A file would be replaced without leave."""

    def __init__(self, path: Path) -> None:
        super().__init__(f"{path}: exists; give force=True to replace it")
        self.path = path


class DamageError(RecordingError):
    """A part of a file is damaged; the message names the part, but not the file."""


class TornFooterError(DamageError):
    """A file ends inside its footer: nothing but the index is lost."""
