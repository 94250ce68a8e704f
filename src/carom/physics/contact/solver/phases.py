"""The order of the solver's phases, and how threads share the work.

The contacts of a phase are divided into pieces. The pieces of one colour are independent, so a team of threads shares
them; colours are processed one after another. Each piece writes its results into its own record, and the leader
combines them in the order of the pieces. The bits therefore do not depend on the number of threads. The leader alone
processes phases of one piece, and the last colour, in which contacts share bodies.

A single thread processes all pieces of a phase in one call.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from carom.arrays import IntArray, RecordArray
from carom.physics.contact.constraints import (
    AUDIT,
    CONJUGATE_DIRECTION,
    CONJUGATE_STEP,
    CORRECT_POSITIONS,
    ENOUGH,
    EXTRAPOLATE,
    LINE_SEARCH,
    MEASURE_VIOLATION,
    PREPARE,
    PROJECT,
    RESOLVE_IMPACTS,
    SCALE_BACK,
    SOLVE,
    WARM_START,
    ConstraintSystem,
)
from carom.physics.contact.records import BlockSumsRecord, PieceResultsRecord, SettingsRecord
from carom.physics.contact.solver.impacts import CONVERGED
from carom.physics.contact.solver.phase_code import IMPACTS, POSITIONS
from carom.physics.contact.solver.refine import INTOLERABLE, step_length
from carom.physics.contact.solver.solve import HOLD_CONVERGED
from carom.physics.jit.by_address import by_address
from carom.physics.jit.decorators import inline, inner, long_kernel
from carom.physics.jit.task import assign, do, kind_of, lay_out, leading, led, raise_fault
from carom.physics.jit.team import lead_phase

MAX_ROUNDS = 20  # largest number of rounds of conjugate gradients
MAX_ITERATIONS = 100  # largest number of iterations in a round
# Largest number of iterations in a round for meshed islands, which need not converge. Where grains flow, gaps and
# sliding make the equations contradict each other. In a drum, 85 iterations leave the same overlaps and closing speeds
# as 8; without any round, overlaps are twice as deep.
MAX_MESHED_ITERATIONS = 8
MAX_FURTHER_ITERATIONS = 256  # largest number of Gauss–Seidel iterations after the last round
# After this many iterations, a contact of a meshed island counts as unsolved only if it closes faster than its load
# speed. At such speeds, a run would warn. With 8, a falling heap of 1000 is computed 1.2 times as fast, but takes
# longer to settle. Rejected, since overlaps stay the same: continuing as long as 16 iterations halve the violation,
# which takes 1.3 times as long; continuing in heaps that hardly move.
MAX_MESHED_FURTHER = 16
GROWN = 1e6  # growth of the largest impulse in a search; more growth shows that there is no solution
MOST_LEFT = 0.5  # fraction of the previous violation; a round that leaves more than this is the last round
SOLVED = 1e-3  # fraction of a round's first r·z at which its iterations end, for contacts that are to converge


class Phases(NamedTuple):
    """The data of the leader: the code of the phases, and the arrays that it uses between phases."""

    addresses: IntArray  # addresses of the code, by phase
    doer: int  # address of the function that processes a piece of a task
    task: int  # address of the task: a phase's code and the system, see `lay_out`
    edges: IntArray  # this field and the following ones are fields of `ConstraintSystem`
    piece_results: RecordArray[PieceResultsRecord]
    sums: RecordArray[BlockSumsRecord]
    settings: RecordArray[SettingsRecord]


@leading(long_kernel)
def work(
    board: IntArray, job: int, addresses: IntArray, kind: int, system: ConstraintSystem, max_iterations: int
) -> int:
    """Run a job for a caller in Python; arguments and result as for `run_job`."""
    return run_job(board, job, addresses, kind, by_address(system), max_iterations)


@leading(inner)
def run_job(
    board: IntArray, job: int, addresses: IntArray, kind: int, system: ConstraintSystem, max_iterations: int
) -> int:
    """Run a job; return the number of iterations.

    Parameters
    ----------
    board
        The lock words of the team; empty if the leader works alone.
    job
        `POSITIONS`, `IMPACTS` or `RESTING`.
    addresses, kind
        Addresses of the phases' code, and the kind of the systems that it is compiled for; see `PhaseCode`.
    system
        The contacts, passed by address.
    """
    if kind != kind_of((system,)):
        raise TypeError("the phases are compiled for systems of another kind")
    doer, task = lay_out(0, 1, 1, (system,))  # piece k is the range [k, k + 1)
    results, sums, settings = led(system.piece_results), led(system.sums), led(system.settings)
    phases = Phases(addresses, doer, task, system.edges, results, sums, settings)
    if job == POSITIONS:
        return _correct_positions(board, phases, max_iterations)
    if job == IMPACTS:
        return _resolve_impacts(board, phases, max_iterations)
    return _hold(board, phases, max_iterations)


@leading(inline)
def _correct_positions(board: IntArray, phases: Phases, max_iterations: int) -> int:
    """Push resting contacts apart until they no longer overlap."""
    iterations, again = 0, 1.0
    while iterations < max_iterations and again > 0.0:
        phases.settings[0].iteration = iterations
        _share_colours(board, phases, CORRECT_POSITIONS)
        again = _largest_residual(phases)
        iterations += 1
    return iterations


@leading(inline)
def _resolve_impacts(board: IntArray, phases: Phases, max_iterations: int) -> int:
    """Resolve impacts until an iteration changes velocities by less than `CONVERGED` times the first change."""
    iterations, first_change, change = 0, 0.0, 1.0
    while iterations < max_iterations and (iterations == 0 or change > CONVERGED * first_change):
        phases.settings[0].iteration = iterations
        _share_colours(board, phases, RESOLVE_IMPACTS)
        change = _largest_residual(phases)
        if iterations == 0:
            first_change = change
        iterations += 1
    _sum_up_approaches(phases)
    return iterations


@leading(inline)
def _sum_up_approaches(phases: Phases) -> None:
    """Record the fastest approach of all pieces, and whether a contact is at rest."""
    fastest, any_rests = 0.0, False
    for k in range(len(phases.piece_results)):
        results = phases.piece_results[k]
        fastest, any_rests = max(fastest, results.fastest), any_rests or results.any_rests
    phases.settings[0].fastest, phases.settings[0].any_rests = fastest, any_rests


@leading(inline)
def _hold(board: IntArray, phases: Phases, max_iterations: int) -> int:
    """Find the impulses of resting contacts, starting from the impulses in the records, and book their energies."""
    pieces, settings = len(phases.piece_results), phases.settings[0]
    _share(board, phases, PREPARE, 0, pieces, True)
    largest = _largest_residual(phases)
    _share_colours(board, phases, WARM_START)
    settings.alpha, settings.negligible = 0.0, HOLD_CONVERGED * largest
    settings.slides_above = ENOUGH if settings.slides_meshed else np.inf
    iterations, change = 0, np.inf
    while iterations < max_iterations and change > HOLD_CONVERGED * largest:
        change = _iterate(board, phases, iterations > 0)
        iterations += 1
    if change > HOLD_CONVERGED * largest and settings.refines:
        iterations += _refine(board, phases)
    settings.measures, settings.scaled_back = change > HOLD_CONVERGED * largest, False
    _share(board, phases, AUDIT, 0, pieces, True)
    if settings.measures:
        _share(board, phases, SCALE_BACK, 0, 1, False)
        settings.measures = False
    if settings.scaled_back:
        _share(board, phases, AUDIT, 0, pieces, True)
    return iterations


@leading(inner)
def _iterate(board: IntArray, phases: Phases, again: bool) -> float:
    """Solve each contact once; if ``again``, extrapolate the previous iteration first."""
    if again:
        blocks = len(phases.sums)
        _share(board, phases, LINE_SEARCH, 0, blocks, True)
        phases.settings[0].alpha = step_length(phases.piece_results, phases.sums)
        _share(board, phases, EXTRAPOLATE, 0, blocks, True)
    _share_colours(board, phases, SOLVE)
    return _largest_residual(phases)


@leading(inner)
def _refine(board: IntArray, phases: Phases) -> int:
    """Solve for all loaded contacts together, until each is within its tolerance."""
    pieces, passes, rounds = len(phases.piece_results), 0, 0
    phases.settings[0].tolerance = INTOLERABLE
    _share(board, phases, MEASURE_VIOLATION, 0, pieces, True)
    phases.settings[0].tolerance = 1.0
    before, missed = np.inf, _largest_residual(phases)
    while rounds < MAX_ROUNDS and 0.0 < missed < MOST_LEFT * before:
        passes += _conjugate_gradients(board, phases)
        _iterate(board, phases, True)
        _iterate(board, phases, True)
        passes += 2
        rounds += 1
        _share(board, phases, MEASURE_VIOLATION, 0, pieces, True)
        before, missed = missed, _largest_residual(phases)
    return passes + _iterate_on(board, phases) if missed > 0.0 and phases.settings[0].keeps_iterating else passes


@leading(inner)
def _iterate_on(board: IntArray, phases: Phases) -> int:
    """Continue to iterate if conjugate gradients did not converge; return the number of iterations.

    If kinetic friction is less than static friction, contacts may alternate between sticking and sliding without end.
    In these iterations, a contact that has slid since the kick keeps sliding; in meshed islands, it keeps sliding in
    all iterations.
    """
    pieces, settings, iterations = len(phases.piece_results), phases.settings[0], 0
    settings.slides_above, settings.tolerance = 0.0, INTOLERABLE
    settings.ignores_meshed = settings.spares_meshed
    _share(board, phases, MEASURE_VIOLATION, 0, pieces, True)
    while _largest_residual(phases) > 0.0 and iterations < MAX_FURTHER_ITERATIONS:
        _iterate(board, phases, True)
        iterations += 1
        settings.is_lenient = settings.slides_meshed and iterations >= MAX_MESHED_FURTHER
        _share(board, phases, MEASURE_VIOLATION, 0, pieces, True)
    settings.ignores_meshed = settings.is_lenient = False
    return iterations


@leading(inner)
def _conjugate_gradients(board: IntArray, phases: Phases) -> int:
    """Find the change of the free impulses; return the number of iterations."""
    pieces, settings = len(phases.piece_results), phases.settings[0]
    settings.beta = 0.0
    _forget_changes(board, phases)
    settings.iteration = 0
    _share(board, phases, CONJUGATE_STEP, 0, pieces, True)
    first, first_exact = rho, exact = _residual_norms(phases)
    largest = _largest_impulses(phases)[0]
    iterations, push, pull = 0, 0.0, 0.0
    while (exact > SOLVED * first_exact or rho > settings.solved * first) and iterations < MAX_ITERATIONS:
        most = settings.meshed_iterations
        if most > 0 and rho > exact and (rho <= settings.solved * first or iterations >= most):
            if exact <= SOLVED * first_exact:
                break
            # islands share no moving body, so the search starts anew in the islands that are to converge
            settings.ignores_meshed, settings.beta, rho = True, 0.0, exact
        _share_colours(board, phases, CONJUGATE_DIRECTION)
        _share(board, phases, LINE_SEARCH, 0, len(phases.sums), True)
        curvature = 0.0
        for k in range(len(phases.sums)):
            curvature += phases.sums[k].curvature
        if not curvature > 0.0:
            break
        iterations += 1
        settings.alpha, settings.iteration = rho / curvature, iterations
        _share(board, phases, CONJUGATE_STEP, 0, pieces, True)
        before = rho
        rho, exact = _residual_norms(phases)
        settings.beta = rho / before
        push, pull = _largest_impulses(phases)
        _forget_changes(board, phases)
        if pull > push or push > GROWN * largest > 0.0:
            break
    settings.ignores_meshed = False
    if push > GROWN * largest > 0.0:  # the step has no solution: discard the change
        settings.iteration = 0
        _share(board, phases, CONJUGATE_STEP, 0, pieces, True)
    _share_colours(board, phases, PROJECT)
    return iterations


@leading(inline)
def _largest_impulses(phases: Phases) -> tuple[float, float]:
    """Return the largest repulsive and the largest attractive impulse in the last step of the search, in N s."""
    push, pull = 0.0, 0.0
    for k in range(len(phases.piece_results)):
        push, pull = max(push, phases.piece_results[k].largest_push), max(pull, phases.piece_results[k].largest_pull)
    return push, pull


@leading(inner)
def _forget_changes(board: IntArray, phases: Phases) -> None:
    """Clear the changes of the velocities."""
    phases.settings[0].alpha = 0.0
    _share(board, phases, EXTRAPOLATE, 0, len(phases.sums), True)


@leading(inner)
def _share_colours(board: IntArray, phases: Phases, phase: int) -> None:
    """Run a phase colour by colour."""
    edges, independent = phases.edges, phases.settings[0].independent
    if len(board) == 0:
        _share(board, phases, phase, edges[0], edges[len(edges) - 1], False)
        return
    for colour in range(len(edges) - 1):
        _share(board, phases, phase, edges[colour], edges[colour + 1], colour < independent)


@leading(inner)
def _share(board: IntArray, phases: Phases, phase: int, first: int, end: int, independent: bool) -> None:
    """Process the pieces of a phase, with the team if they are independent."""
    assign(phases.task, phases.addresses[phase])
    if end == first:
        return
    if len(board) == 0 or end - first == 1 or not independent:
        do(phases.doer, phases.task, first, end)
    else:
        lead_phase(board, phases.doer, phases.task, first, end - first)
    raise_fault(phases.task)


@leading(inner)
def _largest_residual(phases: Phases) -> float:
    largest = 0.0
    for k in range(len(phases.piece_results)):
        largest = max(largest, phases.piece_results[k].residual)
    return largest


@leading(inner)
def _residual_norms(phases: Phases) -> tuple[float, float]:
    """Return r·z of all contacts, and of the contacts that are to converge to rounding."""
    norm, exact_norm = 0.0, 0.0
    for k in range(len(phases.piece_results)):
        norm += phases.piece_results[k].residual_norm
        exact_norm += phases.piece_results[k].exact_norm
    return norm, exact_norm
