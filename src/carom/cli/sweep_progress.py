"""What a person sees while a sweep is under way."""

from __future__ import annotations

import time
from types import TracebackType
from typing import Self

from rich.console import Console
from rich.live import Live
from rich.text import Text

from carom.cli.units import duration_text
from carom.experiment.sweep.manifest import Run

LINE_EVERY = 5.0  # s between lines where the output is not a terminal
BAR = 24  # characters


class SweepProgress:
    """Runs done, runs failed and time left, on stderr; and a line that stays for each failure."""

    def __init__(self, title: str, runs: int, quiet: bool = False) -> None:
        self._title = title
        self._runs = runs
        self._found = 0
        self._ended = 0
        self._failed = 0
        self._console = Console(stderr=True, quiet=quiet)
        self._live: Live | None = None
        self._first: float | None = None  # when the first run ended: the workers were starting before
        self._last_line = self._began = time.perf_counter()

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
        self._console.print(text, highlight=False, soft_wrap=True, markup=False)

    def begin(self, found: int) -> None:
        """Say what there is to do."""
        self._found = found
        self._began = self._last_line = time.perf_counter()
        there = f", {found} of them are there" if found else ""
        self.say(f"{self._title}: {self._runs} runs{there}")

    def ended(self, run: Run) -> None:
        """Count a run; tell of it if it went wrong."""
        self._ended += 1
        self._first = self._first or time.perf_counter()
        if not run.ok:
            self._failed += 1
            self.say(f"{run.name}: {run.outcome}: {' '.join(run.reason.split())}")

    def tick(self) -> None:
        """Show where the sweep is."""
        now = time.perf_counter()
        if self._live:
            self._live.update(Text(self._line(now)))
        elif now - self._last_line >= LINE_EVERY:
            self._last_line = now
            self.say(self._line(now))

    def _line(self, now: float) -> str:
        done = self._found + self._ended
        full = done * BAR // max(1, self._runs)
        failed = f"  {self._failed} failed" if self._failed else ""
        return f"{'━' * full}{'╌' * (BAR - full)} {done} of {self._runs} runs{failed}  {self._left(now)}"

    def _left(self, now: float) -> str:
        """Estimate the time left from the runs after the first, which waits for workers and kernels."""
        spent, ended = (now - self._first, self._ended - 1) if self._first else (0.0, 0)
        if ended < 1 or spent <= 0.0:
            return f"{duration_text(now - self._began)} so far"
        left = spent / ended * (self._runs - self._found - self._ended)
        return f"{ended / spent:.2g} runs/s  {duration_text(left)} left"
