"""Threads that share out the pieces of a kernel's work among them, without waiting for each other's beginning.

One thread leads: it posts a phase of so many pieces on a board, takes pieces like everybody else, and posts the next
phase when all of them are done. The others help: they take pieces as long as there are any. Which piece is done by whom
is left to chance, so a phase may only hold pieces that are independent, and then the bits do not depend on it.

The leader waits for pieces that were taken, never for helpers: with a helper that another process keeps from running
it does the work alone. A helper offers its core to other processes between two pieces, so that it is seldom stopped in
the middle of one. That is what threads that meet at a barrier cannot do. Rejected: `prange`, whose threads meet
after each of hundreds of colours (2 µs in quiet, 7.8 ms beside two busy processes with libgomp as it comes, and a layer
of threads that differs from machine to machine); a task of a thread pool for each colour (50 µs).
"""

from __future__ import annotations

import itertools
import os
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carom.physics.kernel import kernel
from carom.physics.machine import atomic_add, atomic_load, atomic_store

IntArray = NDArray[np.int64]

LEFT, BACK, DONE, OVER = 0, 8, 16, 24  # words of the board, each in a cache line of its own
WORDS = 32
PATIENCE = 5000  # looks at the board, some 20 µs, before a helper without work gives its core away
SHIFT = 32  # pieces, half a millisecond, after which it offers it to others
END, YIELD, REST = range(3)  # what a helper does next
DIVIDED_FROM = 20_000  # rows; below, a task costs what it saves
NAP = 50e-6  # s, for how long


class Team:
    """Helpers for kernels that share their work.

    Parameters
    ----------
    threads
        The leader included; with one there are no helpers.
    """

    def __init__(self, threads: int) -> None:
        self.helpers = threads - 1
        self._pool = ThreadPoolExecutor(self.helpers, "team") if self.helpers else None

    def gather(self, help_out: Callable[..., int], *work: Any) -> IntArray:
        """Let helpers begin on a board, and return it; it is empty if there are none.

        Parameters
        ----------
        help_out
            Kernel called with the board and ``work`` until it returns `END`; after `REST` not at once.
        """
        if self._pool is None:
            return ALONE
        board = np.zeros(WORDS, dtype=np.int64)
        for _ in range(self.helpers):
            self._pool.submit(_help, help_out, board, *work)
        return board

    def divide(self, count: int, work: Callable[..., None], *arguments: Any) -> None:
        """Call a kernel, whose first arguments are lo and hi, over all of [0, count), a part for each thread."""
        if self._pool is None or count < DIVIDED_FROM:
            work(0, count, *arguments)
            return
        edges = [count * k // (self.helpers + 1) for k in range(self.helpers + 2)]
        tasks = [self._pool.submit(work, lo, hi, *arguments) for lo, hi in itertools.pairwise(edges[1:])]
        work(0, edges[1], *arguments)
        for task in tasks:
            task.result()


ALONE: IntArray = np.zeros(0, dtype=np.int64)  # the board of a leader without helpers


def _help(help_out: Callable[..., int], *work: Any) -> None:
    while (then := help_out(*work)) != END:
        if then == REST:
            time.sleep(NAP)
        elif hasattr(os, "sched_yield"):
            os.sched_yield()


def cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@kernel
def post(board: IntArray, pieces: int) -> None:
    """Post a phase of so many pieces; what they need to know has been written before."""
    atomic_store(board, DONE, 0)
    atomic_store(board, BACK, pieces)
    atomic_store(board, LEFT, pieces)


@kernel
def claim(board: IntArray) -> bool:
    """Claim one piece of the phase on the board, if there is one left: the leader the next one from the front."""
    claimed: bool = atomic_load(board, LEFT) > 0 and atomic_add(board, LEFT, -1) > 0
    return claimed


@kernel
def last_piece(board: IntArray) -> int:
    """Return which piece a helper that claimed one does: the next one from the back.

    From phase to phase bodies then mostly stay in the cache of the core that had them before.
    """
    piece: int = atomic_add(board, BACK, -1) - 1
    return piece


@kernel
def finish(board: IntArray) -> None:
    """Say that a piece is done."""
    atomic_add(board, DONE, 1)


@kernel
def wait(board: IntArray, pieces: int) -> None:
    """Wait until all pieces of the phase are done."""
    while atomic_load(board, DONE) < pieces:
        pass


@kernel
def dismiss(board: IntArray) -> None:
    """Send the helpers away."""
    if len(board) > 0:
        atomic_store(board, OVER, 1)


@kernel
def is_over(board: IntArray) -> bool:
    """Tell whether the helpers have been sent away."""
    over: bool = atomic_load(board, OVER) != 0
    return over
