"""The exception of this package."""

from __future__ import annotations


class ExperimentError(Exception):
    """A request cannot be fulfilled; the message says why, and what would be right."""
