"""A team of threads that share the work of a kernel: a leader and helpers.

Two threads gain a factor of 1.5 to 1.9 in steps of 10⁴ bodies or more (docs/performance.md). In the plain form, the
leader is alone.

The leader posts a phase of independent pieces on a board, processes pieces itself, and posts the next phase when all
pieces are done. Helpers process pieces as long as there are any. Any thread may process any piece, so the pieces of a
phase must be independent. The bits therefore do not depend on the number of threads.

The leader waits only for pieces that a helper has already taken, never for a helper to start. If another process keeps
a helper from running, the leader does the work alone. Helpers yield their core between pieces, so they are rarely
interrupted within one.

Rejected, with measurements:

- Numba's ``prange``: its threads meet at a barrier after each of hundreds of colours, which takes 2 µs on a quiet
  machine, and 7.8 ms beside two busy processes with libgomp's defaults. The threading layer of ``prange`` also depends
  on the machine.
- One thread pool task for each phase: 20 µs, and 60 to 80 µs if the thread has slept for a millisecond. A helper that
  is polling the board starts within 1 µs.
- Helpers that ask the interpreter which function to call: leader and helpers wait for the interpreter lock, 10 to 30 µs
  per phase. In this way, a step of 10⁴ bodies gained a factor of 1.2 from a second thread, instead of 1.65.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any

import numpy as np

from carom.arrays import IntArray
from carom.physics.jit.decorators import kernel, long_kernel
from carom.physics.jit.inside import PLAIN
from carom.physics.jit.instructions import atomic_add, atomic_load, atomic_store
from carom.physics.jit.task import address_of, c_function, call, do, kind_of, lay_out, raise_fault

LEFT, BACK, DONE, DOER = 0, 8, 16, 24  # indices of words on the board, each in a cache line of its own
JOB, FIRST = DOER + 1, DOER + 2  # like DOER, these words are written by the leader only
WORDS = 32
PATIENCE = 5000  # polls of the board, about 20 µs, before an idle helper yields its core
# number of polls between two jobs before a helper sleeps; with a fifth of this number, two threads gain a factor of
# 1.38, not 1.53
LOOKOUT = 50 * PATIENCE
SHIFT = 32  # number of pieces, a few tenths of a millisecond, after which a busy helper yields its core
SHARED = 0  # result of `_lead` when the job is done; any other result is the kind of arguments that lacks code
PIECES = 16  # largest number of pieces per thread: enough for all threads to finish at about the same time


class Team:
    """A leader and its helpers; ``threads`` is the number of threads. Only one thread at a time may lead."""

    least = 2  # smallest number of grains of work that are shared

    def __init__(self, threads: int) -> None:
        self.size = threads = 1 if PLAIN else threads
        self._pool = ThreadPoolExecutor(threads - 1, "team") if threads > 1 else None
        self._board = np.zeros(WORDS, dtype=np.int64)
        self._falling_asleep = threading.Lock()
        self._awake = [True] + [False] * (threads - 1)
        self._code: dict[Callable[..., None], tuple[int, int]] = {}  # address, and kind of arguments, of each kernel
        self._leading = threading.Lock()

    @contextmanager
    def leading(self) -> Iterator[IntArray]:
        """Yield the board on which the caller leads phases with `lead_phase`; it is empty if there are no helpers."""
        if self._pool is None:
            yield ALONE
            return
        if not self._leading.acquire(blocking=False):  # two leaders would share one board
            raise RuntimeError("two threads use one team at once; only one thread may use a Space at a time")
        try:
            self._rouse()
            yield self._board
        finally:
            self._leading.release()

    def divide(
        self,
        count: int,
        grain: int,
        work: Callable[..., None],
        *arguments: Any,
        alone: Callable[..., None] | None = None,
    ) -> None:
        """Call ``work(lo, hi, *arguments)`` on pieces that cover [0, count).

        An exception in a piece is raised here when all pieces are done.

        ``work`` is a `long_kernel`, which releases the interpreter's lock; ``alone`` is its `entry_of` for these
        arguments, called if the work is not shared. A piece has at least ``grain`` elements, about 10 µs of work.
        """
        # tested first, since calls with little work take most of a step with few bodies
        if self._pool is None or count < self.least * grain:
            (alone or work)(0, count, *arguments)
        else:
            pieces = max(1, min(count // grain, PIECES * self.size))
            with self.leading() as board:
                code, kind = self._code.get(work, (0, 0))
                kind = _lead(board, code, kind, count, pieces, arguments)
                if kind != SHARED:
                    work(0, 0, *arguments)  # compiles the kernel
                    code = address_of(work, kind)
                    self._code[work] = code, kind
                    _lead(board, code, kind, count, pieces, arguments)

    def _rouse(self) -> None:
        """Wake sleeping helpers. A helper that falls asleep before the work is posted wakes for the next job."""
        assert self._pool is not None
        with self._falling_asleep:
            for helper, awake in enumerate(self._awake):
                if not awake:
                    self._awake[helper] = True
                    self._pool.submit(self._look_out, helper)

    def _look_out(self, helper: int) -> None:
        """Process pieces of jobs; return after some time without pieces."""
        while self._awake[helper]:
            _look(self._board, OFFER, LOOKOUT)
            with self._falling_asleep:
                self._awake[helper] = bool(self._board[LEFT] > 0)


ALONE: IntArray = np.zeros(0, dtype=np.int64)  # the board of a leader without helpers
SOLO = Team(1)


# address of the C function that yields the core; 0 if there is none
OFFER: int = c_function("sched_yield") if hasattr(os, "sched_yield") else 0


@kernel
def post(board: IntArray, pieces: int) -> None:
    """Post a phase of ``pieces`` pieces. Data that helpers read must be written before this call."""
    atomic_store(board, DONE, 0)
    atomic_store(board, BACK, pieces)
    atomic_store(board, LEFT, pieces)


@kernel
def claim(board: IntArray) -> bool:
    """Claim a piece of the phase; False if none is left. The leader takes pieces from the front."""
    claimed: bool = atomic_load(board, LEFT) > 0 and atomic_add(board, LEFT, -1) > 0
    return claimed


@kernel
def finish(board: IntArray) -> None:
    """Count a piece as done."""
    atomic_add(board, DONE, 1)


@kernel
def wait(board: IntArray, pieces: int) -> None:
    """Wait until all pieces of the phase are done."""
    while atomic_load(board, DONE) < pieces:
        pass


@long_kernel
def _lead(board: IntArray, code: int, kind: int, count: int, pieces: int, arguments: tuple[Any, ...]) -> int:
    """Process the pieces of [0, count) with a kernel; return `SHARED`, or the kind of arguments that lacks code."""
    needed: int = kind_of(arguments)
    if kind != needed:
        return needed
    doer, job = lay_out(code, count, pieces, arguments)
    lead_phase(board, doer, job, 0, pieces)
    raise_fault(job)
    return SHARED


@kernel
def lead_phase(board: IntArray, doer: int, job: int, first: int, pieces: int) -> None:
    """Post ``pieces`` pieces of a job, from ``first`` on, and process them with the helpers.

    The caller must not raise the job's fault before this call returns: helpers need the job until all pieces are done.
    """
    board[DOER], board[JOB], board[FIRST] = doer, job, first
    post(board, pieces)
    k = first
    while claim(board):
        do(doer, job, k, k + 1)
        finish(board)
        k += 1
    wait(board, pieces)


@long_kernel
def _look(board: IntArray, offer: int, looks: int) -> None:
    """Process pieces of jobs, and call `OFFER` from time to time; return after ``looks`` polls without work."""
    idle, done = 0, 0
    while idle < looks:
        idle += 1
        if claim(board):
            # helpers take pieces from the back, the leader from the front, so bodies mostly stay in the same core's
            # cache
            piece = board[FIRST] + atomic_add(board, BACK, -1) - 1
            do(board[DOER], board[JOB], piece, piece + 1)
            finish(board)
            idle = 0
            done += 1
        if offer != 0 and (idle % PATIENCE == 0 if idle > 0 else done % SHIFT == 0):
            call(offer)


@contextmanager
def sharing_all() -> Iterator[None]:
    """Share even the smallest work, to compile or load the kernels for sharing."""
    least, Team.least = Team.least, 0
    try:
        yield
    finally:
        Team.least = least


def load_helpers() -> None:
    """Load the kernel in which helpers wait; a run loads it when it first shares work."""
    if not PLAIN:
        _look(np.zeros(WORDS, dtype=np.int64), OFFER, 0)
