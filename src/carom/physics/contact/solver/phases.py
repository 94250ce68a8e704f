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
    ConstraintSystem,
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
from carom.physics.contact.solver.line_search import extrapolate, line_search, step_length
from carom.physics.contact.solver.position_correction import correct_positions
from carom.physics.contact.solver.prepare import prepare
from carom.physics.contact.solver.solve import HELD, solve
from carom.physics.contact.solver.warm_start import warm_start
from carom.physics.parallel.jit import compile_for, inline, inner, long_kernel
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
def work(board: IntArray, job: int, system: ConstraintSystem, max_iterations: int) -> int:
    """Lead a job, or help with whatever is on the board; one kernel, since each takes seconds to compile.

    Parameters
    ----------
    board
        Of the team; empty if the leader works alone.
    job
        `POSITIONS`, `IMPACTS`, `RESTING` or `HELP`.

    Returns
    -------
    iterations
        How many there were; of `HELP`, when to call again: `END`, `YIELD` or `REST`.
    """
    if job == HELP:
        return _help_out(board, system)
    if job == POSITIONS:
        iterations = _correct_positions(board, system, max_iterations)
    elif job == IMPACTS:
        iterations = _resolve_impacts(board, system, max_iterations)
    else:
        iterations = _hold(board, system, max_iterations)
    dismiss(board)
    return iterations


@inline
def _help_out(board: IntArray, system: ConstraintSystem) -> int:
    """Do pieces until the leader is done; return early where there are none for a while, or after many."""
    idle, done = 0, 0
    while not is_over(board):
        if claim(board):
            _do_piece(system, system.settings[0].first_piece + last_piece(board))
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
def _correct_positions(board: IntArray, system: ConstraintSystem, max_iterations: int) -> int:
    """Push contacts at rest apart, until nothing overlaps."""
    iterations, again = 0, 1.0
    while iterations < max_iterations and again > 0.0:
        _share_colours(board, system, CORRECT_POSITIONS)
        again = _largest_residual(system)
        iterations += 1
    return iterations


@inline
def _resolve_impacts(board: IntArray, system: ConstraintSystem, max_iterations: int) -> int:
    """Resolve impacts, until an iteration changes next to nothing."""
    iterations, first_change, change = 0, 0.0, 1.0
    while iterations < max_iterations and (iterations == 0 or change > CONVERGED * first_change):
        system.settings[0].iteration = iterations
        _share_colours(board, system, RESOLVE_IMPACTS)
        change = _largest_residual(system)
        if iterations == 0:
            first_change = change
        iterations += 1
    return iterations


@inline
def _hold(board: IntArray, system: ConstraintSystem, max_iterations: int) -> int:
    """Find the impulses of contacts that last, beginning with those given, and book them."""
    pieces, settings = len(system.pieces), system.settings[0]
    _share(board, system, PREPARE, 0, pieces, True)
    largest = _largest_residual(system)
    _share_colours(board, system, WARM_START)
    settings.alpha, settings.negligible = 0.0, HELD * largest
    iterations, change = 0, np.inf
    while iterations < max_iterations and change > HELD * largest:
        change = _iterate(board, system, iterations > 0)
        iterations += 1
    if change > HELD * largest and settings.refines:
        iterations += _refine(board, system)
    if change > HELD * largest:
        scale_back(system)
    _share(board, system, AUDIT, 0, pieces, True)
    return iterations


@inner
def _iterate(board: IntArray, system: ConstraintSystem, again: bool) -> float:
    """Take each contact to where it neither closes nor pulls; first go on in the direction of the iteration before."""
    if again:
        blocks = len(system.sums)
        _share(board, system, LINE_SEARCH, 0, blocks, True)
        system.settings[0].alpha = step_length(system)
        _share(board, system, EXTRAPOLATE, 0, blocks, True)
    _share_colours(board, system, SOLVE)
    return _largest_residual(system)


@inner
def _refine(board: IntArray, system: ConstraintSystem) -> int:
    """Solve for the contacts that carry a system, until none misses its condition by more than is tolerated."""
    pieces, passes, rounds = len(system.pieces), 0, 0
    system.settings[0].tolerance = BAD_ENOUGH
    _share(board, system, MEASURE_VIOLATION, 0, pieces, True)
    system.settings[0].tolerance = 1.0
    before, missed = np.inf, _largest_residual(system)
    while rounds < MAX_ROUNDS and 0.0 < missed < WORTH * before:
        passes += _conjugate_gradients(board, system)
        _iterate(board, system, True)
        _iterate(board, system, True)
        passes += 2
        rounds += 1
        _share(board, system, MEASURE_VIOLATION, 0, pieces, True)
        before, missed = missed, _largest_residual(system)
    return passes


@inner
def _conjugate_gradients(board: IntArray, system: ConstraintSystem) -> int:
    """Find what to change of the impulses that are free; return the number of iterations."""
    pieces, settings = len(system.pieces), system.settings[0]
    settings.beta = 0.0
    _forget_changes(board, system)
    settings.iteration = 0
    _share(board, system, CONJUGATE_STEP, 0, pieces, True)
    first = rho = _residual_norm(system)
    iterations = 0
    while rho > SOLVED * first and iterations < MAX_ITERATIONS:
        _share_colours(board, system, CONJUGATE_DIRECTION)
        _share(board, system, LINE_SEARCH, 0, len(system.sums), True)
        curvature = 0.0
        for k in range(len(system.sums)):
            curvature += system.sums[k].curvature
        if not curvature > 0.0:
            break
        iterations += 1
        settings.alpha, settings.iteration = rho / curvature, iterations
        _share(board, system, CONJUGATE_STEP, 0, pieces, True)
        before, rho = rho, _residual_norm(system)
        settings.beta = rho / before
        push, pull = 0.0, 0.0
        for k in range(pieces):
            push, pull = max(push, system.found[k].largest_push), max(pull, system.found[k].largest_pull)
        _forget_changes(board, system)
        if pull > push:  # a residual that no impulse can remove makes them grow without end
            break
    _share_colours(board, system, PROJECT)
    return iterations


@inner
def _forget_changes(board: IntArray, system: ConstraintSystem) -> None:
    """Begin to sum up anew what changes of the velocities."""
    system.settings[0].alpha = 0.0
    _share(board, system, EXTRAPOLATE, 0, len(system.sums), True)


@inner
def _share_colours(board: IntArray, system: ConstraintSystem, phase: int) -> None:
    """Do a phase colour by colour."""
    edges, independent = system.edges, system.settings[0].independent
    for colour in range(len(edges) - 1):
        _share(board, system, phase, edges[colour], edges[colour + 1], colour < independent)


@inner
def _share(board: IntArray, system: ConstraintSystem, phase: int, first: int, end: int, independent: bool) -> None:
    """Do the pieces of a phase, with the team if they are independent."""
    settings = system.settings[0]
    settings.phase, settings.first_piece = phase, first
    k = settings.first_piece  # not the literal 0 that it may be, for which Numba would compile all pieces again
    if len(board) == 0 or end - first == 1 or not independent:
        while k < end:
            _do_piece(system, k)
            k += 1
    else:
        post(board, end - first)
        while claim(board):
            _do_piece(system, k)
            finish(board)
            k += 1
        wait(board, end - first)


@inner
def _do_piece(system: ConstraintSystem, k: int) -> None:
    """Do one piece."""
    phase = system.settings[0].phase
    if phase == LINE_SEARCH:
        line_search(k, system)
    elif phase == EXTRAPOLATE:
        extrapolate(k, system)
    else:
        lo, hi = system.pieces[k, 0], system.pieces[k, 1]
        if phase == CORRECT_POSITIONS:
            correct_positions(lo, hi, k, system)
        elif phase == RESOLVE_IMPACTS:
            resolve_impacts(lo, hi, k, system)
        elif phase == PREPARE:
            prepare(lo, hi, k, system)
        elif phase == WARM_START:
            warm_start(lo, hi, system)
        elif phase == SOLVE:
            if system.settings[0].spins:
                solve(lo, hi, k, system, (1,))
            else:
                solve(lo, hi, k, system, ())
        elif phase == AUDIT:
            audit(lo, hi, k, system)
        elif phase == MEASURE_VIOLATION:
            measure_violation(lo, hi, k, system)
        elif phase == CONJUGATE_STEP:
            conjugate_step(lo, hi, k, system)
        elif phase == CONJUGATE_DIRECTION:
            conjugate_direction(lo, hi, system)
        elif phase == PROJECT:
            project(lo, hi, k, system)


def compile_phases(system: ConstraintSystem) -> None:
    """Compile the phases that `_do_piece` calls, the last first: another process may begin with the others."""
    compile_for(project, 0, 0, 0, system)
    compile_for(conjugate_direction, 0, 0, system)
    compile_for(conjugate_step, 0, 0, 0, system)
    compile_for(measure_violation, 0, 0, 0, system)
    compile_for(audit, 0, 0, 0, system)
    compile_for(solve, 0, 0, 0, system, ())
    compile_for(solve, 0, 0, 0, system, (1,))
    compile_for(warm_start, 0, 0, system)
    compile_for(scale_back, system)


@inner
def _largest_residual(system: ConstraintSystem) -> float:
    largest = 0.0
    for k in range(len(system.pieces)):
        largest = max(largest, system.found[k].residual)
    return largest


@inner
def _residual_norm(system: ConstraintSystem) -> float:
    norm = 0.0
    for k in range(len(system.pieces)):
        norm += system.found[k].residual_norm
    return norm
