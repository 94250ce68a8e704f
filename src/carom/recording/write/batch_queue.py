"""A bounded queue between the physics thread and the recorder, read in batches.

The reader sleeps until a batch is full or due. `queue.Queue` would wake it for every frame, and each time it would take
the interpreter lock from the physics, which costs a tenth of a run of 1000 bodies (benchmarks/recording.py).
"""

from __future__ import annotations

import threading
import time
from typing import Generic, TypeVar

_Item = TypeVar("_Item")


class BatchQueue(Generic[_Item]):
    """Holds at most ``capacity`` items. `take` returns ``batch`` of them, or after ``seconds`` as many as there are."""

    def __init__(self, capacity: int, batch: int, seconds: float) -> None:
        self._capacity = max(capacity, batch)
        self._batch = batch
        self._seconds = seconds
        self._items: list[_Item] = []
        self._changed = threading.Condition()
        self._oldest = 0.0  # monotonic time when the first of the items was put in
        self._closed = False
        self._error: Exception | None = None

    def wait_for_room(self) -> None:
        """Wait while the queue is full; return at once after `fail`. Only the thread that puts items may call it."""
        if len(self._items) < self._capacity:  # nobody else makes it longer
            return
        with self._changed:
            self._changed.wait_for(lambda: self._error is not None or len(self._items) < self._capacity)

    def put(self, item: _Item) -> None:
        """Add an item; wait while the queue is full. Raises the error given to `fail`, if any."""
        with self._changed:
            self._changed.wait_for(lambda: self._error is not None or len(self._items) < self._capacity)
            if self._error is not None:
                raise self._error
            if not self._items:
                self._oldest = time.monotonic()
            self._items.append(item)
            if len(self._items) in (1, self._batch):  # the first starts the reader's clock, the last fills a batch
                self._changed.notify_all()

    def close(self) -> None:
        """Close the queue: after the remaining items, `take` returns an empty batch."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    def fail(self, error: Exception) -> None:
        """Make every later `put` raise this error, because the reader has stopped."""
        with self._changed:
            self._error = error
            self._changed.notify_all()

    def take(self, within: float | None = None) -> list[_Item] | None:
        """Wait for a batch; an empty one means that the queue is closed, None that no item came within a time in s."""
        with self._changed:
            latest = None if within is None else time.monotonic() + within
            while not self._closed and len(self._items) < self._batch:
                due = self._oldest + self._seconds if self._items else latest
                left = None if due is None else due - time.monotonic()
                if left is not None and left <= 0.0:
                    if not self._items:
                        return None
                    break
                self._changed.wait(left)
            taken, self._items = self._items[: self._batch], self._items[self._batch :]
            self._oldest = time.monotonic()
            self._changed.notify_all()
            return taken
