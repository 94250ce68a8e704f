"""What an engine's step admits breaks no law; what it does not admit does."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import carom
from carom.cli.main import app

DT, RADIUS, SPEED = 0.01, 0.1, 1.0  # s, m, m/s: bodies move by a tenth of a radius in a step
PAIRS = 24  # enough impacts to show a habit: `missed_impacts.OFTEN` is 20


class Late:
    """Pairs that meet one after another, each resolved some steps after it overlaps; one pair takes more."""

    def __init__(self, usual: int, exception: int) -> None:
        self.delay = np.full(PAIRS, usual)
        self.delay[PAIRS // 2] = exception
        self.step = 0
        self.meet = 3 + np.arange(PAIRS)  # the step in which a pair first overlaps
        radius = np.full(2 * PAIRS, RADIUS)
        self.model = carom.record.Model(engine="mine 1", mass=np.ones(2 * PAIRS), radius=radius)

    def state(self) -> carom.record.State:
        turn = self.meet + self.delay
        passed = np.minimum(self.step, turn) - np.maximum(self.step - turn, 0)  # steps of approach, less those after it
        apart = 2 * RADIUS + 2 * SPEED * DT * (self.meet - 0.5 - passed)
        x, v = np.zeros((2 * PAIRS, 3)), np.zeros((2 * PAIRS, 3))
        x[0::2, 0], x[1::2, 0] = -0.5 * apart, 0.5 * apart
        x[0::2, 1] = x[1::2, 1] = 10 * RADIUS * np.arange(PAIRS)
        # the state at the end of the step that resolves an impact has already the new velocity
        away = np.where(self.step >= turn, SPEED, -SPEED)
        v[0::2, 0], v[1::2, 0] = -away, away
        return carom.record.State(self.step * DT, x, v, angular_velocity=np.zeros_like(x))


def faults_of(source: Late, path: Path) -> list[carom.record.Fault]:
    with carom.record.Recorder(source, path) as recorder:
        for source.step in range(1, 45):
            recorder.frame()
    return recorder.faults


@pytest.mark.parametrize(("usual", "exception", "named"), [(0, 0, False), (1, 1, False), (0, 1, True), (1, 2, True)])
def test_an_impact_is_missed_where_it_takes_more_steps_than_the_others(
    usual: int, exception: int, named: bool, tmp_path: Path
) -> None:
    source = Late(usual, exception)
    faults = faults_of(source, tmp_path / "late.rrd")
    assert [fault.law for fault in faults] == ["missed-impact"] * named
    ends = (PAIRS // 2 * 2, PAIRS // 2 * 2 + 1)
    assert all(fault.bodies == ends and fault.step == source.meet[PAIRS // 2] + usual for fault in faults)


class Soft:
    """A ball that a plane throws back from a given depth, or that stays there."""

    model = carom.record.Model(
        engine="mine 1", mass=[1.0], radius=[RADIUS], planes=[carom.record.Plane((0, 0, 1), 0.0, "floor")]
    )

    def __init__(self, depth: float, stays: bool) -> None:
        self.depth, self.stays, self.step = depth, stays, 0

    def state(self) -> carom.record.State:
        # a spring that takes 40 steps for a rebound
        phase = np.pi * np.clip((self.step - 5) / 40, 0.0, 0.5 if self.stays else 1.0)
        rate = self.depth * np.pi / 40 / DT
        fly = rate * DT * (max(5 - self.step, 0) + max(self.step - 45, 0) * (not self.stays))
        x = [[0.0, 0.0, RADIUS + fly - self.depth * np.sin(phase)]]
        return carom.record.State(self.step * DT, x, [[0.0, 0.0, -rate * np.cos(phase)]])


@pytest.mark.parametrize(("depth", "stays", "named"), [(0.6, False, False), (0.6, True, False), (1.2, True, True)])
def test_an_overlap_is_an_accuracy_of_the_engine_unless_a_centre_stays_behind_a_surface(
    depth: float, stays: bool, named: bool, tmp_path: Path
) -> None:
    source, path = Soft(depth * RADIUS, stays), tmp_path / "soft.rrd"
    with carom.record.Recorder(source, path) as recorder:
        for source.step in range(1, 60):
            recorder.frame()
    assert [fault.law for fault in recorder.faults] == ["overlap"] * named
    shown = CliRunner().invoke(app, ["inspect", str(path), "--check"])
    assert shown.exit_code == named and f"deepest overlap {100 * depth:.3g}%" in shown.stdout


def dropped(engine: str, restitution: float) -> tuple[carom.record.Source, Callable[[], None]]:
    """Drop eight balls of one stack onto a plane."""
    n, rng, dt = 8, np.random.default_rng(7), 1.0 / 240.0
    places = [(*rng.uniform(-0.05, 0.05, 2), 0.2 + 0.25 * k) for k in range(n)]
    if engine == "pybullet":
        pybullet = pytest.importorskip("pybullet")
        client = pybullet.connect(pybullet.DIRECT)
        pybullet.setGravity(0.0, 0.0, -9.81, physicsClientId=client)
        shape = pybullet.createCollisionShape(pybullet.GEOM_SPHERE, radius=0.1, physicsClientId=client)
        plane = pybullet.createCollisionShape(pybullet.GEOM_PLANE, physicsClientId=client)
        damped = 0.0 if restitution == 1.0 else 0.04  # its default
        for mass, form, place in ((0.0, plane, (0.0, 0.0, 0.0)), *((1.0, shape, place) for place in places)):
            body = pybullet.createMultiBody(mass, form, basePosition=place, physicsClientId=client)
            law = {"restitution": restitution, "linearDamping": damped, "angularDamping": damped}
            pybullet.changeDynamics(body, -1, physicsClientId=client, **law)
        source = carom.record.pybullet(dt, (0.0, 0.0, -9.81), client, contacts=False)
        return source, lambda: pybullet.stepSimulation(client)
    if engine == "mujoco":
        mujoco = pytest.importorskip("mujoco")
        balls = "".join(
            f'<body pos="{x} {y} {z}"><freejoint/><geom size="0.1" mass="1" solref="0.01 0.3"/></body>'
            for x, y, z in places
        )
        xml = f'<mujoco><worldbody><geom type="plane" size="9 9 1" solref="0.01 0.3"/>{balls}</worldbody></mujoco>'
        model = mujoco.MjModel.from_xml_string(xml)
        data = mujoco.MjData(model)
        return carom.record.mujoco(model, data, contacts=False), lambda: mujoco.mj_step(model, data)
    robox3d = pytest.importorskip("robox3d")
    world = robox3d.World(gravity=(0.0, 0.0, -9.81), substeps=4)
    world.create_body(position=(0.0, 0.0, -1.0), kind="static").add_box((50.0, 50.0, 1.0), restitution=0.8)
    for place in places:
        world.create_body(position=place, kind="dynamic").add_sphere(0.1, density=240.0, restitution=0.8)
    planes = (carom.record.Plane((0.0, 0.0, 1.0), 0.0, "floor"),)
    return carom.record.box3d(world, planes, contacts=False), lambda: world.step(dt)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("engine", "restitution"), [("pybullet", 1.0), ("pybullet", 0.64), ("mujoco", 0.4), ("box3d", 0.8)]
)
def test_a_healthy_engine_is_not_accused(engine: str, restitution: float, tmp_path: Path) -> None:
    source, step = dropped(engine, restitution)
    with carom.record.Recorder(source, tmp_path / "run.rrd") as recorder:
        for _ in range(300):
            step()
            recorder.frame()
    assert recorder.problems == [] and recorder.faults == []
    done = CliRunner().invoke(app, ["inspect", str(tmp_path / "run.rrd"), "--check"])
    assert done.exit_code == 0
    # PyBullet turns a part of each overlap into speed, which restitution 1 does not hide
    assert ("parting overlapping bodies added" in done.stdout) == (restitution == 1.0)
    # its default damping is c (1 + |v|)
    damped = "free bodies lose speed at one common rate, 0.04 + 0.04 × speed; laws are judged beyond it"
    assert (damped in " ".join(done.stdout.split())) == (restitution == 0.64)


class Falling:
    """Balls that fall with a damping, a constant push or both, in steps that are exact to first order."""

    def __init__(self, damping: float, push: float, tells: bool) -> None:
        self.damping, self.push, self.tells, self.step = damping, push, tells, 0
        self.x, self.v = np.array([[k, 0.0, 20.0] for k in range(3)]), np.array([[0.0, k + 1.0, 5.0] for k in range(3)])
        self.force = np.zeros((3, 3))
        self.model = carom.record.Model(engine="mine 1", mass=[1.0, 2.0, 3.0], radius=[RADIUS] * 3, gravity=(0, 0, -10))

    def advance(self) -> None:
        self.force[1, 0] = self.push
        acceleration = (
            np.array([0.0, 0.0, -10.0]) - self.damping * self.v + self.force / np.array([[1.0], [2.0], [3.0]])
        )
        self.x = self.x + DT * self.v + 0.5 * DT**2 * acceleration
        self.v = self.v + DT * acceleration
        self.step += 1

    def state(self) -> carom.record.State:
        spin = np.zeros((3, 3))
        force = self.force if self.tells else None
        return carom.record.State(self.step * DT, self.x, self.v, angular_velocity=spin, force=force)


@pytest.mark.parametrize(
    ("damping", "push", "tells", "broken"),
    [(0.5, 0.0, False, False), (0.0, 4.0, True, False), (0.0, 4.0, False, True), (0.5, 4.0, True, False)],
)
def test_laws_are_judged_beyond_damping_and_beyond_forces_that_the_engine_was_told(
    damping: float, push: float, tells: bool, broken: bool, tmp_path: Path
) -> None:
    source, path = Falling(damping, push, tells), tmp_path / "run.rrd"
    with carom.record.Recorder(source, path) as recorder:
        for _ in range(40):
            source.advance()
            recorder.frame()
    named = {fault.law for fault in recorder.faults if broken or fault.step > 2}  # two frames show the damping
    assert named == ({"momentum", "energy"} if broken else set())
    summary = carom.Recording.open(path).summary()
    assert summary["forces"].get("damping", {"rate": 0.0})["rate"] == pytest.approx(damping, rel=1e-3)
    # the exact work of the damping, or of the push on body 1, within the first order of a step
    gained = summary["energy"]["final"] - summary["energy"]["initial"]
    assert broken or summary["forces"]["work"] == pytest.approx(gained, rel=0.05)
