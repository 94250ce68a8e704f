"""Short runs of all scenes by all methods have the stored bits; a refactoring changes none of them.

Where a change of the physics is meant to move bits, `python tests/golden/fingerprints.py` stores the new ones.
"""

from __future__ import annotations

from collections.abc import Iterable

import pytest

from golden.fingerprints import change_of, golden_scenes, moved, stored, usual_methods
from small_scenes import walls_as_slow

THREADS = 2  # they were stored with one: the bits are the same on any number
STORED = stored()


def changes(name: str, chosen: Iterable[str]) -> str:
    return "\n".join(filter(None, (moved(name, each, STORED[name][each], THREADS) for each in chosen)))


@pytest.mark.parametrize("name", walls_as_slow(sorted(STORED)))
def test_the_bits_of_a_scene_are_the_stored_ones_by_every_method(name: str) -> None:
    # a slow test (test_impulse_audit.py) runs the other methods, with the contacts recorded
    assert not (differing := changes(name, usual_methods(name, STORED))), differing


def test_every_scene_is_stored() -> None:
    assert set(STORED) == set(golden_scenes())


@pytest.mark.parametrize(
    ("what", "scenes"),
    [("touching", 35), ("in_flight", 20), ("held", 18), ("sweeps", 35)],
)
def test_enough_scenes_come_across_contacts_in_the_steps_that_are_run(what: str, scenes: int) -> None:
    across = [name for name, cases in STORED.items() if any(case[what] for case in cases.values())]
    assert len(across) >= scenes, across


def test_an_intended_change_shows_its_size() -> None:
    before = {"steps": 40, "energy_error": 1e-7, "impacts": 12, "state": "ab", "time": "ef"}
    now = before | {"energy_error": 3e-7, "impacts": 13, "state": "cd"}
    assert change_of(before, now) == "energy_error 1e-07 -> 3e-07, impacts 12 -> 13, bits of state"
