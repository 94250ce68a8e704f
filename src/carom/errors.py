"""The exceptions that carom raises; each message is one sentence for a person.

Users need the four in ``__all__``. The others let callers inside carom tell one kind of `RecordingError` from another.
"""

from __future__ import annotations

from pathlib import Path

__all__ = ["ExperimentError", "PhysicsError", "RecordingError", "SceneError"]


class SceneError(ValueError):
    """A scene cannot be simulated as written; the message names the place, the mistake and what would be right.

    Parameters
    ----------
    message
        The sentence.
    key
        The key that it is about, such as ``("group", 0, "region")``, where whoever raises it does not know its place.
        `naming_places` puts the place before the message.
    """

    def __init__(self, message: str, key: tuple[str | int, ...] = ()) -> None:
        super().__init__(message)
        self.key = key


class PhysicsError(RuntimeError):
    """The run cannot continue: the state is not finite, or the step is too small to change the clock."""


class ExperimentError(Exception):
    """A request cannot be fulfilled; the message says why, and what would be right."""


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
