"""The exception for mistakes in a scene."""

from __future__ import annotations


class SceneError(ValueError):
    """A scene cannot be simulated as written; the message names the place, the mistake and what would be right."""
