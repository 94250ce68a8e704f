"""The phases of the contact solver are called by the addresses of their code."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
import pytest

from carom.physics.contact.constraints import PREPARE, ConstraintSystem
from carom.physics.contact.solver import contact_solver, phase_code
from carom.physics.contact.solver.contact_solver import ContactSolver
from carom.physics.contact.solver.phase_code import PHASES
from carom.physics.jit.task import code_for
from carom.physics.jit.vectors import WIDTH
from carom.physics.space import Space
from carom.runs.warmup import SCENES
from carom.scene.load import Scene

PILE = {"title": "a pile", **SCENES["a pile, recorded"]}


@numba.njit(error_model="numpy")
def fail(piece: int, end: int, system: ConstraintSystem) -> None:
    raise ValueError("in piece", piece)


def solver_of(space: Space) -> ContactSolver:
    assert space._contact is not None
    return space._contact.solver


def test_each_phase_has_a_place_of_its_own_for_its_address() -> None:
    phases = [phase for of_job in PHASES.values() for phase in of_job]
    assert sorted(phases) == list(range(len(phases)))


@pytest.mark.parametrize("threads", [1, 2])
def test_an_exception_in_a_phase_reaches_whoever_takes_the_step(threads: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(contact_solver, "SHARED_FROM", 0)
    space = Space(Scene.from_dict(PILE), threads=threads)
    solver = solver_of(space)
    solver.code.addresses[PREPARE] = code_for(fail, solver._system)
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
    solver.code.kind += 1
    with pytest.raises(TypeError, match="systems of another kind"):
        solver.resolve_impacts(0.0, 1, False)


ROLLS = {"law": "rolling_resistance", "rolling_resistance": {"rolling_friction": 0.1, "twisting_friction": 0.05}}


@pytest.mark.parametrize(
    "static, kinetic, law",
    [(0.6, 0.3, {}), (0.0, 0.0, {}), pytest.param(0.6, 0.3, ROLLS, marks=pytest.mark.slow)],  # other kernels
)
def test_contacts_solved_in_blocks_have_the_bits_of_those_solved_one_by_one(
    static: float, kinetic: float, law: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    heap = Scene.from_dict(
        {
            "seed": 3,
            "group": [
                {
                    "count": 60,
                    "radius": {"min": 0.1, "max": 0.2},
                    "region": {"shape": "box", "size": [1.8, 1.8, 1.6], "centre": [0.0, 0.0, 0.6]},
                }
            ],
            "body": [{"fixed": True, "radius": 0.35, "position": [0.0, 0.0, -1.1]}],
            "domain": {"boundary": "walls", "size": [2.0, 2.0, 3.0]},
            "gravity": {"constant": 0.0, "uniform": [0.0, 0.0, -9.81]},
            "contact": {"static_friction": static, "kinetic_friction": kinetic, **law},
            "time": {"duration": 1.0, "fixed_dt": 0.01},
        }
    )

    def run() -> tuple[Any, int]:
        space = Space(heap, threads=1)
        largest = 0
        for step in range(80):
            space.compute_dynamics(step + 1)
            order = solver_of(space).order
            largest = max(largest, *np.diff(order.pieces).ravel(), 0) if len(order.pieces) else largest
        return space.fingerprint(), largest

    in_blocks, largest = run()
    lay = ContactSolver.lay

    def lay_as_if_bodies_were_shared(solver: ContactSolver, *given: Any) -> None:
        lay(solver, *given)
        solver._settings["independent"] = 0

    monkeypatch.setattr(ContactSolver, "lay", lay_as_if_bodies_were_shared)
    assert run()[0] == in_blocks
    assert largest > 2 * WIDTH  # contacts of a colour: whole blocks, and rests of them
