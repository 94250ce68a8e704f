"""Threads share the work of a step: same bits for any number of them, and an exception of one reaches the caller."""

from __future__ import annotations

import threading
import time
from typing import Any

import numba
import numpy as np
import pytest
from numpy.typing import NDArray

from carom.physics.contact.broad_phase.grid import HierarchicalGrid
from carom.physics.contact.constraints import SHARED_FROM
from carom.physics.contact.near_pairs import PlaneSearch
from carom.physics.jit.instructions import atomic_load, atomic_store
from carom.physics.jit.team import Team, sharing_all
from carom.physics.space import Space
from carom.scene.start import HalfSpaces
from small_scenes import random_bodies, scene_of, solver_of

FloatArray = NDArray[np.float64]


def resolved(threads: int, hub: bool) -> tuple[FloatArray, ...]:
    """Resolve impacts in a crowd, then hold it; with a large body that touches hundreds, which takes a last stage."""
    bodies = random_bodies(15**3, 7)
    bodies.radius[:] = 1.0
    lattice = np.stack(np.meshgrid(*[np.arange(15.0)] * 3), axis=-1).reshape(-1, 3) * 1.95
    bodies.position[:] = np.random.default_rng(3).permutation(lattice)
    if hub:
        bodies.radius[0], bodies.position[0] = 10.0, 15.0
    pairs = HierarchicalGrid(bodies.radius, np.zeros(3)).pairs(bodies.position)
    assert len(pairs) > SHARED_FROM
    solver = solver_of(bodies, pairs, [0.5, 0.6, 0.4], threads=threads)
    sweeps = solver.resolve_impacts(0.0, 3, impacts_only=False)
    bodies.velocity[:, 2] -= bodies.position[:, 2]  # presses all of it together
    solver.rest_speed[:] = solver.load_speed[:] = 1e-3
    held = solver.hold(1.0, 1.0, 0.0, 0.0, 5)
    assert sweeps == 3 and held > 5, "conjugate gradients follow the sweeps"
    return bodies.velocity, bodies.angular_velocity, solver.ledger, solver.approach, solver.impulses


@pytest.mark.parametrize("hub", [False, True])
def test_any_number_of_threads_resolves_a_crowd_to_the_same_bits(hub: bool) -> None:
    alone = resolved(1, hub)
    assert np.abs(alone[4]).max() > 0.0
    for threads in (2, 4):
        for one, many in zip(alone, resolved(threads, hub), strict=True):
            assert np.array_equal(one, many)


@pytest.mark.parametrize("box", [0.0, 56.0])
def test_any_number_of_threads_finds_the_same_contacts(box: float) -> None:
    # More contacts than there is room for at first, and radii over a decade.
    rng = np.random.default_rng(5)
    n = 20_000
    position, radius = rng.uniform(-28.0, 28.0, (n, 3)), 10.0 ** rng.uniform(-1.0, 0.5, n)
    alone = HierarchicalGrid(radius, np.full(3, box)).pairs(position)
    assert len(alone) > 3 * n
    for threads in (2, 4):
        assert np.array_equal(HierarchicalGrid(radius, np.full(3, box), Team(threads)).pairs(position), alone)


@pytest.mark.slow
def test_any_number_of_threads_finds_the_same_contacts_with_planes() -> None:
    # Blocks of bodies without a contact among them, and fixed bodies, which touch neither each other nor a plane.
    rng = np.random.default_rng(6)
    n = 40_000
    position, fixed = rng.uniform(0.0, 60.0, (n, 3)), rng.random(n) < 0.1
    position[5000:9000] += 1e3 * np.arange(1, 4001)[:, None]
    planes = HalfSpaces(["floor", "wall"], np.eye(3)[[2, 0]], np.array([0.5, 0.0]))
    pairs = HierarchicalGrid(np.ones(n), np.zeros(3)).pairs(position)
    found = [
        PlaneSearch(np.ones(n), np.where(fixed, 0.0, 1.0), planes, Team(threads)).merged(pairs, position, 1.0, 0.0)
        for threads in (1, 2, 4)
    ]
    kept = pairs[~np.all(fixed[pairs], axis=1)]
    heights = position @ planes.normal.T - planes.offset
    expected = [tuple(pair) for pair in kept] + [(i, n + k) for i, k in np.argwhere(heights <= 1.0) if not fixed[i]]
    assert [tuple(pair) for pair in found[0]] == sorted(expected)
    for many in found[1:]:
        assert np.array_equal(found[0], many)


@pytest.mark.slow
def test_any_number_of_threads_takes_a_bed_to_the_same_bits() -> None:
    # Columns and rows of spheres that touch, on a floor, in a field that leans: enough contacts that all is shared out.
    site = np.stack(np.meshgrid(np.arange(40), np.arange(30), np.arange(6), indexing="ij"), axis=-1).reshape(-1, 3)
    rng = np.random.default_rng(0)
    position = rng.permutation(site * [2.0, 2.3, 2.0] + [0.0, 0.0, 1.0])
    velocity = rng.standard_normal(position.shape) * 1e-3
    bodies = [
        {"position": list(x), "velocity": list(v), "radius": 1.0} for x, v in zip(position, velocity, strict=True)
    ]
    gravity, time = {"constant": 0.0, "uniform": [0.3, 0.1, -9.81]}, {"duration": 1.0, "fixed_dt": 0.002}
    scene = scene_of(bodies, gravity=gravity, time=time, plane=[{}])
    told = []
    for threads in (1, 2, 4):
        space = Space(scene, threads)
        for step in range(4):
            space.compute_dynamics(step + 1)
        graph = space.contacts
        assert len(graph) > 10_000
        shown = (graph.pairs.tobytes(), graph.normals.tobytes(), graph.colours.tobytes())
        told.append((space.fingerprint(), space.ledger, space.extremes, shown))
    assert told[0] == told[1] == told[2]


@numba.njit(nogil=True)
def visit(lo: int, hi: int, visits: NDArray[Any], step: float) -> None:
    for i in range(lo, hi):
        visits[i] += step


@pytest.mark.parametrize("count", [0, 1, 19, 20, 1003])
def test_each_piece_of_divided_work_is_done_once(count: int) -> None:
    for threads in (1, 2, 3):
        team = Team(threads)
        for _ in range(50):
            visits = np.zeros(count)
            team.divide(count, 10, visit, visits, 1.0)
            assert np.all(visits == 1.0)


def test_a_kernel_is_divided_among_arguments_of_any_type() -> None:
    team = Team(2)
    for _ in range(3):  # the code for one kind of arguments must not be handed another
        for kind in (np.float64, np.int64, np.float32):
            visits = np.zeros(1000, dtype=kind)
            for step in (2, 2.0):
                team.divide(len(visits), 10, visit, visits, step)
            assert np.all(visits == 4)


PATIENT = 10**10  # looks at a flag, several seconds, before a kernel of a test goes on without it


@numba.njit(nogil=True)
def raise_at_the_end(lo: int, hi: int, visits: NDArray[Any], flags: NDArray[Any]) -> None:
    """Raise in the last piece, which a helper takes: the leader is kept in the first one until then."""
    for i in range(lo, hi):
        visits[i] += 1
    if hi == len(visits):
        atomic_store(flags, 0, 1)
        raise ValueError("in element", hi - 1)
    looks = 0
    while lo == 0 and atomic_load(flags, 0) == 0 and looks < PATIENT:
        looks += 1


@pytest.mark.slow
def test_an_exception_in_a_piece_that_a_helper_does_reaches_the_caller() -> None:
    team = Team(2)
    for _ in range(3):
        visits, flags = np.zeros(1000, dtype=np.int64), np.zeros(1, dtype=np.int64)
        with pytest.raises(ValueError) as raised:
            team.divide(len(visits), 10, raise_at_the_end, visits, flags)
        assert raised.value.args == ("in element", 999)
        assert np.all(visits == 1), "the other pieces are done"
    again = np.zeros(1000)
    team.divide(len(again), 10, visit, again, 1.0)
    assert np.all(again == 1.0), "the team goes on"


@numba.njit(nogil=True)
def wait_for_flag(lo: int, hi: int, flags: NDArray[Any]) -> None:
    atomic_store(flags, 0, 1)
    looks = 0
    while atomic_load(flags, 1) == 0 and looks < PATIENT:
        looks += 1


def test_a_second_thread_that_leads_a_team_is_refused_while_the_first_one_does() -> None:
    team, flags, visits = Team(2), np.zeros(2, dtype=np.int64), np.zeros(1000)
    first = threading.Thread(target=team.divide, args=(1000, 10, wait_for_flag, flags))
    first.start()
    while flags[0] == 0:
        time.sleep(0.001)
    try:
        with pytest.raises(RuntimeError, match="two threads use one team at once"):
            team.divide(len(visits), 10, visit, visits, 1.0)
        with pytest.raises(RuntimeError, match="two threads use one team at once"), team.leading():
            pass
    finally:
        flags[1] = 1
        first.join()
    team.divide(len(visits), 10, visit, visits, 1.0)
    assert np.all(visits == 1.0)


def test_work_is_shared_where_it_would_not_be_worth_it_if_all_is_to_be() -> None:
    team, visits = Team(2), np.zeros(3)
    with sharing_all():
        team.divide(len(visits), 10, visit, visits, 1.0)
    assert np.all(visits == 1.0)
