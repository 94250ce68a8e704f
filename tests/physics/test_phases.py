"""The phases of the contact solver are called by the addresses of their code."""

from __future__ import annotations

import numba
import pytest

from carom.experiment.warmup import SCENES
from carom.physics.contact.constraints import PREPARE, ConstraintSystem
from carom.physics.contact.solver import contact_solver, phase_code
from carom.physics.contact.solver.contact_solver import ContactSolver
from carom.physics.contact.solver.phase_code import PHASES
from carom.physics.parallel.task import code_for
from carom.physics.space import Space
from carom.scene.schema import Scene

PILE = {"title": "a pile", **SCENES["a pile, recorded"]}


@numba.njit(error_model="numpy")
def fail(piece: int, end: int, system: ConstraintSystem) -> None:
    raise ValueError("in piece", piece)


def solver_of(space: Space) -> ContactSolver:
    assert space._contact is not None
    return space._contact._solver


def test_each_phase_has_a_place_of_its_own_for_its_address() -> None:
    phases = [phase for of_job in PHASES.values() for phase in of_job]
    assert sorted(phases) == list(range(len(phases)))


@pytest.mark.parametrize("threads", [1, 2])
def test_an_exception_in_a_phase_reaches_whoever_takes_the_step(threads: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(contact_solver, "SHARED_FROM", 0)
    space = Space(Scene.from_dict(PILE), threads=threads)
    solver = solver_of(space)
    solver._code.addresses[PREPARE] = code_for(fail, solver._system)
    with pytest.raises(ValueError, match="in piece"):
        for step in range(1000):
            space.compute_dynamics(step + 1)


def test_another_space_does_not_ask_numba_for_the_phases_again(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*arguments: object) -> int:
        raise AssertionError("25 ms for each space")

    Space(Scene.from_dict(PILE), threads=1)
    monkeypatch.setattr(phase_code, "code_for", refuse)
    monkeypatch.setattr(phase_code, "kind_for", refuse)
    Space(Scene.from_dict(PILE), threads=1).compute_dynamics(1)


def test_code_for_systems_of_another_kind_is_not_called() -> None:
    solver = solver_of(Space(Scene.from_dict(PILE), threads=1))
    solver._code.kind += 1
    with pytest.raises(TypeError, match="systems of another kind"):
        solver.resolve_impacts(0.0, 1, False)
