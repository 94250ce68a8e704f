"""The one exception that a person's mistake in a scene raises."""

from __future__ import annotations


class SceneError(ValueError):
    """A scene that cannot be simulated as written; the message names the place, the fault and what would be right."""
