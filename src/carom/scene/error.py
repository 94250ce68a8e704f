"""The exception for mistakes in a scene."""

from __future__ import annotations


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
