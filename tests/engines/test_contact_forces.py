"""The contact forces that other engines report: what is recorded of them obeys Newton's laws, and commands show it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import carom
from carom.display.body_colours import BodyColours, fixed_colours
from carom.display.close_up import close_up
from carom.display.request import shown_step
from carom.lab.why.history import question_of
from carom.lab.why.why import why
from carom.recording.layout.canvas import Area
from carom.recording.read.lookup import frame_of
from carom.recording.read.named_events import Pair
from carom.recording.read.recorded_contacts import rows_of_engine
from carom.recording.read.recorded_scene import header_of_recording
from carom.recording.read.recording import Recording
from carom_command import carom as command

G = np.array([0.0, 0.0, -9.81])
DT = 0.001  # s
STEPS = 60
MASS = {"ball": 1.0, "top": 0.5, "box": 2.0, "slider": 1.0}
PLACE = {"ball": (0.0, 0.0, 0.1), "top": (0.02, 0.0, 0.299), "box": (2.0, 0.0, 0.1), "slider": (-2.0, 0.0, 0.1)}


def run_mujoco(path: Path, **options: Any) -> None:
    import mujoco

    def body(name: str) -> str:
        shape = 'type="box" size="0.2 0.3 0.1"' if name == "box" else 'type="sphere" size="0.1"'
        place = " ".join(map(str, PLACE[name]))
        geom = f'<geom {shape} mass="{MASS[name]}" friction="0.3 0 0"/>'
        return f'<body name="{name}" pos="{place}"><freejoint/>{geom}</body>'

    floor = '<geom name="floor" type="plane" size="0 0 1" friction="0.3 0 0"/>'
    text = f'<option timestep="{DT}"/><worldbody>{floor}{"".join(map(body, MASS))}</worldbody>'
    model = mujoco.MjModel.from_xml_string(f"<mujoco>{text}</mujoco>")
    data = mujoco.MjData(model)
    data.qvel[18:20] = [3.0, -1.0]
    with carom.record.Recorder(carom.record.mujoco(model, data), path, **options) as recorder:
        for _ in range(STEPS):
            mujoco.mj_step(model, data)
            recorder.frame()
    assert recorder.problems == []


def run_pybullet(path: Path, **options: Any) -> None:
    pybullet = pytest.importorskip("pybullet")  # not required: it has no wheels for newer versions of Python
    client = pybullet.connect(pybullet.DIRECT)
    pybullet.setTimeStep(DT)
    pybullet.setGravity(*G)
    plane = pybullet.createCollisionShape(pybullet.GEOM_PLANE)
    numbers = [pybullet.createMultiBody(0.0, plane)]
    for name, mass in MASS.items():
        kind = (
            pybullet.createCollisionShape(pybullet.GEOM_BOX, halfExtents=[0.2, 0.3, 0.1])
            if name == "box"
            else pybullet.createCollisionShape(pybullet.GEOM_SPHERE, radius=0.1)
        )
        numbers.append(pybullet.createMultiBody(mass, kind, basePosition=PLACE[name]))
    for number in numbers:
        pybullet.changeDynamics(number, -1, linearDamping=0.0, angularDamping=0.0, lateralFriction=0.5)
    pybullet.resetBaseVelocity(numbers[-1], [3.0, -1.0, 0.0])
    source = carom.record.pybullet(DT, tuple(G), client)
    with carom.record.Recorder(source, path, **options) as recorder:
        for _ in range(STEPS):
            pybullet.stepSimulation()
            recorder.frame()
    pybullet.disconnect(client)
    assert recorder.problems == []


RUNS = {"mujoco": run_mujoco, "pybullet": run_pybullet}


@pytest.fixture(scope="module", params=[pytest.param("mujoco", marks=pytest.mark.needs("mujoco")), "pybullet"])
def recording(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Recording:
    path = tmp_path_factory.mktemp(request.param) / "run.rrd"
    RUNS[request.param](path)
    return Recording.open(path)


def test_recorded_contact_forces_change_momenta_as_newton_says(recording: Recording) -> None:
    # both engines kick by F dt; the impulses are recorded in float32
    times = [checkpoint.time for checkpoint in recording.checkpoints()]
    mass = np.array(list(MASS.values()))
    radius, friction = 0.1, 0.0
    for before, after in zip(recording.checkpoints(), list(recording.checkpoints())[1:], strict=False):
        rows = recording.contacts(after.time).to_pylist()
        given = mass[:, None] * G * (after.time - before.time)
        torque = np.zeros((len(mass), 3))
        for row, impulse in zip(rows, vectors(recording, after.time), strict=True):
            point = np.array([row["x"], row["y"], row["z"]])
            for end, sign in ((row["i"], -1.0), (row["j"], 1.0)):
                if end < len(mass):
                    given[end] += sign * impulse
                    torque[end] += np.cross(point - before.position[end], sign * impulse)
            friction = max(friction, row["tangential_force"])
        change = mass[:, None] * (after.velocity - before.velocity)
        np.testing.assert_allclose(change, given, atol=1e-6 * mass.max() * 9.81 * DT + 1e-6 * np.abs(given).max())
        assert before.angular_velocity is not None and after.angular_velocity is not None
        for ball in (0, 1, 3):
            spun = 0.4 * mass[ball] * radius**2 * (after.angular_velocity[ball] - before.angular_velocity[ball])
            # contact points are on the surfaces, whose overlap is below 2 % of a radius here
            most = 0.02 * radius * float(np.linalg.norm(given[ball])) + 1e-6 * DT
            np.testing.assert_allclose(spun, torque[ball], atol=most)
    assert len(times) == STEPS + 1 and friction > 1.0


def vectors(recording: Recording, time: float) -> list[np.ndarray]:
    """Return the impulses of the contacts of a frame on their second ends."""
    row = frame_of(recording, time)
    assert row is not None
    rows, dt = rows_of_engine(recording, row)
    assert dt == pytest.approx(DT)
    return [
        each["normal_impulse"] * np.array([each[f"n{axis}"] for axis in "xyz"])
        + [each[f"friction_{axis}"] for axis in "xyz"]
        for each in rows
    ]


def test_commands_show_recorded_contact_forces_and_count_impacts(recording: Recording) -> None:
    folder = recording.path.parent
    done = command("contacts", "run.rrd", "--body", "2", "--at", str(20 * DT), cwd=folder)
    assert done.returncode == 0 and "1 contact in step 20, recorded" in done.stdout
    rows = recording.contacts(STEPS * DT).to_pylist()
    (box,) = [row for row in rows if row["i"] == 2]
    # four corners as one contact below the centre; each engine's springs have settled within 2 %
    assert box["normal_force"] == pytest.approx(2.0 * 9.81, rel=0.02) and box["mode"] == "resting"
    assert [box["x"], box["y"], box["z"]] == pytest.approx([2.0, 0.0, 0.0], abs=2e-3)
    assert [box["nx"], box["ny"], box["nz"]] == [0.0, 0.0, -1.0] and box["approach_speed"] is None
    done = command("contacts", "run.rrd", "--impacts", cwd=folder)
    assert done.returncode == 0 and "measured from the states of successive frames" in done.stdout
    said = command("contacts", "run.rrd", "--statistics", cwd=folder).stdout
    assert "mean approach speed" in said and "contacts of a body  " in said
    assert "impacts" not in recording.summary()["impacts"]
    assert command("clip", "run.rrd", "--from", "0.02", "--to", "0.04", "-o", "c.rrd", cwd=folder).returncode == 0
    clip = Recording.open(folder / "c.rrd")
    assert clip.contacts(0.03).equals(recording.contacts(0.03))


def test_a_close_up_of_a_recorded_contact_has_its_force(recording: Recording) -> None:
    header = header_of_recording(recording)
    colours = BodyColours(np.zeros(1, np.int64), np.zeros(1), fixed_colours(recording)[None])
    close = close_up(recording, header, shown_step(recording, STEPS * DT), Pair(0, 1), Area(400.0, 400.0), colours)
    assert close.pair.contact is not None and close.pair.contact.force is not None
    (row,) = [row for row in recording.contacts(STEPS * DT).to_pylist() if (row["i"], row["j"]) == (0, 1)]
    assert close.pair.contact.force == pytest.approx(np.hypot(row["normal_force"], row["tangential_force"]), rel=1e-6)
    assert close.pair.contact.point + recording.origin == pytest.approx([row["x"], row["y"], row["z"]], abs=1e-6)


class Balls:
    """Two balls that push each other; the contacts are those of a function of the step."""

    model = carom.record.Model(engine="balls", mass=[1.0, 1.0], radius=[0.5, 0.5])

    def __init__(self, contacts: Callable[[int], Any]) -> None:
        self.step, self._contacts = 0, contacts

    def state(self) -> carom.record.State:
        position = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]
        return carom.record.State(0.1 * self.step, position, np.zeros((2, 3)), contacts=self._contacts(self.step))


def contact(**changes: Any) -> np.ndarray:
    """Return one contact of the balls, given from the second to the first."""
    found = np.zeros(1, carom.record.CONTACT)
    usual = {"i": 1, "point": [0.5, 0.0, 0.0], "normal": [-1.0, 0.0, 0.0], "force": 3.0, "friction": [0.0, 2.0, 0.0]}
    for name, value in (usual | changes).items():
        found[name] = value
    return found


def recorded(contacts: Callable[[int], Any], path: Path) -> carom.record.Recorder:
    balls = Balls(contacts)
    with carom.record.Recorder(balls, path) as recorder:
        for balls.step in range(1, 5):
            recorder.frame()
    return recorder


def test_contacts_of_a_source_are_recorded_from_the_smaller_body_to_the_larger(tmp_path: Path) -> None:
    assert recorded(lambda step: contact()[: step % 2], tmp_path / "run.rrd").problems == []
    recording = Recording.open(tmp_path / "run.rrd")
    (row,) = recording.contacts(0.3).to_pylist()
    assert (row["i"], row["j"], row["nx"], row["x"]) == (0, 1, 1.0, 0.5)
    assert (row["normal_force"], row["tangential_force"]) == pytest.approx((3.0, 2.0), rel=1e-6)  # float32
    assert recording.contacts(0.4).num_rows == 0
    told = command("inspect", "run.rrd", cwd=tmp_path).stdout
    assert "balls; the recording has states and contact forces" in told
    (rows, dt) = rows_of_engine(recording, 3)
    assert dt == pytest.approx(0.1) and rows["friction_y"] == pytest.approx([-0.2])  # on the second: the opposite


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (np.zeros(1, [("i", int), ("j", int)]), "balls: contacts lack the field point; make them"),
        (contact(i=2), "balls: a contact has the numbers 2 and 0; bodies are 0 to 1, planes up to 1"),
        (contact(i=0), "balls: a contact has the numbers 0 and 0;"),
        (contact(force=np.nan), "balls: contacts[0] has a force that is not finite"),
        (contact(normal=[-2, 0, 0]), "balls: the normal of contacts[0] has the length 2; it must be 1"),
        ([[0, 1]], "balls: contacts have no forces, and had some in the first state"),
    ],
)
def test_invalid_contacts_are_noted_and_their_frame_has_the_pairs_that_touch(
    wrong: Any, message: str, tmp_path: Path
) -> None:
    recorder = recorded(lambda step: wrong if step == 2 else contact(), tmp_path / "run.rrd")
    (problem,) = recorder.problems
    assert problem.startswith(message) and problem.endswith("Its contacts are computed from distances.")
    recording = Recording.open(tmp_path / "run.rrd")
    forces = [recording.contacts(0.1 * step)["normal_force"][0].as_py() for step in range(1, 5)]
    assert recording.frames == 5 and forces == pytest.approx([3.0, 0.0, 3.0, 3.0], rel=1e-6)


def rest_in_box3d(path: Path) -> float:
    robox3d = pytest.importorskip("robox3d")
    world = robox3d.World(gravity=tuple(G), substeps=4)
    world.create_body(position=(0.0, 0.0, -1.0), kind="static").add_box((5.0, 5.0, 1.0))
    for place in (0.1, 0.4):
        ball = world.create_body(position=(10.0 * place, 0.0, place), kind="dynamic")
        ball.add_sphere(0.1, density=1.0 / (4.0 / 3.0 * np.pi * 1e-3), restitution=0.0)
    floor = carom.record.Plane((0.0, 0.0, 1.0), 0.0, "floor")
    with carom.record.Recorder(carom.record.box3d(world, (floor,), contacts=True), path) as recorder:
        for _ in range(300):
            world.step(0.002)
            recorder.frame()
    assert recorder.problems == []
    return 1e-6  # in single precision


def rest_in_newton(path: Path) -> float:
    import newton
    import warp

    dt = 0.002
    config = newton.ModelBuilder.ShapeConfig(density=0.0)
    builder = newton.ModelBuilder(gravity=tuple(G))
    for place in (0.1, 0.4):
        at, tensor = (
            warp.transform((10.0 * place, 0.0, place), warp.quat_identity()),
            warp.mat33(np.diag(np.full(3, 0.004))),
        )
        ball = builder.add_body(xform=at, mass=1.0, inertia=tensor, lock_inertia=True)
        builder.add_shape_sphere(ball, radius=0.1, cfg=config)
    builder.add_shape_plane(plane=(0.0, 0.0, 1.0, 0.0), width=0.0, length=0.0, cfg=config)
    model = builder.finalize(device="cpu")
    solver, pipeline = newton.solvers.SolverXPBD(model, iterations=8), newton.CollisionPipeline(model)
    contacts, states, control, steps = pipeline.contacts(), [model.state(), model.state()], model.control(), 0
    observables = solver.observables({"contact_f"}, contacts=contacts)
    source = carom.record.newton(model, lambda: (states[0], steps * dt), (contacts, observables.contact_f))
    with carom.record.Recorder(source, path) as recorder:
        for steps in range(1, 301):  # noqa: B007 - the source reads it
            states[0].clear_forces()
            pipeline.collide(states[0], contacts)
            solver.step(states[0], states[1], control, contacts, dt, observables=observables)
            states.reverse()
            recorder.frame()
    assert recorder.problems == []
    return 2.0 * 0.1 * 2.0**-24 / dt**2 / 9.81  # it moves positions of 0.1 m, rounded to single precision


@pytest.mark.parametrize(
    "rest",
    [
        pytest.param(rest_in_box3d, marks=pytest.mark.slow, id="box3d"),
        # Warp compiles its kernels for half a minute, once on a machine
        pytest.param(rest_in_newton, marks=[pytest.mark.needs("newton"), pytest.mark.slow], id="newton"),
    ],
)
def test_a_floor_holds_a_ball_by_its_weight_and_has_stopped_one_that_fell(
    rest: Callable[[Path], float], tmp_path: Path
) -> None:
    rounding = rest(tmp_path / "run.rrd")
    recording = Recording.open(tmp_path / "run.rrd")
    for row, ball in zip(recording.contacts(0.6).to_pylist(), (0, 1), strict=True):
        assert (row["i"], row["j"], row["nz"]) == (ball, 2, -1.0)
        assert row["normal_force"] == pytest.approx(9.81, rel=rounding)
        assert [row["x"], row["z"]] == pytest.approx([1.0 + 3.0 * ball, 0.0], abs=0.01)  # Box3D removes overlaps slowly
    # the ball rests at the end, so that the floor gave what its weight had
    (account,) = why(recording, question_of(recording, "1", None, None)).accounts
    assert account.by_contacts[2] == pytest.approx(9.81 * 0.6, rel=1e-3)
    assert account.by_field == pytest.approx([0.0, 0.0, -9.81 * 0.6], rel=1e-6)  # Newton computes in float32


@pytest.mark.slow
def test_impacts_in_box3d_have_the_impulses_that_changed_the_velocities(tmp_path: Path) -> None:
    robox3d = pytest.importorskip("robox3d")
    restitution, speed, mass = 0.5, 2.0, 1.0
    world = robox3d.World(gravity=(0.0, 0.0, -9.81), substeps=4)
    world.create_body(position=(0.0, 0.0, -1.0), kind="static").add_box((5.0, 5.0, 1.0), restitution=0.0, friction=0.0)
    places = [(0.0, 0.0, 0.1), (0.5, 0.0, 0.1), (0.9, 0.05, 0.1), (-2.0, 0.0, 0.1), (-2.0, 0.02, 0.6)]
    for place in places:
        ball = world.create_body(position=place, kind="dynamic")
        ball.add_sphere(0.1, density=mass / (4.0 / 3.0 * np.pi * 1e-3), restitution=restitution, friction=0.0)
        ball.linear_velocity = (speed, 0.0, 0.0) if place[0] == 0.0 else (0.0, 0.0, 0.0)
    floor = carom.record.Plane((0.0, 0.0, 1.0), 0.0, "floor")
    with carom.record.Recorder(carom.record.box3d(world, (floor,), contacts=True), tmp_path / "run.rrd") as recorder:
        for _ in range(300):
            world.step(0.002)
            recorder.frame()
    recording = Recording.open(tmp_path / "run.rrd")
    for body in range(len(places)):  # also the ball on the floor that another one falls on
        (account,) = why(recording, question_of(recording, str(body), None, None)).accounts
        # what the impulses leave is gravity, up to single precision of 600 steps
        assert account.by_forces == pytest.approx(account.by_field, abs=2e-3)
    answer = why(recording, question_of(recording, "2", None, None))
    assert [(link.by, link.body) for link in answer.chain] == [(1, 2), (0, 1)]
    assert answer.chain[1].impulse == pytest.approx(0.5 * mass * (1.0 + restitution) * speed, rel=1e-3)
    kinds = {cause.partner: cause.kind for cause in answer.accounts[0].causes}
    assert kinds[1] == "impact" and kinds[len(places)] == "contact"
