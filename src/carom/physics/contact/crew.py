"""How the contacts of a step are resolved: who does what, phase after phase.

A phase is cut into pieces. Those of one stage are independent and are shared by a team of threads; stages follow each
other. Each piece finds what it finds for itself, and the leader puts that together in the order of the pieces: the same
bits on any number of threads. A phase of one piece, and the last stage, where contacts share bodies, is the leader's.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from carom.physics.contact.booking import book
from carom.physics.contact.load import (
    AIM,
    ALPHA,
    BEGIN,
    BOOK,
    CHANGE,
    CLOSING,
    FARTHEST,
    FIRST,
    GO,
    PHASE,
    PRESS,
    PUSH,
    RELAX,
    SPINS,
    STRIKE,
    SWEEP,
    Load,
)
from carom.physics.contact.solver import CONVERGED, strike
from carom.physics.contact.stabilisation import push
from carom.physics.contact.sweep import HELD, aim, begin, go, press, relax
from carom.physics.kernel import inline, inner, long_kernel
from carom.physics.team import (
    END,
    PATIENCE,
    REST,
    SHIFT,
    YIELD,
    claim,
    dismiss,
    finish,
    is_over,
    last_piece,
    post,
    wait,
)

IntArray = NDArray[np.int64]

PUSHES, IMPACTS, HOLDING, HELP = range(4)  # jobs


@long_kernel
def work(board: IntArray, job: int, edges: IntArray, independent: int, load: Load, most_sweeps: int) -> int:
    """Lead a job, or help with whatever is on the board; one kernel, since each takes seconds to compile.

    Returns
    -------
    sweeps
        How many there were; of `HELP`, when to call again: `END`, `YIELD` or `REST`.
    """
    if job == HELP:
        return _help_out(board, load)
    if job == PUSHES:
        sweeps = _push_apart(board, edges, independent, load, most_sweeps)
    elif job == IMPACTS:
        sweeps = _resolve_impacts(board, edges, independent, load, most_sweeps)
    else:
        sweeps = _hold(board, edges, independent, load, most_sweeps)
    dismiss(board)
    return sweeps


@inline
def _help_out(board: IntArray, load: Load) -> int:
    """Do pieces until the leader is done; return early where there are none for a while, or after many."""
    idle, done = 0, 0
    while not is_over(board):
        if claim(board):
            _do(load, load.flags[FIRST] + last_piece(board))
            finish(board)
            idle = 0
            done += 1
            if done == SHIFT:
                return YIELD
        else:
            idle += 1
            if idle == PATIENCE:
                return REST
    return END


@inline
def _push_apart(board: IntArray, edges: IntArray, independent: int, load: Load, most_sweeps: int) -> int:
    """Push contacts at rest apart in sweeps, until nothing overlaps."""
    sweeps, again = 0, 1.0
    while sweeps < most_sweeps and again > 0.0:
        _share_stages(board, edges, independent, load, PUSH)
        again = _largest(load)
        sweeps += 1
    return sweeps


@inline
def _resolve_impacts(board: IntArray, edges: IntArray, independent: int, load: Load, most_sweeps: int) -> int:
    """Resolve impacts in sweeps, until one of them changes next to nothing."""
    sweeps, first_change, change = 0, 0.0, 1.0
    while sweeps < most_sweeps and (sweeps == 0 or change > CONVERGED * first_change):
        load.flags[SWEEP] = sweeps
        _share_stages(board, edges, independent, load, STRIKE)
        change = _largest(load)
        if sweeps == 0:
            first_change = change
        sweeps += 1
    return sweeps


@inline
def _hold(board: IntArray, edges: IntArray, independent: int, load: Load, most_sweeps: int) -> int:
    """Find the impulses of contacts that last, beginning with those given, and book them."""
    pieces, blocks = len(load.pieces), len(load.sums)
    _share(board, load, BEGIN, 0, pieces, True)
    largest = _largest(load)
    _share_stages(board, edges, independent, load, PRESS)
    load.numbers[ALPHA] = 0.0
    sweeps, change = 0, np.inf
    while sweeps < most_sweeps and change > HELD * largest:
        if sweeps > 0:
            _share(board, load, AIM, 0, blocks, True)
            load.numbers[ALPHA] = _step(load)
            _share(board, load, GO, 0, blocks, True)
        _share_stages(board, edges, independent, load, RELAX)
        change = _largest(load)
        sweeps += 1
    _share(board, load, BOOK, 0, pieces, True)
    return sweeps


@inline
def _share_stages(board: IntArray, edges: IntArray, independent: int, load: Load, phase: int) -> None:
    """Do a phase stage by stage."""
    for stage in range(len(edges) - 1):
        _share(board, load, phase, edges[stage], edges[stage + 1], stage < independent)


@inline
def _share(board: IntArray, load: Load, phase: int, first: int, end: int, independent: bool) -> None:
    """Do the pieces of a phase, with the team if they are independent."""
    load.flags[PHASE], load.flags[FIRST] = phase, first
    k = load.flags[FIRST]  # not the literal 0 that it may be, for which Numba would compile all pieces again
    if len(board) == 0 or end - first == 1 or not independent:
        while k < end:
            _do(load, k)
            k += 1
    else:
        post(board, end - first)
        while claim(board):
            _do(load, k)
            finish(board)
            k += 1
        wait(board, end - first)


@inner
def _do(load: Load, k: int) -> None:
    """Do one piece."""
    pairs, C, cold, V, who = load.pairs, load.hot, load.cold, load.motion, load.who
    law, found, flags, numbers = load.law, load.found, load.flags, load.numbers
    phase = flags[PHASE]
    if phase == AIM:
        aim(k, V, who, load.sums, flags)
    elif phase == GO:
        go(k, V, who, flags, numbers[ALPHA])
    else:
        lo, hi = load.pieces[k, 0], load.pieces[k, 1]
        if phase == PUSH:
            ends = (load.position, load.velocity, load.inverse_mass, load.radius, load.box, load.surface, load.offset)
            push(lo, hi, k, pairs, *ends, law, cold, found)
        elif phase == STRIKE:
            strike(lo, hi, k, pairs, C, cold, load.acceleration, V, law, found, flags, numbers)
        elif phase == BEGIN:
            begin(lo, hi, k, pairs, C, cold, V, found, flags, numbers)
        elif phase == PRESS:
            press(lo, hi, pairs, C, V, flags)
        elif phase == RELAX:
            if flags[SPINS] != 0:
                relax(lo, hi, k, pairs, C, V, law, found, flags, numbers, (1,))
            else:
                relax(lo, hi, k, pairs, C, V, law, found, flags, numbers, ())
        elif phase == BOOK:
            book(lo, hi, k, pairs, C, cold, load.acceleration, V, found, flags, numbers)


@inner
def _largest(load: Load) -> float:
    largest = 0.0
    for k in range(len(load.pieces)):
        largest = max(largest, load.found[k, CHANGE])
    return largest


@inner
def _step(load: Load) -> float:
    """Return how many times over what a sweep changed should be changed again: α, or 0 where that would not help."""
    slope, curvature, farthest = 0.0, 0.0, np.inf
    for k in range(len(load.pieces)):
        slope += load.found[k, CLOSING]
        farthest = min(farthest, load.found[k, FARTHEST])
    for k in range(len(load.sums)):
        slope += load.sums[k, 0]
        curvature += load.sums[k, 1]
    if slope >= 0.0 or curvature <= 0.0:
        return 0.0
    return min(-slope / curvature, farthest)
