"""The one exception of this package."""

from __future__ import annotations


class ExperimentError(Exception):
    """What was asked for cannot be done; the message says why, and what would be right."""
