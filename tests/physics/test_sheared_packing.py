"""A dense packing under Lees–Edwards shear, whose contacts last.

Runs are slow, since their kernels compile for half a minute.
"""

from __future__ import annotations

from dataclasses import replace
from math import pi
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import carom
from carom.physics.placement.initial_state import place
from carom.physics.space import Space
from carom.plan.auto import MAX_DT, largest_step
from carom.plan.checks import doubts
from carom.plan.features import require
from carom.scene.load import Scene
from carom.state.frame import Frame

RATE, DENSITY = 1.0, 6 / pi  # 1/s, kg/m³: spheres of the diameter 1 m weigh 1 kg
ROUGH = {"restitution": 0.3, "static_friction": 0.5, "kinetic_friction": 0.5, "timing": "end-of-step"}
SMOOTH = {"restitution": 0.9, "static_friction": 0.0, "kinetic_friction": 0.0, "timing": "end-of-step"}


def packing(count: int, fraction: float, duration: float, dt: float = 1e-3, **sections: Any) -> dict[str, Any]:
    size = [(count * pi / 6 / fraction) ** (1 / 3)] * 3
    spheres = {"count": count, "radius": 0.5, "density": DENSITY, "arrangement": "compressed"}
    return {
        "seed": 1,
        "time": {"duration": duration, "fixed_dt": dt},
        "gravity": {"constant": 0.0},
        "contact": ROUGH,
        "domain": {"boundary": "periodic", "size": size, "shear": {"rate": RATE}},
        "group": [spheres | {"region": {"shape": "box", "size": size}}],
    } | sections


def volume(document: dict[str, Any]) -> float:
    return float(np.prod(document["domain"]["size"]))


def dissipated(frame: Frame) -> float:
    ledger = frame.energy.ledger
    return ledger.restitution + ledger.friction - ledger.stabilisation


def test_the_flow_presses_contacts_of_bodies_that_start_at_rest_in_it() -> None:
    needs = require(Scene.from_dict(packing(4, 0.1, 1.0)))
    assert needs.resting.modelled and needs.resting.why == "the shear presses: warm-started impulses"
    assert needs.stabilisation.modelled and not needs.impact_time.modelled
    gas, dense = (require(Scene.from_dict(packing(4, f, 1.0, contact=ROUGH | {"timing": "auto"}))) for f in (0.4, 0.6))
    assert gas.impact_time.modelled and not gas.resting.modelled and not gas.stabilisation.modelled
    assert dense.resting.modelled and "packing fraction above 0.5" in dense.impact_time.why


def test_automatic_steps_strain_a_packing_by_a_thousandth_and_leave_a_gas_alone() -> None:
    dense = Scene.from_dict(packing(4, 0.1, 1.0, time={"duration": 1.0}))
    gas = Scene.from_dict(packing(4, 0.1, 1.0, time={"duration": 1.0}, contact=ROUGH | {"timing": "auto"}))
    assert largest_step(dense) == 1e-3 / RATE and largest_step(gas) == MAX_DT
    assert "max_dt = 0.001 s: a strain of 0.001" in require(dense).adaptive_step.why
    assert doubts(dense) == []  # the flow moves bodies that start at rest in it


@pytest.mark.slow
@pytest.mark.nightly
def test_the_work_on_the_bundled_packing_is_that_of_its_shear_stress() -> None:
    scene, dt = Scene.load("dense-shear", ["time.duration=0.6", "time.fixed_dt=1e-3", "record.every=step"]), 1e-3
    space, mass, stress, held = Space(scene, 1, record_contacts=True), pi / 6, 0.0, 0
    begun = np.nan
    for frame in space.run():
        peculiar = frame.velocity - np.outer(frame.position[:, 1], [RATE, 0.0, 0.0])
        fluctuations = 0.5 * mass * float((peculiar**2).sum()) + frame.energy.rotational
        if frame.step == 0:
            begun = dissipated(frame) + fluctuations
            continue
        stress -= mass * float((peculiar[:, 0] * peculiar[:, 1]).sum()) * dt
        for impulses in space.impulses():
            if impulses.turns:  # the others belong to the correction of overlaps
                J = impulses.values[:, :1] * impulses.normal + impulses.values[:, 1:]
                branch = impulses.arms.sum(axis=1)[:, None] * impulses.normal
                stress -= float((J[:, 0] * branch[:, 1]).sum())
        held = max(held, len(frame.contacts))
    assert held > 200
    # the ledger closes to the rounding of the sum of the work, some 10⁴ times the energy of a step
    assert frame.energy.relative_error < 1e-13
    assert frame.momentum_error is not None and frame.momentum_error < 1e-13
    given = dissipated(frame) + fluctuations - begun
    # kicks and drifts of a step of 10⁻³/γ sample the stress of the fluctuations once: 5 × 10⁻⁵ in this run
    assert given == pytest.approx(RATE * stress, rel=5e-4)
    assert stress / (frame.time * volume(scene.model_dump())) > 5.0 * RATE**2  # of a gas of half the fraction: 0.25


@pytest.mark.slow
def test_a_contact_across_the_sheared_face_is_one_inside_the_box() -> None:
    # conjugate gradients ask whether a contact slides, which for one at the limit of friction rounding decides
    document = packing(150, 0.58, 0.04, record={"every": 0.04}, contact=ROUGH | {"sweeps": 20})
    scene = Scene.from_dict(document)
    start, up = place(scene), 0.37 * document["domain"]["size"][1]
    moved = start.position + np.array([0.0, up, 0.0])
    frames = []
    for position in (start.position, moved):
        velocity = np.outer(position[:, 1], [RATE, 0.0, 0.0]) + 0.3 * np.sin(7.0 * start.position)
        *_, last = Space(scene, 1, start=replace(start, position=position, velocity=velocity)).run()
        frames.append(last)
    size, end = np.array(document["domain"]["size"]), frames[0].time
    depth = float(size[1])
    expected = frames[0].position + np.array([RATE * up * end, up, 0.0])
    images = np.floor(expected[:, 1] / depth + 0.5)
    assert 20 < np.count_nonzero(images) < 130
    apart = frames[1].position - expected + np.outer(images, [RATE * depth * end, depth, 0.0])
    np.testing.assert_allclose(apart - size * np.round(apart / size), 0.0, atol=1e-12)
    change = np.outer(RATE * (up - images * depth), [1.0, 0.0, 0.0])
    np.testing.assert_allclose(frames[1].velocity, frames[0].velocity + change, atol=1e-10)
    assert dissipated(frames[1]) == pytest.approx(dissipated(frames[0]), rel=1e-10)
    assert frames[0].energy.ledger.friction > 0.0


@pytest.mark.slow
def test_without_a_rate_contacts_have_the_bits_of_a_periodic_box() -> None:
    still = packing(150, 0.5, 0.2)
    still["group"][0]["velocity"] = {"dispersion": 0.5}
    still["domain"]["shear"]["rate"] = 0.0
    plain = still | {"domain": {key: value for key, value in still["domain"].items() if key != "shear"}}
    frames = [[*Space(Scene.from_dict(box), 1).run()][-1] for box in (still, plain)]
    np.testing.assert_array_equal(frames[0].position, frames[1].position)
    np.testing.assert_array_equal(frames[0].velocity, frames[1].velocity)
    assert dissipated(frames[0]) == dissipated(frames[1]) > 0.0


@pytest.mark.slow
def test_a_sheared_packing_has_the_same_bits_on_any_number_of_threads() -> None:
    document = packing(1000, 0.6, 0.3, dt=5e-3, record={"every": 0.1})  # threads share 2048 contacts or more
    runs = [list(Space(Scene.from_dict(document), threads).run()) for threads in (1, 2)]
    assert len(runs[0][-1].contacts) > 2048
    assert [frame.fingerprint for frame in runs[0]] == [frame.fingerprint for frame in runs[1]]


@pytest.mark.slow
def test_a_sheared_packing_has_the_same_bits_after_resuming_and_in_a_replay(tmp_path: Path) -> None:
    document = packing(150, 0.58, 0.2)
    short, longer = tmp_path / "short.rrd", tmp_path / "longer.rrd"
    carom.run(Scene.from_dict(document | {"time": document["time"] | {"duration": 0.1}}), short)
    assert carom.resume(short, 0.2, longer).finished
    assert carom.replay(longer).same
    *_, whole = Space(Scene.from_dict(document)).run()
    recording = carom.Recording.open(longer)
    np.testing.assert_array_equal(recording.checkpoint(recording.checkpoint_steps[-1]).position, whole.position)


@pytest.mark.nightly
@pytest.mark.slow
def test_a_gas_has_the_stress_that_impacts_at_their_own_times_give() -> None:
    document = packing(250, 0.4, 12.0, dt=2e-3, contact=SMOOTH, record={"every": 0.5})
    frames = [frame for frame in Space(Scene.from_dict(document), 1).run() if frame.time >= 4.0]
    work = frames[0].energy.ledger.entry("shear") - frames[-1].energy.ledger.entry("shear")
    stress = work / (frames[-1].time - frames[0].time) / volume(document)
    # `test_sheared_gas`: 0.756 ± 0.007 with 500 spheres in 30 s; 250 in 8 s fluctuate by 4 %
    assert stress / (DENSITY * RATE**2) == pytest.approx(0.756, rel=0.1)
