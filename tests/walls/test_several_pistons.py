"""Several pistons: a box whose sides keep a pressure, and loads that accelerate to a largest speed."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import carom
from carom import Frame, Recording, Scene, Space
from carom.arrays import FloatArray
from carom.errors import PhysicsError
from carom.physics.schedule import every

r, SIDE, PRESSURE = 0.05, 0.6, 5e3  # m, m, Pa
COUNT = 60  # spheres of 1 kg
SMOOTH: dict[str, Any] = {"static_friction": 0.0, "kinetic_friction": 0.0}


def box(pistons: str, **others: Any) -> Scene:
    """Return rough spheres without gravity between six smooth planes, of which some are pistons, such as "x- y- z-"."""
    planes = []
    for axis in range(3):
        for sign in (1.0, -1.0):
            normal = np.where(np.arange(3) == axis, sign, 0.0)
            plane = {"point": (-0.5 * SIDE * normal).tolist(), "normal": normal.tolist()} | SMOOTH
            if f"{'xyz'[axis]}{'+' if sign > 0.0 else '-'}" in pistons:
                plane["piston"] = {"mass": 20.0, "pressure": PRESSURE}
            planes.append(plane)
    group = {"count": COUNT, "radius": r, "mass": 1.0, "region": {"shape": "box", "size": [SIDE] * 3}}
    rough = {"restitution": 0.3, "static_friction": 0.3, "kinetic_friction": 0.3}
    values = {"seed": 1, "gravity": {"constant": 0.0}, "contact": rough, "plane": planes, "group": [group]}
    return Scene.from_dict(values | {"time": {"duration": 1.8}} | others)


def states(frame: Frame) -> FloatArray:
    """Return displacement (m), velocity (m/s) and impulse (N s) of each piston, (k, 3)."""
    assert frame.memory is not None and frame.memory.pistons is not None
    return frame.memory.pistons


@pytest.fixture(scope="module")
def pressed() -> list[Frame]:
    return list(Space(box("x- y- z-"), record_contacts=True).run(schedule=every(0.0)))


@pytest.mark.slow
@pytest.mark.nightly
def test_three_pistons_compress_a_box_until_all_six_sides_bear_the_pressure(pressed: list[Frame]) -> None:
    late = [frame for frame in pressed if frame.time > 1.5]
    sides = SIDE - states(late[-1])[:, 0]
    faces = np.repeat(sides.prod() / sides, 2)  # m², of each plane
    given = np.zeros(6)
    for frame in late:
        assert frame.contact_rows is not None
        np.add.at(
            given,
            np.maximum(frame.contact_rows["j"] - COUNT, 0),
            np.where(frame.contact_rows["j"] >= COUNT, frame.contact_rows["normal_impulse"], 0.0),
        )
    stress = given / faces / sum(frame.dt for frame in late)
    # at rest, a smooth plane bears what the piston opposite presses; the solver leaves some 10⁻³, as in test_piston
    assert stress == pytest.approx(PRESSURE, rel=2e-3)
    forces = np.diff([states(late[0])[:, 2], states(late[-1])[:, 2]], axis=0)[0] / (late[-1].time - late[0].time)
    assert forces / faces[::2] == pytest.approx(PRESSURE, rel=2e-3)
    assert np.abs(states(late[-1])[:, 1]).max() < 0.01  # m/s
    assert sides.prod() < 0.7 * SIDE**3
    # the work of a constant pressure is p ΔV; the packing was compressed by several metres a second
    assert max(abs(frame.energy.integration_error) for frame in pressed) < 1e-12 * pressed[-1].energy.ledger.restitution
    assert dict(late[-1].energy.ledger.forces)["walls"] == pytest.approx(-PRESSURE * (SIDE**3 - sides.prod()), rel=0.01)


@pytest.mark.slow
@pytest.mark.nightly
def test_a_run_with_several_pistons_goes_on_with_the_same_bits_and_records_each(
    pressed: list[Frame], tmp_path: Path
) -> None:
    of = box("x- y- z-", time={"duration": 0.1})
    space = Space(of, record_contacts=True)
    middle = next(frame for frame in pressed if frame.time > 0.06)
    space.restore(middle.checkpoint)
    again = list(space.run(schedule=every(0.0)))
    same = {frame.step: frame for frame in pressed}
    assert len(again) > 10
    for frame in again[1:-1]:  # the last step ends at another time
        assert frame.fingerprint == same[frame.step].fingerprint
        assert np.array_equal(states(frame), states(same[frame.step]))
    assert middle.memory is not None
    wrong = replace(middle.checkpoint, contacts=replace(middle.memory, pistons=states(middle)[:1]))
    with pytest.raises(PhysicsError, match="does not state where the pistons of the scene are"):
        space.restore(wrong)
    path = carom.run(of, tmp_path / "box.rrd").path
    steps = Recording.open(path).steps()
    last = again[-1]
    for name, row in (("piston", 0), ("piston_1", 1), ("piston_2", 2)):
        found = [steps[f"{name}_{what}"].to_numpy()[-1] for what in ("position", "velocity")]
        assert found == states(last)[row, :2].tolist()
    assert carom.replay(path).same


def test_a_load_accelerates_a_piston_no_further_than_to_its_largest_speed() -> None:
    M, F, fastest, duration = 2.0, 30.0, 0.5, 0.2
    down = {"point": [0.0, 0.0, 9.0], "normal": [0.0, 0.0, -1.0]}
    ball = {"radius": r, "mass": 1.0, "position": [0.0, 0.0, r]}
    of = Scene.from_dict(
        {
            "gravity": {"constant": 0.0},
            "time": {"duration": duration},
            "plane": [{}, down | {"piston": {"mass": M, "force": F, "max_speed": fastest}}],
            "body": [ball],
        }
    )
    *_, before, last = Space(of).run(schedule=every(0.0))
    displacement, velocity, _ = states(last)[0]
    assert velocity == pytest.approx(fastest, rel=1e-14)
    # the step in which it reaches the speed has a mean acceleration
    reached = fastest**2 / (2.0 * F / M) + fastest * (duration - fastest * M / F)
    assert displacement == pytest.approx(reached, abs=0.5 * F / M * before.dt**2)
    assert dict(last.energy.ledger.forces)["walls"] == pytest.approx(0.0, abs=1e-12)  # it did no work on bodies
