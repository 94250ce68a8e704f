"""What a person sees while a sweep is under way."""

from __future__ import annotations

import time

from carom.cli.live_line import LiveLine, bar
from carom.cli.units import duration_text
from carom.lab.sweep.manifest import Run


class SweepProgress(LiveLine):
    """Runs done, runs failed and time left; and a line that stays for each failure."""

    def __init__(self, title: str, runs: int, quiet: bool = False) -> None:
        super().__init__(quiet)
        self._title = title
        self._runs = runs
        self._found = 0
        self._ended = 0
        self._failed = 0
        self._first: float | None = None  # when the first run ended: the workers were starting before

    def begin(self, found: int) -> None:
        """Say what there is to do."""
        self._found = found
        self._restart()
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
        self._show(self._line)

    def _line(self, now: float) -> str:
        done = self._found + self._ended
        failed = f"  {self._failed} failed" if self._failed else ""
        return f"{bar(done / max(1, self._runs))} {done} of {self._runs} runs{failed}  {self._left(now)}"

    def _left(self, now: float) -> str:
        """Estimate the time left from the runs after the first, which waits for workers and kernels."""
        spent, ended = (now - self._first, self._ended - 1) if self._first else (0.0, 0)
        if ended < 1 or spent <= 0.0:
            return f"{duration_text(now - self._began)} so far"
        left = spent / ended * (self._runs - self._found - self._ended)
        return f"{ended / spent:.2g} runs/s  {duration_text(left)} left"
