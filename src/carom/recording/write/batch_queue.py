"""A bounded queue that hands out batches.

The reader sleeps until a batch is full or due. Woken for every frame, as by `queue.Queue`, it would take the
interpreter's lock from the physics every time: a tenth of the run for 1000 bodies (benchmarks/recording.py).
"""

from __future__ import annotations

import threading
import time
from typing import Generic, TypeVar

_Item = TypeVar("_Item")


class BatchQueue(Generic[_Item]):
    """Holds at most ``capacity`` items; hands them out ``batch`` at a time, or what there is after ``seconds``."""

    def __init__(self, capacity: int, batch: int, seconds: float) -> None:
        self._capacity = max(capacity, batch)
        self._batch = batch
        self._seconds = seconds
        self._items: list[_Item] = []
        self._changed = threading.Condition()
        self._oldest = 0.0  # when the first of the items came
        self._closed = False
        self._error: Exception | None = None

    def put(self, item: _Item) -> None:
        """Add an item; wait while the box is full. Raises what `fail` was told, if anything was."""
        with self._changed:
            self._changed.wait_for(lambda: self._error is not None or len(self._items) < self._capacity)
            if self._error is not None:
                raise self._error
            if not self._items:
                self._oldest = time.monotonic()
            self._items.append(item)
            if len(self._items) in (1, self._batch):  # the reader wants to know when to look, and when to take
                self._changed.notify_all()

    def close(self) -> None:
        """Let the reader take what is left, and then end."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    def fail(self, error: Exception) -> None:
        """Let the writer know that nobody reads any more, and why."""
        with self._changed:
            self._error = error
            self._changed.notify_all()

    def take(self) -> list[_Item]:
        """Wait for a batch; an empty one is the end."""
        with self._changed:
            while not self._closed and len(self._items) < self._batch:
                left = self._oldest + self._seconds - time.monotonic() if self._items else None
                if left is not None and left <= 0.0:
                    break
                self._changed.wait(left)
            taken, self._items = self._items[: self._batch], self._items[self._batch :]
            self._oldest = time.monotonic()
            self._changed.notify_all()
            return taken
