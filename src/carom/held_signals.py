"""Signals that wait until something is complete: an import, or the loading of a kernel."""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Iterator
from types import FrameType
from typing import Any

ENDING = (signal.SIGTERM, signal.SIGHUP)  # SIGTERM is sent by Slurm, Kubernetes and `kill`; SIGHUP by a closed terminal


@contextlib.contextmanager
def signals_held() -> Iterator[None]:
    """Delay the handlers of signals until the block ends; each runs once, in the order in which the signals came.

    A handler may raise an exception, as the handler of Ctrl-C does. If an exception ends an import, it leaves
    unfinished modules, which a later import takes for complete: Numba and NumPy then fail until the process ends.
    LLVM's callbacks drop the exception, and link a kernel to address zero. Outside the main thread, handlers do not
    run, so no signal is held.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    found = {number: signal.getsignal(number) for number in (signal.SIGINT, *ENDING)}
    handlers: dict[int, Any] = {number: handler for number, handler in found.items() if callable(handler)}
    held, holds = list[int](), True

    def hold(number: int, frame: FrameType | None) -> None:
        if holds:
            held.append(number)
        else:  # a signal came while the handlers were put back
            handlers[number](number, frame)

    for number in handlers:
        signal.signal(number, hold)
    try:
        yield
    finally:
        # the stack calls these in reverse order, and all of them even if one raises; so the last signal is registered
        # first
        with contextlib.ExitStack() as afterwards:
            for number in reversed(dict.fromkeys(held)):
                afterwards.callback(signal.raise_signal, number)
            for number, handler in handlers.items():
                afterwards.callback(signal.signal, number, handler)
            holds = False
