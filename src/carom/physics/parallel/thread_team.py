"""Threads that share out the pieces of a kernel's work among them, without waiting for each other's beginning.

One thread leads: it posts a phase of so many pieces on a board, takes pieces like everybody else, and posts the next
phase when all of them are done. The others help: they take pieces as long as there are any. Which piece is done by whom
is left to chance, so a phase may only hold pieces that are independent, and then the bits do not depend on it.

The leader waits for pieces that were taken, never for helpers: with a helper that another process keeps from running
it does the work alone. A helper offers its core to other processes between two pieces, so that it is seldom stopped in
the middle of one. That is what threads that meet at a barrier cannot do. Rejected: `prange`, whose threads meet
after each of hundreds of colours (2 µs in quiet, 7.8 ms beside two busy processes with libgomp as it comes, and a layer
of threads that differs from machine to machine); a task of a thread pool for each phase (20 µs, and 60 to 80 µs where
the thread has been asleep for a millisecond; a helper that still looks out for work begins in 1); helpers that ask the
interpreter what to call (for its lock they and the leader waited 10 to 30 µs a phase, which took 1.2 instead of 1.65
from a step of 10⁴ bodies on two threads).
"""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carom.physics.parallel.atomics import atomic_add, atomic_load, atomic_store
from carom.physics.parallel.jit import kernel, long_kernel
from carom.physics.parallel.task import address_of, c_function, call, do, kind_of, lay_out, raise_fault

IntArray = NDArray[np.int64]

LEFT, BACK, DONE, OVER, CALLS, DOER = 0, 8, 16, 24, 32, 40  # words of the board, each in a cache line of its own
FAILED = OVER + 1  # whether a helper has
JOB = DOER + 1  # only the leader writes to either
WORDS = 48
PATIENCE = 5000  # looks at the board, some 20 µs, before a helper without work gives its core away
LOOKOUT = 50 * PATIENCE  # looks between two jobs, before it goes to sleep; with a fifth of it, 1.38 instead of 1.53
SHIFT = 32  # pieces, half a millisecond, after which it offers it to others
END, YIELD, REST = range(3)  # what a helper does next
SHARED = 0  # what a leader ends with, unless it was given the code for another kind of arguments
PIECES = 16  # for each thread, at most: the last ones end at about the same time
NAP = 50e-6  # s, for how long


class Team:
    """Helpers for kernels that share their work. One thread at a time may lead them.

    Parameters
    ----------
    threads
        The leader included; with one there are no helpers.
    """

    least = 2  # parts, that are worth to be shared out

    def __init__(self, threads: int) -> None:
        self.size = threads
        self._pool = ThreadPoolExecutor(threads - 1, "team") if threads > 1 else None
        self._board = np.zeros(WORDS, dtype=np.int64)
        self._falling_asleep = threading.Lock()
        self._awake = [True] + [False] * (threads - 1)
        self._answered = [0] * threads  # the last call that each has heard
        self._code: dict[Callable[..., None], tuple[int, int]] = {}  # of kernels: address, and kind of arguments
        self._call: _Call | None = None
        self._leading = threading.Lock()

    @contextmanager
    def gathered(self, help_out: Callable[..., int], *work: Any) -> Iterator[IntArray]:
        """Let helpers begin on a board of their own, and hand it out; it is empty if there are none.

        The leader dismisses them, or an exception does. One that a helper raises is raised here.

        Parameters
        ----------
        help_out
            Kernel called with the board and ``work`` until it returns `END`; after `REST` not at once.
        """
        if self._pool is None:
            yield ALONE
            return
        self._lead_alone()
        try:
            call = self._call = _Call(help_out, work)
            self._board[CALLS] += 1
            self._rouse()
            try:
                yield call.board
            finally:
                call.end()
        finally:
            self._leading.release()

    def divide(self, count: int, grain: int, work: Callable[..., None], *arguments: Any) -> None:
        """Call a kernel, whose first arguments are lo and hi, on parts that make up [0, count).

        Parameters
        ----------
        grain
            So many take some 10 µs: fewer are not worth a part of their own.
        work
            Lets go of the interpreter. An exception that it raises on any part is raised here when all are done.
        """
        if self._pool is None or count < self.least * grain:  # asked first: of a few bodies all of it is calls
            work(0, count, *arguments)
        else:
            pieces = max(1, min(count // grain, PIECES * self.size))
            self._lead_alone()
            try:
                self._share(work, count, pieces, arguments)
            finally:
                self._leading.release()

    def _share(self, work: Callable[..., None], count: int, pieces: int, arguments: tuple[Any, ...]) -> None:
        self._rouse()
        code, kind = self._code.get(work, (0, 0))
        kind = _lead(self._board, code, kind, count, pieces, arguments)
        if kind != SHARED:
            work(0, 0, *arguments)
            code = address_of(work, kind)
            self._code[work] = code, kind
            _lead(self._board, code, kind, count, pieces, arguments)

    def _lead_alone(self) -> None:
        """Become the leader. RuntimeError while another thread is: the two would share one board."""
        if not self._leading.acquire(blocking=False):
            raise RuntimeError("two threads use one team at once: a Space may be used by one thread at a time")

    def _rouse(self) -> None:
        """Wake the helpers that are asleep."""
        assert self._pool is not None
        with self._falling_asleep:  # a helper that is about to has either seen what was posted, or is seen asleep
            for who, awake in enumerate(self._awake):
                if not awake:
                    self._awake[who] = True
                    self._pool.submit(self._look_out, who)

    def _look_out(self, who: int) -> None:
        """Help with whatever comes, until nothing has come for a while."""
        while self._awake[who]:
            if _look(self._board, self._answered[who], OFFER):
                self._answered[who] = int(self._board[CALLS])
                if self._call:
                    self._call.help()
            else:
                with self._falling_asleep:
                    self._awake[who] = self._is_wanted(who)

    def _is_wanted(self, who: int) -> bool:
        return bool(self._board[LEFT] > 0 or self._board[CALLS] != self._answered[who])


ALONE: IntArray = np.zeros(0, dtype=np.int64)  # the board of a leader without helpers


SOLO = Team(1)


class _Call:
    """What helpers of a team are called to, on a board of its own."""

    def __init__(self, help_out: Callable[..., int], work: tuple[Any, ...]) -> None:
        self.board: IntArray = np.zeros(WORDS, dtype=np.int64)
        self._help_out, self._work = help_out, work
        self._fault: BaseException | None = None

    def help(self) -> None:
        """Help until dismissed. An exception is kept for the leader, who would wait for the piece for ever."""
        try:
            while (then := self._help_out(self.board, *self._work)) != END:
                if then == REST:
                    time.sleep(NAP)
                else:
                    _offer_core()
        except BaseException as fault:
            self._fault = fault
            _fail(self.board)

    def end(self) -> None:
        """Dismiss the helpers, and raise what one of them raised."""
        dismiss(self.board)
        if self._fault is not None:
            raise self._fault from None


def _offer_core() -> None:
    if hasattr(os, "sched_yield"):
        os.sched_yield()


OFFER: int = c_function("sched_yield") if hasattr(os, "sched_yield") else 0


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
    """Wait until all pieces of the phase are done. RuntimeError if a helper failed and will not finish its piece."""
    while atomic_load(board, DONE) < pieces:
        if atomic_load(board, FAILED) != 0:
            raise RuntimeError("a helper failed")


@kernel
def _fail(board: IntArray) -> None:
    atomic_store(board, FAILED, 1)


@long_kernel
def _lead(board: IntArray, code: int, kind: int, count: int, pieces: int, arguments: tuple[Any, ...]) -> int:
    """Do the pieces of [0, count) with the code of a kernel: return `SHARED`, or the kind that it should be for."""
    needed: int = kind_of(arguments)
    if kind != needed:
        return needed
    board[DOER], board[JOB] = lay_out(code, count, pieces, arguments)
    _take_part(board, pieces)
    raise_fault(board[JOB])
    return SHARED


@kernel
def _take_part(board: IntArray, pieces: int) -> None:
    """Post the pieces of the job on the board, and do them with the others: apart, to be compiled for all kinds."""
    post(board, pieces)
    k = 0
    while claim(board):
        do(board[DOER], board[JOB], k)
        finish(board)
        k += 1
    wait(board, pieces)


@long_kernel
def _look(board: IntArray, calls: int, offer: int) -> bool:
    """Help until nothing has come for a while, or until there is a call; tell which: whether there is one.

    Parameters
    ----------
    calls
        How many have been answered.
    offer
        The address of what offers the core to others, or 0.
    """
    idle = 0
    while idle < LOOKOUT:
        idle += 1
        if claim(board):
            do(board[DOER], board[JOB], last_piece(board))
            finish(board)
            idle = 0
        if atomic_load(board, CALLS) != calls:
            return True
        if offer != 0 and idle % PATIENCE == 0:
            call(offer)
    return False


@contextmanager
def sharing_all() -> Iterator[None]:
    """Share out even what is not worth it, so that the kernels that this takes are compiled or loaded."""
    least, Team.least = Team.least, 0
    try:
        yield
    finally:
        Team.least = least


def load_helpers() -> None:
    """Load the kernel that helpers wait in; a run does so when it first shares work out."""
    board = np.zeros(WORDS, dtype=np.int64)
    _look(board, int(board[CALLS]) - 1, OFFER)  # as if there were a call: it ends at once


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
