"""Twelve faults planted in engines of contacts are named by law, body and first step, from their states alone."""

from __future__ import annotations

from pathlib import Path

import pytest

from carom.engines.faults import Broken
from carom.engines.rebounds import Rebounds
from carom.engines.source import setup_of
from carom.recording.read.recording import Recording
from faulty_engines import PLANTED, Toy, naming_law, recorded

QUICK = {"friction along the slip", "normal flipped", "spin in the wrong frame"}
SLOWER = [pytest.param(*row, marks=() if row[0] in QUICK else pytest.mark.slow) for row in PLANTED.items()]


@pytest.mark.parametrize(("fault", "law"), SLOWER)
def test_each_of_twelve_planted_faults_is_named_in_the_first_step_in_which_it_acts(
    fault: str, law: str, tmp_path: Path
) -> None:
    toy = Toy(fault)
    faults = recorded(toy, tmp_path / "run.rrd")
    assert naming_law(toy.planted, faults)
    assert min(found.step for found in faults) >= toy.planted[0][0], "no law accuses the engine before"
    assert law in {found.law for found in faults}
    step, bodies = next(
        (law["step"], law["bodies"]) for law in Recording.open(tmp_path / "run.rrd").summary()["laws"].values()
    )
    assert step == toy.planted[0][0] and set(bodies) & set(toy.planted[0][1]), "headline, report and scene begin here"


@pytest.mark.slow
@pytest.mark.nightly
@pytest.mark.parametrize("fault", PLANTED)
def test_a_planted_fault_is_named_in_nine_of_ten_runs(fault: str, tmp_path: Path) -> None:
    toys = [Toy(fault, seed) for seed in range(10)]
    laws = [naming_law(toy.planted, recorded(toy, tmp_path / "run.rrd")) for toy in toys]
    told = [law != "" for law, toy in zip(laws, toys, strict=True) if toy.planted]
    assert sum(told) >= 0.9 * len(told), laws


@pytest.mark.parametrize("seed", [1, pytest.param(range(10), marks=pytest.mark.slow)])
def test_the_toy_without_a_fault_breaks_no_law(seed: int | range, tmp_path: Path) -> None:
    for each in [seed] if isinstance(seed, int) else seed:
        assert recorded(Toy(seed=each), tmp_path / f"{each}.rrd") == []


@pytest.mark.parametrize(
    ("counts", "named"),
    [
        ([(60, 10, 0), (400, 12, 9)], True),  # the pile sinks later, as a fault may let it
        ([(20, 2, 9), (60, 10, 40)], False),  # the contacts of this engine last
        ([(60, 9, 0)], False),  # too few impacts to know
    ],
)
def test_an_engine_is_rigid_if_its_impacts_were_up_to_a_fault(counts: list[tuple[int, int, int]], named: bool) -> None:
    toy = Toy()
    laws = Rebounds(setup_of(toy.model, toy.state()), 0.1)
    laws.suspected = [(43, 0.1, Broken("restitution", 5.0, (1, 2), "rebound faster than they closed"))]
    laws._counts = counts  # steps, impacts that were over, and impacts that lasted
    assert [step for step, *_ in laws.concluded()] == [43] * named


@pytest.mark.slow
@pytest.mark.parametrize(
    ("engine", "fault"),
    [
        *(("pybullet", fault) for fault in PLANTED if fault != "restitution by the wrong material"),
        ("box3d", "restitution by the wrong material"),
        ("mujoco", "impulse to one body only"),
    ],
)
def test_a_fault_patched_into_an_engine_is_named_by_its_step_and_a_body(
    engine: str, fault: str, tmp_path: Path
) -> None:
    pytest.importorskip({"box3d": "robox3d"}.get(engine, engine))
    from patched_engines import PatchedEngine
    from patched_engines import recorded as recorded_patched

    run = PatchedEngine(engine, fault, seed=20)
    assert naming_law(run.planted, recorded_patched(run, tmp_path / "run.rrd"))
