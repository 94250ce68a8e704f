"""The solver's phases, and how threads share them.

A phase is cut into pieces of contacts. The pieces of one colour are independent and are shared by a team of threads;
colours follow each other. Each piece writes its findings into a record of its own, and the leader puts these together
in the order of the pieces: the same bits on any number of threads. The leader alone does a phase of one piece, and the
last colour, where contacts share bodies.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from carom.physics.contact.constraints import (
    AUDIT,
    CONJUGATE_DIRECTION,
    CONJUGATE_STEP,
    CORRECT_POSITIONS,
    EXTRAPOLATE,
    LINE_SEARCH,
    MEASURE_VIOLATION,
    PREPARE,
    PROJECT,
    RESOLVE_IMPACTS,
    SOLVE,
    WARM_START,
    Constraints,
)
from carom.physics.contact.solver.conjugate_gradients import (
    conjugate_direction,
    conjugate_step,
    measure_violation,
    project,
)
from carom.physics.contact.solver.energy_audit import audit
from carom.physics.contact.solver.energy_bound import scale_back
from carom.physics.contact.solver.impacts import CONVERGED, resolve_impacts
from carom.physics.contact.solver.position_correction import correct_positions
from carom.physics.contact.solver.solve import HELD, extrapolate, line_search, prepare, solve, warm_start
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

POSITIONS, IMPACTS, RESTING, HELP = range(4)  # jobs
MAX_ROUNDS = 20  # of conjugate gradients
MAX_ITERATIONS = 100  # of them in a round
BAD_ENOUGH = 10.0  # times what is tolerated: what begins with less is left as it is
WORTH = 0.5  # of what was missed before; a round that leaves more is the last
SOLVED = 1e-3  # of the first residual, squared and preconditioned


@long_kernel
def work(board: IntArray, job: int, edges: IntArray, independent: int, load: Constraints, max_iterations: int) -> int:
    """Lead a job, or help with whatever is on the board; one kernel, since each takes seconds to compile.

    Parameters
    ----------
    board
        Of the team; empty if the leader works alone.
    job
        `POSITIONS`, `IMPACTS`, `RESTING` or `HELP`.
    edges
        First piece of each colour, and the number of pieces.
    independent
        So many colours, from the first on, have no two contacts that share a body that moves.

    Returns
    -------
    iterations
        How many there were; of `HELP`, when to call again: `END`, `YIELD` or `REST`.
    """
    if job == HELP:
        return _help_out(board, load)
    if job == POSITIONS:
        iterations = _correct_positions(board, edges, independent, load, max_iterations)
    elif job == IMPACTS:
        iterations = _resolve_impacts(board, edges, independent, load, max_iterations)
    else:
        iterations = _hold(board, edges, independent, load, max_iterations)
    dismiss(board)
    return iterations


@inline
def _help_out(board: IntArray, load: Constraints) -> int:
    """Do pieces until the leader is done; return early where there are none for a while, or after many."""
    idle, done = 0, 0
    while not is_over(board):
        if claim(board):
            _do(load, load.settings[0].first_piece + last_piece(board))
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
def _correct_positions(
    board: IntArray, edges: IntArray, independent: int, load: Constraints, max_iterations: int
) -> int:
    """Push contacts at rest apart, until nothing overlaps."""
    iterations, again = 0, 1.0
    while iterations < max_iterations and again > 0.0:
        _share_colours(board, edges, independent, load, CORRECT_POSITIONS)
        again = _largest_residual(load)
        iterations += 1
    return iterations


@inline
def _resolve_impacts(board: IntArray, edges: IntArray, independent: int, load: Constraints, max_iterations: int) -> int:
    """Resolve impacts, until an iteration changes next to nothing."""
    iterations, first_change, change = 0, 0.0, 1.0
    while iterations < max_iterations and (iterations == 0 or change > CONVERGED * first_change):
        load.settings[0].iteration = iterations
        _share_colours(board, edges, independent, load, RESOLVE_IMPACTS)
        change = _largest_residual(load)
        if iterations == 0:
            first_change = change
        iterations += 1
    return iterations


@inline
def _hold(board: IntArray, edges: IntArray, independent: int, load: Constraints, max_iterations: int) -> int:
    """Find the impulses of contacts that last, beginning with those given, and book them."""
    pieces, settings = len(load.pieces), load.settings[0]
    _share(board, load, PREPARE, 0, pieces, True)
    largest = _largest_residual(load)
    _share_colours(board, edges, independent, load, WARM_START)
    settings.alpha, settings.negligible = 0.0, HELD * largest
    iterations, change = 0, np.inf
    while iterations < max_iterations and change > HELD * largest:
        change = _iterate(board, edges, independent, load, iterations > 0)
        iterations += 1
    if change > HELD * largest and settings.refines:
        iterations += _refine(board, edges, independent, load)
    if change > HELD * largest:
        scale_back(load)
    _share(board, load, AUDIT, 0, pieces, True)
    return iterations


@inner
def _iterate(board: IntArray, edges: IntArray, independent: int, load: Constraints, again: bool) -> float:
    """Take each contact to where it neither closes nor pulls; first go on in the direction of the iteration before."""
    if again:
        blocks = len(load.sums)
        _share(board, load, LINE_SEARCH, 0, blocks, True)
        load.settings[0].alpha = _step(load)
        _share(board, load, EXTRAPOLATE, 0, blocks, True)
    _share_colours(board, edges, independent, load, SOLVE)
    return _largest_residual(load)


@inner
def _refine(board: IntArray, edges: IntArray, independent: int, load: Constraints) -> int:
    """Solve for the contacts that carry a load, until none misses its condition by more than is tolerated."""
    pieces, passes, rounds = len(load.pieces), 0, 0
    load.settings[0].tolerance = BAD_ENOUGH
    _share(board, load, MEASURE_VIOLATION, 0, pieces, True)
    load.settings[0].tolerance = 1.0
    before, missed = np.inf, _largest_residual(load)
    while rounds < MAX_ROUNDS and 0.0 < missed < WORTH * before:
        passes += _conjugate_gradients(board, edges, independent, load)
        _iterate(board, edges, independent, load, True)
        _iterate(board, edges, independent, load, True)
        passes += 2
        rounds += 1
        _share(board, load, MEASURE_VIOLATION, 0, pieces, True)
        before, missed = missed, _largest_residual(load)
    return passes


@inner
def _conjugate_gradients(board: IntArray, edges: IntArray, independent: int, load: Constraints) -> int:
    """Find what to change of the impulses that are free; return the number of iterations."""
    pieces, settings = len(load.pieces), load.settings[0]
    settings.beta = 0.0
    _forget_changes(board, load)
    settings.iteration = 0
    _share(board, load, CONJUGATE_STEP, 0, pieces, True)
    first = rho = _residual_norm(load)
    iterations = 0
    while rho > SOLVED * first and iterations < MAX_ITERATIONS:
        _share_colours(board, edges, independent, load, CONJUGATE_DIRECTION)
        _share(board, load, LINE_SEARCH, 0, len(load.sums), True)
        curvature = 0.0
        for k in range(len(load.sums)):
            curvature += load.sums[k].curvature
        if not curvature > 0.0:
            break
        iterations += 1
        settings.alpha, settings.iteration = rho / curvature, iterations
        _share(board, load, CONJUGATE_STEP, 0, pieces, True)
        before, rho = rho, _residual_norm(load)
        settings.beta = rho / before
        push, pull = 0.0, 0.0
        for k in range(pieces):
            push, pull = max(push, load.found[k].largest_push), max(pull, load.found[k].largest_pull)
        _forget_changes(board, load)
        if pull > push:  # a residual that no impulse can remove makes them grow without end
            break
    _share_colours(board, edges, independent, load, PROJECT)
    return iterations


@inner
def _forget_changes(board: IntArray, load: Constraints) -> None:
    """Begin to sum up anew what changes of the velocities."""
    load.settings[0].alpha = 0.0
    _share(board, load, EXTRAPOLATE, 0, len(load.sums), True)


@inner
def _share_colours(board: IntArray, edges: IntArray, independent: int, load: Constraints, phase: int) -> None:
    """Do a phase colour by colour."""
    for colour in range(len(edges) - 1):
        _share(board, load, phase, edges[colour], edges[colour + 1], colour < independent)


@inner
def _share(board: IntArray, load: Constraints, phase: int, first: int, end: int, independent: bool) -> None:
    """Do the pieces of a phase, with the team if they are independent."""
    settings = load.settings[0]
    settings.phase, settings.first_piece = phase, first
    k = settings.first_piece  # not the literal 0 that it may be, for which Numba would compile all pieces again
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
def _do(load: Constraints, k: int) -> None:
    """Do one piece."""
    phase = load.settings[0].phase
    if phase == LINE_SEARCH:
        line_search(k, load)
    elif phase == EXTRAPOLATE:
        extrapolate(k, load)
    else:
        lo, hi = load.pieces[k, 0], load.pieces[k, 1]
        if phase == CORRECT_POSITIONS:
            correct_positions(lo, hi, k, load)
        elif phase == RESOLVE_IMPACTS:
            resolve_impacts(lo, hi, k, load)
        elif phase == PREPARE:
            prepare(lo, hi, k, load)
        elif phase == WARM_START:
            warm_start(lo, hi, load)
        elif phase == SOLVE:
            if load.settings[0].spins:
                solve(lo, hi, k, load, (1,))
            else:
                solve(lo, hi, k, load, ())
        elif phase == AUDIT:
            audit(lo, hi, k, load)
        elif phase == MEASURE_VIOLATION:
            measure_violation(lo, hi, k, load)
        elif phase == CONJUGATE_STEP:
            conjugate_step(lo, hi, k, load)
        elif phase == CONJUGATE_DIRECTION:
            conjugate_direction(lo, hi, load)
        elif phase == PROJECT:
            project(lo, hi, k, load)


@inner
def _largest_residual(load: Constraints) -> float:
    largest = 0.0
    for k in range(len(load.pieces)):
        largest = max(largest, load.found[k].residual)
    return largest


@inner
def _residual_norm(load: Constraints) -> float:
    norm = 0.0
    for k in range(len(load.pieces)):
        norm += load.found[k].residual_norm
    return norm


@inner
def _step(load: Constraints) -> float:
    """Return how many times over what an iteration changed should be changed again: α, or 0 if that would not help."""
    slope, curvature, step_limit = 0.0, 0.0, np.inf
    for k in range(len(load.pieces)):
        slope += load.found[k].slope
        step_limit = min(step_limit, load.found[k].step_limit)
    for k in range(len(load.sums)):
        slope += load.sums[k].slope
        curvature += load.sums[k].curvature
    if slope >= 0.0 or curvature <= 0.0:
        return 0.0
    return min(-slope / curvature, step_limit)
