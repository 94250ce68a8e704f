"""The exceptions that carom raises; each message is one sentence for a person.

Users need the four in ``__all__``. The others let callers inside carom tell one kind of `RecordingError` from another.
"""

from __future__ import annotations

from pathlib import Path

__all__ = ["ExperimentError", "PhysicsError", "RecordingError", "SceneError"]


class SceneError(ValueError):
    """A scene cannot be simulated as written; the message has the place, the mistake and a valid value.

    Parameters
    ----------
    message
        The sentence.
    key
        The key in question, such as ``("group", 0, "region")``, if its place is unknown where the error is raised.
        `naming_places` then puts the place before the message.
    """

    def __init__(self, message: str, key: tuple[str | int, ...] = ()) -> None:
        super().__init__(message)
        self.key = key


class PhysicsError(RuntimeError):
    """The run cannot continue: the state is not finite, or the step is too small to change the clock."""


class ExperimentError(Exception):
    """A request cannot be fulfilled; the message has the reason and the remedy."""


class RecordingError(Exception):
    """A recording cannot be written, read or shown; the message is one sentence with the reason."""


class RecorderError(RecordingError):
    """The recorder stopped by an error of the program or of an extension, or for lack of memory; its file is closed."""


class ExistsError(RecordingError):
    """A file would be replaced without permission."""

    def __init__(self, path: Path) -> None:
        super().__init__(f"{path}: exists; give force=True to replace it")
        self.path = path


class DamageError(RecordingError):
    """A part of a file is damaged; the message names the part, but not the file."""


class TornFooterError(DamageError):
    """A file ends inside its footer: nothing but the index is lost."""
