"""The impulses that frames report, and the forces, are all that changes velocities, spins and the ledger."""

from __future__ import annotations

from itertools import islice
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings

from carom.lab.hunt.documents import Document
from carom.physics.contact.contact_tap import ContactTap, Impulses
from carom.physics.space import Space
from carom.scene.load import Scene
from golden.fingerprints import AS_WRITTEN, load, moved, stored, usual_methods
from scene_strategies import documents, scene_from
from small_scenes import cloud

ROUNDING = 1e-12  # some 100 impulses a body and 100 iterations each, of 1e-16: the worst case found has 2e-14
STORED = stored()


def audited(scene: Scene, threads: int = 1) -> Space:
    """A space that records its contacts and compares them with the velocities."""
    expect = scene.expect.model_copy(update={"contact_audit": ROUNDING})
    return Space(scene.model_copy(update={"expect": expect}), threads, record_contacts=True)


def check(name: str, overrides: str) -> None:
    """Run a case of the golden tests with the contacts recorded: the same bits, and nothing unaccounted for."""
    spaces: list[Space] = []

    def make(scene: Scene, threads: int) -> Space:
        spaces.append(audited(scene, threads))
        return spaces[0]

    assert moved(name, overrides, STORED[name][overrides], 2, make) == ""
    error = spaces[0].extremes.contact_audit
    assert error is not None and error.value <= ROUNDING, f"{name}, {overrides}: {error}"


@pytest.mark.parametrize("name", ["golden/box", "golden/cloud", "golden/heap", "golden/tray", "golden/wind"])
def test_walls_piles_drag_and_periodic_boxes_are_accounted_for(name: str) -> None:
    check(name, AS_WRITTEN)


@pytest.mark.nightly
@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(STORED))
def test_by_the_methods_beyond_golden_tests_impulses_and_forces_are_all_that_changes_velocities(name: str) -> None:
    usual = usual_methods(name, STORED) if not name.startswith("golden/") else []  # the golden test runs these
    for overrides in STORED[name]:
        if name == "dense-shear" and "time-of-impact" in overrides:
            continue  # 10⁵ impacts a step; shear-cell has impacts in a sheared box, too
        if overrides == AS_WRITTEN or overrides not in usual:
            check(name, overrides)


@pytest.mark.parametrize("name", ["golden/tray", "golden/wind"])
def test_where_a_bias_asks_of_squeezed_bodies_what_cannot_be_impulses_stay_bounded(name: str) -> None:
    check(name, "contact.stabilisation=baumgarte")
    space = Space(load(name, "contact.stabilisation=baumgarte"), 1)
    for frame in islice(space.run(), 41):
        assert np.abs(frame.velocity).max() < 20.0  # they are thrown at 2 m/s and fall 4 m; conjugate gradients once
        # reached 10¹² m/s


@settings(max_examples=15, deadline=None, suppress_health_check=list(HealthCheck))
@given(document=documents())
def test_random_scenes_are_accounted_for(document: Document) -> None:
    space = audited(scene_from(document))
    for _ in islice(space.run(), 15):
        pass
    error = space.extremes.contact_audit
    assert error is not None and error.value <= ROUNDING, error


@pytest.mark.slow
@settings(max_examples=150, deadline=None, suppress_health_check=list(HealthCheck))
@given(document=documents())
def test_many_random_scenes_are_accounted_for(document: Document) -> None:
    space = audited(scene_from(document))
    for _ in islice(space.run(), 31):
        pass
    error = space.extremes.contact_audit
    assert error is not None and error.value <= ROUNDING, error


@pytest.mark.parametrize("timing", ["end-of-step", "time-of-impact"])
@pytest.mark.parametrize("solver", ["lasting", "staged"])
def test_the_rows_of_all_steps_add_up_to_the_ledger(timing: str, solver: str) -> None:
    space = audited(cloud(20, contact={"timing": timing, "solver": solver}, time={"duration": 2.0}))
    rows = np.concatenate([frame.contact_rows for frame in space.run() if frame.contact_rows is not None])
    ledger = space.ledger
    for term, entry in (
        ("restitution_loss", "restitution"),
        ("friction_loss", "friction"),
        ("stabilisation_gain", "stabilisation"),
    ):
        scale = float(np.abs(rows[term]).sum())
        assert scale > 0.0 and abs(float(rows[term].sum()) - ledger.entry(entry)) <= 1e-12 * scale


@pytest.mark.parametrize("timing", ["end-of-step", "time-of-impact"])
def test_between_any_two_frames_the_impacts_of_a_gas_change_momenta_by_their_impulses(timing: str) -> None:
    scene = cloud(
        gravity={"constant": 0.0},
        contact={"timing": timing, "static_friction": 0.4, "kinetic_friction": 0.3},
        record={"every": 0.4},
    )
    space = Space(scene, 1, record_contacts=True)
    mass, before, total = space.state.mass[:, None], None, 0
    for frame in space.run():
        assert frame.impacts is not None
        given_ = np.zeros_like(frame.velocity)
        impulse = np.stack(
            [frame.impacts[f"friction_{k}"] + frame.impacts["normal_impulse"] * frame.impacts[f"n{k}"] for k in "xyz"],
            axis=1,
        )
        np.add.at(given_, frame.impacts["i"], -impulse)
        np.add.at(given_, frame.impacts["j"], impulse)
        if before is not None:
            fastest = np.sqrt((frame.velocity**2).sum(axis=1).max())
            assert np.abs(frame.velocity - before - given_ / mass).max() <= 1e-12 * fastest
        before, total = frame.velocity, total + len(frame.impacts)
    assert total > 20


@pytest.mark.parametrize("lost", ["hold", "drift", "impact pass", "arms"])
def test_an_impulse_that_is_not_reported_is_found(lost: str, monkeypatch: pytest.MonkeyPatch) -> None:
    honest = ContactTap.impulses

    def careless(tap: ContactTap, *arguments: Any) -> list[Impulses]:
        found = list(honest(tap, *arguments))
        if lost == "arms":
            return [some._replace(arms=1.001 * some.arms) for some in found]
        held, drift = int(len(tap._held.pairs) > 0), int(len(tap._drift) > 0)
        missing = {"hold": 0 if held else None, "drift": held if drift else None, "impact pass": held + drift + 1}[lost]
        return [some for k, some in enumerate(found) if k != missing]

    monkeypatch.setattr(ContactTap, "impulses", careless)
    timing = "time-of-impact" if lost == "drift" else "end-of-step"
    space = audited(cloud(20, contact={"timing": timing}, time={"duration": 2.0}))
    for _ in space.run():
        pass
    error = space.extremes.contact_audit
    assert error is not None and error.value > 1e-6
