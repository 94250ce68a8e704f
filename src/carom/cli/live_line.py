"""A line that says where long work is."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from types import TracebackType
from typing import Self

from rich.live import Live
from rich.text import Text

from carom.cli.terminal import Terminal
from carom.cli.units import duration_text

LINE_EVERY = 5.0  # s between lines where the output is not a terminal
BAR = 24  # characters
PATIENCE = 1.0  # s of work before a line says what it is


class LiveLine:
    """A line that is rewritten on a terminal, and a plain line now and then elsewhere; all on stderr."""

    def __init__(self, quiet: bool = False) -> None:
        self._console = Terminal(stderr=True, quiet=quiet)
        self._live: Live | None = None
        self._began = self._last_line = time.perf_counter()

    def __enter__(self) -> Self:
        if self._console.is_terminal and not self._console.quiet:
            self._live = Live(console=self._console, refresh_per_second=8, transient=True)
            self._live.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if self._live:
            self._live.stop()
            self._live = None

    def say(self, text: str) -> None:
        """Print a line that stays."""
        self._console.print(text, soft_wrap=True)

    def _restart(self) -> None:
        """Count time from now on."""
        self._began = self._last_line = time.perf_counter()

    def _show(self, line: Callable[[float], str]) -> None:
        """Show the line of this moment; it is given the clock, in s."""
        now = time.perf_counter()
        if self._live:
            self._live.update(Text(line(now)))
        elif now - self._last_line >= LINE_EVERY:
            self._last_line = now
            self.say(line(now))


class Patience(LiveLine):
    """A line that says what work is, on a terminal, once it takes longer than `PATIENCE`.

    Parameters
    ----------
    text
        What the work is.
    beside
        The line whose place it takes.
    everywhere
        Whether to print it where the output is no terminal, too, and again every `LINE_EVERY`.
    """

    def __init__(self, text: str, beside: LiveLine, *, everywhere: bool = False) -> None:
        super().__init__()
        self._everywhere = everywhere
        self._console = beside._console  # so that what is said there meanwhile stands above this line
        self._text, self._detail = text, ""
        self._timer = threading.Timer(PATIENCE, self._begin)
        self._timer.daemon = True

    def __enter__(self) -> Self:
        self._restart()
        if (self._console.is_terminal or self._everywhere) and not self._console.quiet:
            self._timer.start()
        return self

    def detail(self, text: str) -> None:
        """Say how far the work is."""
        self._detail = text
        is_due = time.perf_counter() - self._last_line >= LINE_EVERY
        if self._everywhere and is_due and not (self._console.is_terminal or self._console.quiet):
            self._begin()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._timer.cancel()
        if self._timer.is_alive():
            self._timer.join()
        super().__exit__(kind, error, traceback)

    def _begin(self) -> None:
        if not self._console.is_terminal:
            self._last_line = time.perf_counter()
            self.say(str(self._line()))
            return
        self._live = Live(console=self._console, refresh_per_second=8, transient=True, get_renderable=self._line)
        self._live.start()

    def _line(self) -> Text:
        text = f"{self._text} {self._detail}".strip()
        return Text(f"{text}  {duration_text(time.perf_counter() - self._began)}")


def bar(done: float) -> str:
    """Draw a fraction from 0 to 1."""
    full = int(done * BAR)
    return f"{'━' * full}{'╌' * (BAR - full)}"
