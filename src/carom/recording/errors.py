"""The exceptions of this package."""

from __future__ import annotations


class RecordingError(Exception):
    """A recording cannot be written, read or shown; the message says why in one sentence."""


class DamageError(RecordingError):
    """A part of a file is not what it should be; says what, and not in which file."""


class TornFooterError(DamageError):
    """A file ends inside its footer: nothing but the index is lost."""
