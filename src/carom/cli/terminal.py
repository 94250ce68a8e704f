"""A Rich console for text that came from a file."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from rich.console import Console, ConsoleOptions, RenderableType
from rich.segment import Segment
from rich.table import Table

from carom.scene.wording import escaped

WIDEST = 10_000  # characters, of a table that is printed whole


class Terminal(Console):
    """Prints text as it is: no markup unless it is asked for, and control characters as escapes."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**{"markup": False, "highlight": False, **options})

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        """Render, and escape what is text."""
        for segment in super().render(renderable, options):
            yield segment if segment.control else Segment(escaped(segment.text), segment.style)


def print_whole(table: Table) -> None:
    """Print a table with all its cells whole, wider than the terminal if they need it."""
    console = Terminal()
    needed = console.measure(table, options=console.options.update(width=WIDEST)).maximum
    console.width = max(console.width, needed)
    console.print(table)
