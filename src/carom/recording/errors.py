"""The exceptions of this package."""

from __future__ import annotations


class RecordingError(Exception):
    """A recording cannot be written, read or shown; the message says why in one sentence."""


class DamageError(RecordingError):
    """A part of a file is damaged; the message names the part, but not the file."""


class TornFooterError(DamageError):
    """A file ends inside its footer: nothing but the index is lost."""
