"""Sizes of the views of a layout on the screen, by which cameras and legends are placed."""

from __future__ import annotations

from dataclasses import dataclass

_TITLE = 24  # points, of a view's title bar
_TIME_PANEL = 34  # points, collapsed
_TOP_PANEL = 36  # points


@dataclass(frozen=True, slots=True)
class Area:
    """A view without its title bar."""

    width: float  # points of the screen
    height: float

    @property
    def aspect(self) -> float:
        """Width over height."""
        return self.width / self.height


@dataclass(frozen=True, slots=True)
class Canvas:
    """The window or the picture, in points of the screen."""

    width: int = 1600
    height: int = 1000
    framed: bool = True  # with the viewer's panels and the titles of views

    def area(self, across: float = 1.0, down: float = 1.0) -> Area:
        """Return the area of a view that takes these shares of the width and of the height."""
        if not self.framed:
            return Area(self.width * across, self.height * down)
        height = self.height - _TOP_PANEL - _TIME_PANEL
        return Area(max(1.0, self.width * across), max(1.0, height * down - _TITLE))
