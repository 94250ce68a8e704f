"""The contacts and forces that an engine reports are judged directly, and adapters tell a common coefficient."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import carom
from faulty_engines import FRICTION, Toy, recorded

DT, WEIGHT = 0.01, 9.81  # s, N
MU = 0.3


class Sliding:
    """Balls that slide along x on a floor, which reports the contacts of each step; one force of a step is changed."""

    def __init__(self, friction: float | None, wrong: dict[str, Any] | None = None, balls: int = 2) -> None:
        self.steps, self.wrong, self.balls = 0, wrong or {}, balls
        self.model = carom.record.Model(
            engine="slider 1.0",
            mass=np.ones(balls),
            radius=np.full(balls, 0.1),
            inertia=np.full(balls, 1e9),  # the balls do not turn
            gravity=(0.0, 0.0, -WEIGHT),
            planes=[carom.record.Plane((0.0, 0.0, 1.0), 0.0, "floor")],
            friction=friction,
        )

    def state(self) -> carom.record.State:
        t = self.steps * DT
        x, v = np.zeros((self.balls, 3)), np.zeros((self.balls, 3))
        x[:, 0], x[:, 1], x[:, 2] = 3.0 * t - 0.5 * MU * WEIGHT * t * t, np.arange(self.balls), 0.1
        v[:, 0] = 3.0 - MU * WEIGHT * t
        contacts = np.zeros(self.balls, carom.record.CONTACT)
        contacts["i"], contacts["j"], contacts["normal"] = np.arange(self.balls), self.balls, (0.0, 0.0, -1.0)
        contacts["point"] = x - (0.0, 0.0, 0.1)
        contacts["force"], contacts["friction"] = WEIGHT, (MU * WEIGHT, 0.0, 0.0)  # on the floor
        if self.steps == 5:
            for name, value in self.wrong.items():
                contacts[name][1] = value
        return carom.record.State(t, x, v, angular_velocity=np.zeros((self.balls, 3)), contacts=contacts)


def faults_of(engine: Sliding, path: Path) -> list[carom.record.Fault]:
    with carom.record.Recorder(engine, path) as recorder:
        for engine.steps in range(1, 20):
            recorder.frame()
    assert recorder.problems == []
    return recorder.faults


@pytest.mark.parametrize(
    ("law", "friction", "wrong", "said"),
    [
        ("pull", None, {"force": -WEIGHT}, "a contact can only push"),
        ("friction", MU, {"friction": (2.0 * MU * WEIGHT, 0.0, 0.0)}, "rub with 0.6 times their normal force"),
        ("friction", None, {"friction": (-MU * WEIGHT, 0.0, 0.0)}, "rub with the slip"),
    ],
)
def test_a_force_that_no_contact_has_is_named_by_law_bodies_and_step(
    law: str, friction: float | None, wrong: dict[str, Any], said: str, tmp_path: Path
) -> None:
    faults = faults_of(Sliding(friction, wrong), tmp_path / "run.rrd")
    (fault,) = [fault for fault in faults if fault.law == law]
    assert (fault.step, fault.bodies) == (5, (1, 2)) and said in fault.text


@pytest.mark.parametrize("friction", [None, MU])
def test_forces_of_contacts_that_obey_the_laws_are_not_accused(friction: float | None, tmp_path: Path) -> None:
    assert faults_of(Sliding(friction), tmp_path / "run.rrd") == []
    # without a coefficient, any friction against the slip is possible
    large = Sliding(None, {"friction": (2.0 * MU * WEIGHT, 0.0, 0.0)})
    assert faults_of(large, tmp_path / "large.rrd") == []


@pytest.mark.parametrize(("friction", "named"), [(FRICTION, set()), (0.5 * FRICTION, {"friction"})])
def test_states_alone_show_more_friction_than_the_model_has(friction: float, named: set[str], tmp_path: Path) -> None:
    toy = Toy()
    toy.model = replace(toy.model, friction=friction)
    faults = recorded(toy, tmp_path / "run.rrd")
    assert {fault.law for fault in faults} == named
    assert all("the model says 0.15" in fault.text for fault in faults)


@pytest.mark.needs("mujoco")
@pytest.mark.parametrize(("second", "common"), [("0.4", 0.4), ("0.5", None)])
def test_mujoco_tells_a_friction_that_all_shapes_have(second: str, common: float | None) -> None:
    import mujoco

    ball = '<body pos="0 0 1"><freejoint/><geom size="0.1" friction="0.4 0 0"/></body>'
    text = f'<mujoco><worldbody><geom type="plane" size="0 0 1" friction="{second} 0 0"/>{ball}</worldbody></mujoco>'
    model = mujoco.MjModel.from_xml_string(text)
    assert carom.record.mujoco(model, mujoco.MjData(model)).model.friction == common


def test_pybullet_tells_a_common_friction_and_leaves_constrained_bodies_out() -> None:
    pybullet = pytest.importorskip("pybullet")
    client = pybullet.connect(pybullet.DIRECT)
    where = {"physicsClientId": client}
    shape = pybullet.createCollisionShape(pybullet.GEOM_SPHERE, radius=0.1, **where)
    one, two, free = (
        pybullet.createMultiBody(1.0, shape, basePosition=[k, 0.0, 0.0], **where) for k in (0.0, 1.0, 2.0)
    )
    arms = [0.0, 0.0, 0.0], [0.5, 0.0, 0.0], [-0.5, 0.0, 0.0]
    pybullet.createConstraint(one, -1, two, -1, pybullet.JOINT_POINT2POINT, *arms, **where)
    for body in (one, two, free):
        pybullet.changeDynamics(body, -1, lateralFriction=0.5, **where)
    model = carom.record.pybullet(client=client).model
    assert model.judged.tolist() == [False, False, True] and model.friction == pytest.approx(0.25)
    pybullet.changeDynamics(free, -1, lateralFriction=0.7, **where)
    assert carom.record.pybullet(client=client).model.friction is None
    pybullet.disconnect(client)
