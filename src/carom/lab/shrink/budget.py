"""How long a reduction may take, and whether the user has ended it."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

from carom.physics.space import Space
from carom.runs.interrupts import Interrupts

_POLL = 0.05  # s between two looks at a run


class OutOfTime(Exception):  # noqa: N818 - not an error: the smallest scene so far is the result
    """The time is over, or the user has ended the reduction."""


class Budget:
    """The time of a reduction.

    Parameters
    ----------
    seconds
        s; infinite without a limit.
    interrupts
        Requests of the user to end.
    """

    def __init__(self, seconds: float, interrupts: Interrupts) -> None:
        self.began = time.monotonic()
        self._seconds = seconds
        self._interrupts = interrupts

    @property
    def spent(self) -> float:
        """The time so far in s."""
        return time.monotonic() - self.began

    @property
    def reason(self) -> str:
        """Why it is over; empty while it is not."""
        if self._interrupts.count:
            return f"stopped by {self._interrupts.sender}"
        return "the budget was spent" if self.spent > self._seconds else ""

    def check(self) -> None:
        """Raise `OutOfTime` when it is over."""
        if reason := self.reason:
            raise OutOfTime(reason)

    @contextmanager
    def guarding(self, space: Space) -> Iterator[None]:
        """Stop a run when the time is over, and then raise `OutOfTime`."""
        self.check()
        over = threading.Event()

        def watch() -> None:
            while not over.wait(_POLL):
                if self.reason:
                    space.stop()
                    return

        watcher = threading.Thread(target=watch, name="budget", daemon=True)
        watcher.start()
        try:
            yield
        finally:
            over.set()
            watcher.join()
        self.check()
