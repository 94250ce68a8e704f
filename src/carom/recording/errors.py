"""The one exception of this package."""

from __future__ import annotations


class RecordingError(Exception):
    """A recording cannot be written, read or shown; the message says why in one sentence."""
