"""Twelve faults planted in a small engine of contacts are named by law, body and first step, from its states alone."""

from __future__ import annotations

from pathlib import Path

import pytest

from faulty_engines import PLANTED, SHOWN_LATER, Toy, recorded

QUICK = {"friction along the slip", "normal flipped"}
SLOWER = [pytest.param(*row, marks=() if row[0] in QUICK else pytest.mark.slow) for row in PLANTED.items()]


@pytest.mark.parametrize(("fault", "law"), SLOWER)
def test_each_of_twelve_planted_faults_is_named_in_the_first_step_in_which_it_acts(
    fault: str, law: str, tmp_path: Path
) -> None:
    toy = Toy(fault)
    faults = recorded(toy, tmp_path / "run.rrd")
    named = {found.law: found for found in faults}
    assert law in named, "another law is named"
    first = named[law]
    step, ends = next(planted for planted in toy.planted if planted[0] == first.step or fault in SHOWN_LATER)
    assert step <= first.step and first.step == min(found.step for found in faults)
    assert set(ends) & set(first.bodies) or fault in SHOWN_LATER


@pytest.mark.parametrize("seed", [1, pytest.param(range(2, 5), marks=pytest.mark.slow)])
def test_the_toy_without_a_fault_breaks_no_law(seed: int | range, tmp_path: Path) -> None:
    for each in [seed] if isinstance(seed, int) else seed:
        assert recorded(Toy(seed=each), tmp_path / f"{each}.rrd") == []
