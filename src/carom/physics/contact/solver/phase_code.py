"""The machine code of the solver's phases, by address.

Each phase is a kernel ``(first, end, system)``, which processes the pieces [first, end). The kernels that lead a job
call phases by address. This shortens compilation: each phase is compiled separately, only if a scene needs it, and by
the first process that needs it. Calls by name would compile all phases into the caller, which takes a second per phase
because the arrays of a `ConstraintSystem` are passed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

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
    SCALE_BACK,
    SOLVE,
    WARM_START,
    ConstraintSystem,
)
from carom.physics.contact.solver.audit import audit, scale_back
from carom.physics.contact.solver.impacts import resolve_impacts
from carom.physics.contact.solver.positions import correct_positions
from carom.physics.contact.solver.prepare import prepare, warm_start
from carom.physics.contact.solver.refine import (
    conjugate_direction,
    conjugate_step,
    extrapolate,
    line_search,
    measure_violation,
    project,
)
from carom.physics.contact.solver.solve import solve_straight, solve_turning
from carom.physics.jit.decorators import layout_of
from carom.physics.jit.task import CODE, code_for, kind_for

Phase = Callable[[int, int, ConstraintSystem], None]

POSITIONS, IMPACTS, RESTING = range(3)  # jobs
PHASES: dict[int, dict[int, Phase]] = {  # phases of each job
    POSITIONS: {CORRECT_POSITIONS: correct_positions},
    IMPACTS: {RESOLVE_IMPACTS: resolve_impacts},
    RESTING: {
        PREPARE: prepare,
        WARM_START: warm_start,
        SOLVE: solve_turning,
        LINE_SEARCH: line_search,
        EXTRAPOLATE: extrapolate,
        MEASURE_VIOLATION: measure_violation,
        CONJUGATE_STEP: conjugate_step,
        CONJUGATE_DIRECTION: conjugate_direction,
        PROJECT: project,
        SCALE_BACK: scale_back,
        AUDIT: audit,
    },
}


class PhaseCode:
    """Addresses of the phases, for systems of one kind.

    Parameters
    ----------
    spins
        Whether impulses exert torques.
    """

    def __init__(self, spins: bool) -> None:
        self.addresses = np.zeros(sum(map(len, PHASES.values())), dtype=CODE)  # addresses of the code, by phase
        self.kind = 0  # kind of the systems; see `kind_of`
        self._spins = spins
        self._ready: set[int] = set()

    def is_ready(self, jobs: Iterable[int]) -> bool:
        """Return whether the phases of some jobs are compiled."""
        return self._ready.issuperset(jobs)

    def require(self, job: int, system: ConstraintSystem) -> None:
        """Compile or load the phases of a job, unless they are ready."""
        if job not in self._ready:
            self._compile(job, PHASES[job], system)

    def compile_ahead(self, job: int, system: ConstraintSystem) -> None:
        """Compile the phases of a job in reverse order, so that another process may begin with the first phase."""
        self._compile(job, reversed(PHASES[job]), system)

    def _compile(self, job: int, phases: Iterable[int], system: ConstraintSystem) -> None:
        self.kind = _kind(system)
        for phase in phases:
            kernel = solve_straight if phase == SOLVE and not self._spins else PHASES[job][phase]
            self.addresses[phase] = _address(kernel, self.kind, system)
        self._ready.add(job)


_addresses: dict[tuple[Phase, int], Any] = {}
_kinds: dict[tuple[Any, ...], int] = {}


def _address(kernel: Phase, kind: int, system: ConstraintSystem) -> Any:
    """Return the address of a kernel's code, looked up only once: Numba takes milliseconds, as a short run does."""
    if (kernel, kind) not in _addresses:
        _addresses[kernel, kind] = code_for(kernel, system)
    return _addresses[kernel, kind]


def _kind(system: ConstraintSystem) -> int:
    """Return the kind of a system, which the layouts of its arrays determine."""
    layout = layout_of(system)
    if layout not in _kinds:
        _kinds[layout] = kind_for(system)
    return _kinds[layout]
