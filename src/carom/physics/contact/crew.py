"""How the contacts of a step are resolved: who does what, phase after phase.

A phase is cut into pieces. Those of one stage are independent and are shared by a team of threads; stages follow each
other. Each piece finds what it finds for itself, and the leader puts that together in the order of the pieces: the same
bits on any number of threads. A phase of one piece, and the last stage, where contacts share bodies, is the leader's.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from carom.physics.contact.booking import book
from carom.physics.contact.conjugate_gradients import descend, measure, project, spread
from carom.physics.contact.load import (
    AIM,
    ALPHA,
    BEGIN,
    BETA,
    BOOK,
    CHANGE,
    CLOSING,
    DESCEND,
    FARTHEST,
    FIRST,
    GO,
    MEASURE,
    NEGLIGIBLE,
    PHASE,
    PRESS,
    PROJECT,
    PULL_MOST,
    PUSH,
    PUSH_MOST,
    REFINES,
    RELAX,
    SPINS,
    SPREAD,
    STRIKE,
    SWEEP,
    TOLERANCE,
    Load,
)
from carom.physics.contact.overshoot import scale_back
from carom.physics.contact.solver import CONVERGED, strike
from carom.physics.contact.stabilisation import push
from carom.physics.contact.sweep import HELD, aim, begin, go, press, relax
from carom.physics.parallel.jit import inline, inner, long_kernel
from carom.physics.parallel.thread_team import (
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
ROUNDS = 20  # of conjugate gradients, at most
ITERATIONS = 100  # of them in a round, at most
BAD_ENOUGH = 10.0  # times what is tolerated: what begins with less is left as it is
WORTH = 0.5  # of what was missed before; a round that leaves more is the last
SOLVED = 1e-3


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
    pieces = len(load.pieces)
    _share(board, load, BEGIN, 0, pieces, True)
    largest = _largest(load)
    _share_stages(board, edges, independent, load, PRESS)
    load.numbers[ALPHA], load.numbers[NEGLIGIBLE] = 0.0, HELD * largest
    sweeps, change = 0, np.inf
    while sweeps < most_sweeps and change > HELD * largest:
        change = _sweep(board, edges, independent, load, sweeps > 0)
        sweeps += 1
    if change > HELD * largest and load.flags[REFINES] != 0:
        sweeps += _refine(board, edges, independent, load)
    if change > HELD * largest:
        ends = (load.velocity, load.spin, load.island, load.work)
        scale_back(load.pairs, load.hot, load.cold, load.motion, load.who, *ends)
    _share(board, load, BOOK, 0, pieces, True)
    return sweeps


@inner
def _sweep(board: IntArray, edges: IntArray, independent: int, load: Load, again: bool) -> float:
    """Take each contact to where it neither closes nor pulls; go farther in the direction of the sweep before."""
    if again:
        blocks = len(load.sums)
        _share(board, load, AIM, 0, blocks, True)
        load.numbers[ALPHA] = _step(load)
        _share(board, load, GO, 0, blocks, True)
    _share_stages(board, edges, independent, load, RELAX)
    return _largest(load)


@inner
def _refine(board: IntArray, edges: IntArray, independent: int, load: Load) -> int:
    """Solve for the contacts that carry a load, until none misses its condition by more than is tolerated."""
    pieces, passes, rounds = len(load.pieces), 0, 0
    load.numbers[TOLERANCE] = BAD_ENOUGH
    _share(board, load, MEASURE, 0, pieces, True)
    load.numbers[TOLERANCE] = 1.0
    before, missed = np.inf, _largest(load)
    while rounds < ROUNDS and 0.0 < missed < WORTH * before:
        passes += _descend(board, edges, independent, load)
        _sweep(board, edges, independent, load, True)
        _sweep(board, edges, independent, load, True)
        passes += 2
        rounds += 1
        _share(board, load, MEASURE, 0, pieces, True)
        before, missed = missed, _largest(load)
    return passes


@inner
def _descend(board: IntArray, edges: IntArray, independent: int, load: Load) -> int:
    """Find what to change of the impulses that are free, by conjugate gradients; return the number of iterations."""
    pieces, numbers = len(load.pieces), load.numbers
    numbers[BETA] = 0.0
    _forget_changes(board, load)
    load.flags[SWEEP] = 0
    _share(board, load, DESCEND, 0, pieces, True)
    first = rho = _total(load)
    iterations = 0
    while rho > SOLVED * first and iterations < ITERATIONS:
        _share_stages(board, edges, independent, load, SPREAD)
        _share(board, load, AIM, 0, len(load.sums), True)
        curvature = 0.0
        for k in range(len(load.sums)):
            curvature += load.sums[k, 1]
        if not curvature > 0.0:
            break
        iterations += 1
        numbers[ALPHA], load.flags[SWEEP] = rho / curvature, iterations
        _share(board, load, DESCEND, 0, pieces, True)
        before, rho = rho, _total(load)
        numbers[BETA] = rho / before
        push, pull = 0.0, 0.0
        for k in range(pieces):
            push, pull = max(push, load.found[k, PUSH_MOST]), max(pull, load.found[k, PULL_MOST])
        _forget_changes(board, load)
        if pull > push:  # a residual that no impulse can remove makes them grow without end
            break
    _share_stages(board, edges, independent, load, PROJECT)
    return iterations


@inner
def _forget_changes(board: IntArray, load: Load) -> None:
    """Begin to sum up anew what changes of the velocities."""
    load.numbers[ALPHA] = 0.0
    _share(board, load, GO, 0, len(load.sums), True)


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
        elif phase == MEASURE:
            measure(lo, hi, k, pairs, C, cold, V, law, found, flags, numbers)
        elif phase == DESCEND:
            descend(lo, hi, k, pairs, C, load.search, V, law, found, flags, numbers)
        elif phase == SPREAD:
            spread(lo, hi, pairs, C, load.search, V, flags, numbers)
        elif phase == PROJECT:
            project(lo, hi, k, pairs, C, load.search, V, found, flags)


@inner
def _largest(load: Load) -> float:
    largest = 0.0
    for k in range(len(load.pieces)):
        largest = max(largest, load.found[k, CHANGE])
    return largest


@inner
def _total(load: Load) -> float:
    total = 0.0
    for k in range(len(load.pieces)):
        total += load.found[k, CHANGE]
    return total


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
