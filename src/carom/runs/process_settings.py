"""Settings of the process of a run: signals that request its end, the memory allocator, and garbage collection.

Signals come from Ctrl-C, from job schedulers and from closed terminals. A run passes thousands of arrays between
threads. By default glibc returns freed memory to the system and requests it again, which costs 40 page faults per frame
of 1000 bodies, a twentieth of the run. Keeping this memory does not enlarge the process, because the number of queued
frames is bounded.
"""

from __future__ import annotations

import ctypes
import gc
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType, TracebackType
from typing import Any, Self

ENDING = (signal.SIGTERM, signal.SIGHUP)  # sent by Slurm, Kubernetes and `kill`; by a closed terminal
AFTER_CALLBACK = 0.05  # s; llvmlite's callbacks for each kernel take microseconds
SAME_PRESS = 0.3  # s within which interrupts count once: wrappers such as `uv run` forward that of the terminal

_ARENA_MAX, _TRIM_THRESHOLD, _MMAP_THRESHOLD = -8, -1, -3  # glibc's <malloc.h>
_KEPT = 512 << 20  # bytes of free memory to keep
_LARGE = 64 << 20  # bytes; larger arrays get pages of their own
_NEW_OBJECTS = 100_000  # the first batches create 60 000 objects, mostly modules, which remain

_received: list[int] = []  # signals that were raised as KeyboardInterrupt


def raise_signals() -> None:
    """Make every signal that would end this process raise KeyboardInterrupt in the main thread, like Ctrl-C."""
    for number in (signal.SIGINT, *ENDING):
        if signal.getsignal(number) in (signal.SIG_DFL, signal.default_int_handler):  # nohup ignores SIGHUP
            signal.signal(number, _raise)
    sys.unraisablehook = _raise_later


def received() -> int:
    """Return the signal that was raised as KeyboardInterrupt; 0 if none was."""
    return _received[0] if _received else 0


def _raise(number: int, frame: FrameType | None) -> None:
    _received.append(number)
    raise KeyboardInterrupt


def _raise_later(lost: sys.UnraisableHookArgs) -> None:
    """Raise an interrupt again that C code dropped because it arrived within a callback."""
    if lost.exc_type is not KeyboardInterrupt or not received():
        sys.__unraisablehook__(lost)
        return
    later = threading.Timer(AFTER_CALLBACK, signal.pthread_kill, (threading.main_thread().ident, received()))
    later.daemon = True
    later.start()


class Interrupts:
    """Counts requests to end while its context lasts; outside the main thread it counts none.

    It raises nothing until the interrupt key has been pressed more often than ``patience``, so that work is not
    interrupted. Other signals count once, because their senders repeat them.

    Parameters
    ----------
    patience
        Presses of the interrupt key that raise nothing.
    """

    def __init__(self, patience: int = 1) -> None:
        self.count = 0
        self.sender = "the user"
        self._patience = patience
        self._last = -SAME_PRESS  # s, when the interrupt key was last pressed
        self._before: dict[int, Any] = {}

    def __enter__(self) -> Self:
        if threading.current_thread() is threading.main_thread():
            if received():  # a library caught the exception during its import
                raise KeyboardInterrupt
            known = (signal.SIG_DFL, signal.default_int_handler, _raise)
            for number in (signal.SIGINT, *ENDING):
                if signal.getsignal(number) in known:
                    self._before[number] = signal.signal(number, self._see)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _see(self, number: int, frame: FrameType | None) -> None:
        if number != signal.SIGINT:
            if self.count == 0:
                self.count, self.sender = 1, signal.Signals(number).name
            return
        now = time.monotonic()
        if now - self._last >= SAME_PRESS:
            self.count += 1
        self._last = now
        if self.count > self._patience:
            if self._before.get(number) is _raise:  # in a command, whose exit code names the signal
                _raise(number, frame)
            raise KeyboardInterrupt  # in a program, which may catch it and start another run


def keep_freed_memory() -> None:
    """Keep freed memory for the next frame, in one pool for all threads; does nothing without glibc.

    Call it before there are other threads, because threads that NumPy starts keep pools of their own.
    """
    if not sys.platform.startswith("linux"):
        return
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (AttributeError, OSError):  # another C library
        return
    for option, value in ((_ARENA_MAX, 1), (_TRIM_THRESHOLD, _KEPT), (_MMAP_THRESHOLD, _LARGE)):
        mallopt(option, value)


@contextmanager
def garbage_sought_seldom() -> Iterator[None]:
    """Let Python collect cyclic garbage after 100 000 new objects instead of 700.

    There is hardly any, since frames and rows have no cycles. A full collection takes 0.1 s, while the physics waits
    for the interpreter lock, and small ones took 50 µs of each frame of 1000 bodies (both on a busy machine).
    """
    before = gc.get_threshold()
    if before[0]:  # otherwise the program has switched it off
        gc.set_threshold(max(_NEW_OBJECTS, before[0]), *before[1:])
    try:
        yield
    finally:
        gc.set_threshold(*before)
