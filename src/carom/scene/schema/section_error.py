"""A mistake that shows only when one section is compared with others."""

from __future__ import annotations


class SectionError(ValueError):
    """A contradiction between sections, and the key that should be changed."""

    def __init__(self, path: tuple[str | int, ...], message: str) -> None:
        super().__init__(message)
        self.path = path
