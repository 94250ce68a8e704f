"""Contacts that need not converge to rounding: those of large islands with many contacts per body."""

from __future__ import annotations

import numpy as np

from carom.arrays import BoolArray, IntArray
from carom.physics.contact.constraints import ENOUGH, ENOUGH_AS_NEEDED
from carom.physics.contact.islands import MOST_EXACT, mark_meshed
from carom.physics.space import Space
from small_scenes import scene_of

SIDE = 8


def crystal() -> IntArray:
    """Return the pairs of touching balls in a simple cubic lattice, (m, 2)."""
    number = np.arange(SIDE**3).reshape(SIDE, SIDE, SIDE)
    along = [(np.delete(number, -1, axis), np.delete(number, 0, axis)) for axis in range(3)]
    return np.concatenate([np.column_stack((low.ravel(), high.ravel())) for low, high in along])


def column(count: int, first: int) -> IntArray:
    return first + np.column_stack((np.arange(count - 1), np.arange(1, count)))


def meshed(pairs: IntArray, fixed: int | None = None) -> BoolArray:
    ends = int(pairs.max()) + 1
    inverse_mass = np.ones(ends)
    if fixed is not None:
        inverse_mass[fixed] = 0.0
    enough = np.full(len(pairs), ENOUGH)
    workspaces = np.empty(ends, dtype=np.int64), np.empty((ends, 2), dtype=np.int64)
    mark_meshed(pairs, np.unique(pairs), inverse_mass, *workspaces, enough)
    return np.asarray(enough == ENOUGH_AS_NEEDED)


def test_a_column_beside_a_heap_converges_as_if_it_stood_alone() -> None:
    # A column carries its load along one path, so a small error of each contact adds up over its height.
    heap, tower = crystal(), column(2000, SIDE**3)
    assert len(heap) > MOST_EXACT
    found = meshed(np.concatenate((heap, tower)))
    assert found[: len(heap)].all() and not found[len(heap) :].any()


def test_small_heaps_converge() -> None:
    assert not meshed(crystal()[: MOST_EXACT // 2]).any()


def test_a_floor_joins_no_islands() -> None:
    # Many short columns on one floor are islands of their own, however many there are.
    balls, floor = np.arange(3000), 3000
    pairs = np.concatenate((column(3000, 0)[::2], np.column_stack((balls, np.full(3000, floor)))))
    assert not meshed(pairs, floor).any()


def test_friction_that_drops_when_a_contact_slides_does_not_keep_a_falling_heap_iterating() -> None:
    # Contacts at the limit of static friction slide and stick in turns, from iteration to iteration.
    def iterations(sweeps: str) -> tuple[float, bool]:
        """Return the mean in the steps of a fall with a meshed heap, and whether the run warned."""
        jitter = np.random.default_rng(0).uniform(-0.2, 0.2, (SIDE**3, 3))
        sites = 2.4 * np.stack(np.meshgrid(*[np.arange(SIDE)] * 3, indexing="ij"), axis=-1).reshape(-1, 3) + jitter
        width = 2.4 * SIDE
        scene = scene_of(
            [{"position": place} for place in (sites - [8.4, 8.4, width - 2.0]).tolist()],
            domain={"boundary": "walls", "size": [width, width, 2.0 * width]},
            gravity={"constant": 0.0, "uniform": [0.0, 0.0, -98.1]},
            contact={"restitution": 0.0, "static_friction": 0.6, "kinetic_friction": 0.4, "sweeps": sweeps},
            time={"duration": 1.5, "fixed_dt": 1.0 / 60.0},
        )
        found, warned = [], False
        for frame in Space(scene).run():
            warned = warned or any("still closing" in event.text for event in frame.events)
            if len(frame.contacts.pairs) > MOST_EXACT:
                found.append(frame.sweeps)
        return float(np.mean(found)), warned

    (limited, warned), (converged, _) = iterations("auto"), iterations("converged")
    assert limited < 0.25 * converged  # 31 of 208; 150 if contacts that have slid may stick again
    assert not warned
