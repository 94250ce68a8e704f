"""Recordings of other engines in which bodies merge, come and go."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.csv as pc
import pytest

import carom
from carom.errors import RecordingError
from carom.lab.diff.diff import diff
from carom.lab.statistics import Interval
from carom.lab.statistics.motion_statistics import measure_free_paths, measure_velocities
from carom.lab.statistics.structure_statistics import measure_network
from carom.recording.edit.clip import clip
from carom.recording.read.recording import Recording
from carom_command import carom as command

DT, MERGER, POUR, STEPS = 0.1, 10, 20, 30
SINGLE = 1e-6  # relative, of float32


class Toy:
    """Three bodies above a floor that carries them, two of which merge; later one is poured."""

    def __init__(self, gone: int = STEPS + 1) -> None:
        self.ids, self.mass, self.radius = [7, 3, 5], [1.0, 2.0, 4.0], [0.1, 0.2, 0.3]
        self.position = np.array([[0.0, 0.0, 0.1], [1.0, 0.0, 0.2], [3.0, 0.0, 0.3]])
        self.velocity = np.array([[0.5, 0.0, 0.0], [-0.2, 0.0, 0.0], [0.0, 0.1, 0.0]])
        self.steps, self._gone = 0, gone
        floor = carom.record.Plane((0.0, 0.0, 1.0), 0.0, "floor")
        self.model = carom.record.Model(engine="toy 1.0", mass=self.mass, radius=self.radius, planes=[floor])

    def step(self) -> None:
        self.steps += 1
        self.position = self.position + DT * self.velocity
        if self.steps == MERGER:  # into one body in the middle, which comes last: engines move bodies in memory
            m = np.array(self.mass[:2])
            ends = [(m @ each[:2] / m.sum(), each[2:]) for each in (self.position, self.velocity)]
            self.position, self.velocity = (np.vstack((kept, merged)) for merged, kept in ends)
            self.ids, self.mass, self.radius = [5, 3], [4.0, 3.0], [0.3, 9.0 ** (1 / 3) * 0.1]
            self.position[1, 2] = self.radius[1]  # on the floor
        if self.steps == POUR:
            self.ids, self.mass, self.radius = [*self.ids, 9], [*self.mass, 0.5], [*self.radius, 0.05]
            self.position = np.vstack((self.position, (0.0, 2.0, 0.05)))
            self.velocity = np.vstack((self.velocity, np.zeros(3)))
        if self.steps == self._gone:
            self.ids, self.mass, self.radius = self.ids[1:], self.mass[1:], self.radius[1:]
            self.position, self.velocity = self.position[1:], self.velocity[1:]

    def state(self) -> carom.record.State:
        n = len(self.ids)
        weight = np.zeros(n, carom.record.CONTACT)
        weight["i"], weight["j"], weight["normal"], weight["point"] = np.arange(n), n, (0, 0, -1), self.position
        weight["force"] = 9.81 * np.array(self.mass)
        return carom.record.State(
            DT * self.steps,
            self.position,
            self.velocity,
            contacts=weight,
            ids=self.ids,
            mass=self.mass,
            radius=self.radius,
        )


def recorded(toy: Toy, path: Path) -> carom.record.Recorder:
    with carom.record.Recorder(toy, path) as recorder:
        for _ in range(STEPS):
            toy.step()
            assert recorder.frame()
    return recorder


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    path = tmp_path_factory.mktemp("toy") / "toy.rrd"
    recorder = recorded(Toy(), path)
    assert recorder.problems == [] and recorder.faults == []
    return Recording.open(path)


def test_statistics_of_a_run_count_only_the_bodies_that_exist(recording: Recording) -> None:
    interval = Interval.of(recording, None, None, False, lambda _: None)
    contacts = measure_network(interval).values
    assert contacts["coordination"].value == 1.0  # each body lies on the floor
    expected = []
    for state in recording.checkpoints():
        there = recording.present(state.step)
        mass, velocity = recording.bodies.mass[there], state.velocity[there]
        c = velocity - mass @ velocity / mass.sum()
        expected.append(float(np.sum(mass[:, None] * c * c)) / (3 * len(mass)))
    temperature = measure_velocities(interval).values["temperature"].value
    assert temperature == pytest.approx(np.mean(expected[1:]), rel=1e-12)  # without step 0
    with pytest.raises(RecordingError, match="bodies come and go"):
        measure_free_paths(interval)


def test_a_state_has_only_the_bodies_that_exist_and_a_merger_keeps_mass_and_momentum(recording: Recording) -> None:
    present, sums = {}, {}
    for step in (0, MERGER - 1, MERGER, POUR - 1, POUR, STEPS):
        table = recording.bodies(DT * step)
        present[step] = table["body"].to_pylist()
        mass = recording.bodies.mass[present[step]]
        sums[step] = (mass.sum(), mass @ table["vx"].to_numpy(), mass @ table["vy"].to_numpy())
    assert present == {0: [0, 1, 2], 9: [0, 1, 2], 10: [2, 3], 19: [2, 3], 20: [2, 3, 4], 30: [2, 3, 4]}
    assert sums[MERGER] == pytest.approx(sums[MERGER - 1], rel=1e-15)  # a few roundings
    assert list(recording.bodies.name) == ["body 0", "body 1", "body 2", "body 1 (2)", "body 4"]
    assert recording.lives is not None
    assert recording.lives.tolist() == [[0, 9], [0, 9], [0, 30], [10, 30], [20, 30]]


def test_inspect_counts_the_bodies_that_came_and_went(recording: Recording) -> None:
    assert recording.summary()["lives"] == {"came": 2, "went": 2}
    told = command("inspect", str(recording.path), cwd=recording.path.parent).stdout
    assert "2 came after the first frame, 2 went before the last" in told


def test_a_path_ends_with_its_body(recording: Recording) -> None:
    assert recording.trajectory(0)["step"].to_pylist() == list(range(MERGER))
    assert recording.trajectory("body 4")["step"].to_pylist() == list(range(POUR, STEPS + 1))
    with pytest.raises(RecordingError, match="body 4 does not exist from 0 to 1 s"):
        recording.trajectory(4, 0.0, 1.0)


def test_a_body_that_does_not_exist_is_drawn_nowhere(recording: Recording) -> None:
    for step in range(STEPS + 1):
        drawn = recording.drawn_positions(step)
        assert drawn is not None and np.array_equal(np.isfinite(drawn[:, 0]), recording.present(step))


def test_the_floor_carries_the_bodies_that_exist(recording: Recording) -> None:
    for step in (5, 15, 25):
        there = np.flatnonzero(recording.present(step)).tolist()
        table = recording.contacts(DT * step)
        assert table["i"].to_pylist() == there
        assert table["j"].to_pylist() == [5] * len(there)  # the floor, after all bodies of the run
        assert table["normal_force"].to_pylist() == pytest.approx(9.81 * recording.bodies.mass[there], rel=SINGLE)


def test_what_bodies_bring_and_take_is_no_error_of_the_energy(recording: Recording) -> None:
    energy = recording.energy("total", "integration_error")
    total = energy["total"].to_numpy()
    assert total[MERGER] < 0.2 * total[MERGER - 1]  # of the two only the motion of their centre is left
    assert np.abs(energy["integration_error"].to_numpy()).max() < 1e-15 * total.max()


def test_exports_have_the_bodies_that_exist(recording: Recording, tmp_path: Path) -> None:
    for name in ("all.csv", "all.npz"):
        assert command("export", str(recording.path), "--all", "-o", name, cwd=tmp_path).returncode == 0
    rows = pc.read_csv(tmp_path / "all.csv")
    at = rows.filter(np.array(rows["step"]) == MERGER)
    assert (at["body"].to_pylist(), at["mass [kg]"].to_pylist()) == ([2, 3], [4.0, 3.0])
    assert rows.num_rows == 3 * MERGER + 2 * (POUR - MERGER) + 3 * (STEPS + 1 - POUR)
    with np.load(tmp_path / "all.npz", allow_pickle=False) as arrays:
        there = np.array([recording.present(step) for step in range(STEPS + 1)])
        assert np.array_equal(np.isfinite(arrays["position"][:, :, 0]), there)


def test_clips_keep_the_lives_of_their_bodies(recording: Recording, tmp_path: Path) -> None:
    clip(recording.path, tmp_path / "clip.rrd", 0.5, 1.5)
    clip(recording.path, tmp_path / "some.rrd", 0.5, 2.5, bodies=[2, 3])
    whole, some = Recording.open(tmp_path / "clip.rrd"), Recording.open(tmp_path / "some.rrd")
    assert whole.bodies(0.5)["body"].to_pylist() == [0, 1, 2] and whole.bodies(1.5)["body"].to_pylist() == [2, 3]
    drawn = some.drawn_positions(5)
    assert drawn is not None and np.isfinite(drawn[:, 0]).tolist() == [True, False]
    assert some.contacts(1.5)["i"].to_pylist() == [2, 3]
    assert diff(recording, whole).same


def test_a_comparison_names_the_bodies_that_exist_in_one_run_only(recording: Recording, tmp_path: Path) -> None:
    recorded(Toy(gone=25), tmp_path / "other.rrd")
    found = diff(recording, Recording.open(tmp_path / "other.rrd"))
    assert [(life.body, life.text(recording.units)) for life in found.lives] == [
        (2, "body 2 exists 0 to 3 s in A, 0 to 2.4 s in B")
    ]
    assert found.curve.step[np.argmax(found.curve.differs)] == 25 and np.max(found.curve.rms) == 0.0
    told = command("diff", str(recording.path), "other.rrd", cwd=tmp_path)
    assert told.returncode == 1 and "body 2 exists 0 to 3 s in A, 0 to 2.4 s in B" in told.stdout


def test_the_last_frames_of_a_changing_run_are_written(tmp_path: Path) -> None:
    toy = Toy()
    recorder = carom.record.Recorder(toy, tmp_path / "last.rrd", last=5)
    for _ in range(POUR + 2):
        toy.step()
        recorder.frame()
    last = recorder.write()
    assert last is not None and last.bodies()["body"].to_pylist() == [2, 3, 4]
    assert last.bodies.mass.tolist() == [1.0, 2.0, 4.0, 3.0, 0.5]
    assert last.lives is not None and last.lives[:2].tolist() == [[-1, -1]] * 2  # gone before the first frame


@pytest.mark.slow
def test_a_killed_run_in_which_bodies_came_is_repaired(tmp_path: Path) -> None:
    code = (
        "import os, time, carom; from test_changing_bodies import Toy\n"
        "toy = Toy()\n"
        "recorder = carom.record.Recorder(toy, 'run.rrd')\n"
        "for _ in range(60):\n"
        "    toy.step()\n"
        "    recorder.frame()\n"
        "while not os.path.exists('run.rrd') or b'/state/lives' not in open('run.rrd', 'rb').read():\n"
        "    time.sleep(0.1)\n"
        "os.kill(os.getpid(), 9)\n"
    )
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(Path(__file__).parent), *sys.path])}
    subprocess.run([sys.executable, "-c", code], cwd=tmp_path, env=environment, check=False, timeout=60)
    assert command("repair", "run.rrd", "-o", "whole.rrd", cwd=tmp_path).returncode == 0
    whole = Recording.open(tmp_path / "whole.rrd")
    assert whole.frames > POUR + 1 and len(whole.bodies.mass) == 5
    assert whole.bodies(DT * MERGER)["body"].to_pylist() == [2, 3]
    drawn = whole.drawn_positions(0)
    assert drawn is not None and np.isfinite(drawn[:, 0]).tolist() == [True, True, True, False, False]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"ids": [5, 5]}, "toy 1.0: the id 5 occurs twice"),
        ({"ids": [5]}, "toy 1.0: ids must be 2 whole numbers"),
        ({"ids": [5, 8], "mass": None}, "toy 1.0: the body with the id 8 is new; give its mass and its radius"),
        ({"mass": [4.0]}, "toy 1.0: mass has the shape (1,) instead of (2,)"),
    ],
)
def test_bodies_that_cannot_be_told_apart_are_noted(
    change: dict[str, Any], message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    right = Toy.state
    monkeypatch.setattr(Toy, "state", lambda toy: replace(right(toy), **(change if toy.steps == 12 else {})))
    recorder = recorded(Toy(), tmp_path / "toy.rrd")
    (problem,) = recorder.problems
    assert problem.startswith(message)
    recording = Recording.open(tmp_path / "toy.rrd")
    assert recording.frames == STEPS and recording.lives is not None and len(recording.lives) == 5


@pytest.mark.needs("rebound")
def test_a_merger_of_rebound_ends_two_bodies_and_begins_one(tmp_path: Path) -> None:
    import rebound

    simulation = rebound.Simulation()
    simulation.G, simulation.dt, simulation.integrator = 1.0, 0.01, "leapfrog"
    simulation.collision, simulation.collision_resolve = "direct", "merge"
    for mass, x, speed in ((1.0, 0.0, 0.0), (0.5, 1.0, -1.0), (1e-3, 5.0, 0.0), (2e-3, -6.0, 0.0)):
        simulation.add(m=mass, r=0.1, x=x, vx=speed)
    with carom.record.Recorder(carom.record.rebound(simulation, changing=True), tmp_path / "run.rrd") as recorder:
        while simulation.t < 1.0:
            simulation.steps(1)
            recorder.frame()
    assert recorder.problems == []
    recording = Recording.open(tmp_path / "run.rrd")
    last = recording.bodies(1.0)
    assert last["body"].to_pylist() == [2, 3, 4]
    assert recording.bodies.mass.tolist() == [1.0, 0.5, 1e-3, 2e-3, 1.5]
    by_mass = {particle.m: particle.x for particle in simulation.particles}
    assert dict(zip(recording.bodies.mass[[2, 3, 4]].tolist(), last["x"].to_pylist(), strict=True)) == by_mass


class Poured:
    """One body, and thousands that are poured after it: more than a run may begin with to be drawn in detail."""

    def __init__(self) -> None:
        self.steps, self.model = 0, carom.record.Model(engine="poured", mass=[1.0], radius=[0.1])

    def state(self) -> carom.record.State:
        n = 1 + 1500 * self.steps
        position = np.arange(n)[:, None] * [1.0, 0.0, 0.0]
        ids, mass, radius = np.arange(n), np.ones(n), np.full(n, 0.1)
        return carom.record.State(DT * self.steps, position, np.zeros((n, 3)), ids=ids, mass=mass, radius=radius)


def test_a_run_that_grows_to_thousands_of_bodies_keeps_the_shape_of_its_first_frame(tmp_path: Path) -> None:
    poured = Poured()
    with carom.record.Recorder(poured, tmp_path / "run.rrd") as recorder:
        for poured.steps in range(1, 4):
            recorder.frame()
    assert recorder.problems == []
    recording = Recording.open(tmp_path / "run.rrd")
    assert [int(recording.present(step).sum()) for step in range(4)] == [1, 1501, 3001, 4501]
    path = recording.trajectory(4500)  # drawn in float32, and exact
    assert path["x"].to_pylist() == [4500.0] and recording.bodies(2 * DT).num_rows == 3001
    clip(recording.path, tmp_path / "part.rrd", 2 * DT, 3 * DT)
    assert Recording.open(tmp_path / "part.rrd").bodies(3 * DT).num_rows == 4501


class Visits(Toy):
    """A run that begins and ends without bodies, and has none in between."""

    def state(self) -> carom.record.State:
        k = self.steps
        ids = [1] if 5 <= k < 10 else [1, 2] if 10 <= k < 15 else [3] if 20 <= k < 25 else []
        self.ids, self.mass, self.radius = ids, [1.0] * len(ids), [0.5] * len(ids)
        self.position = np.array([[each + DT * k, 0.0, 0.5] for each in ids]).reshape(-1, 3)
        self.velocity = np.tile([1.0, 0.0, 0.0], (len(ids), 1))
        return super().state()

    def step(self) -> None:
        self.steps += 1


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_a_run_may_begin_and_end_without_bodies_and_have_none_in_between(tmp_path: Path) -> None:
    visits = Visits()
    visits.model = replace(visits.model, mass=[], radius=[])
    recorder = recorded(visits, tmp_path / "run.rrd")
    assert recorder.problems == ["toy 1.0: there is no body before t = 0.5 s. The recording begins there."]
    assert recorder.faults == []
    recording = Recording.open(tmp_path / "run.rrd")
    assert recording.lives is not None and recording.lives.tolist() == [[5, 14], [10, 14], [20, 24]]
    there = {step: recording.bodies(DT * step).num_rows for step in (5, 12, 17, 22, STEPS)}
    assert there == {5: 1, 12: 2, 17: 0, 22: 1, STEPS: 0} and recording.frames == STEPS - 4
    assert recording.contacts(1.2).num_rows == 2 and recording.contacts(1.7).num_rows == 0
    assert sum(state.position.shape == (3, 3) for state in recording.checkpoints()) == STEPS - 4
    clip(recording.path, tmp_path / "nobody.rrd", 1.6, 1.9)
    nobody = Recording.open(tmp_path / "nobody.rrd")
    assert nobody.frames == 4 and nobody.bodies(1.7).num_rows == 0 and nobody.summary()
    assert diff(recording, nobody).first_bits is None
    for suffix in ("csv", "npz", "extxyz", "vtk", "parquet"):
        for what in (["--all"], ["--at", "1.7"]):
            name = f"{what[0][2:]}.{suffix}"
            assert command("export", "run.rrd", *what, "-o", name, cwd=tmp_path).returncode == 0, name


def run_pybullet(path: Path) -> carom.record.Recorder:
    engine = pytest.importorskip("pybullet")
    client = engine.connect(engine.DIRECT)
    engine.setTimeStep(DT / 10)
    ball = engine.createCollisionShape(engine.GEOM_SPHERE, radius=0.1)
    engine.createMultiBody(0.0, engine.createCollisionShape(engine.GEOM_PLANE))
    source = carom.record.pybullet(DT / 10, (0.0, 0.0, 0.0), client, changing=True)
    bodies: list[int] = []
    with carom.record.Recorder(source, path) as recorder:
        for step in range(1, STEPS + 1):
            if step in (5, 10):
                bodies.append(engine.createMultiBody(1.0, ball, basePosition=(float(len(bodies)), 0.0, 1.0)))
            if step == 15:
                engine.removeBody(bodies[0])
                new = engine.createMultiBody(1.0, ball, basePosition=(5.0, 0.0, 1.0))
                assert new == bodies[0], "PyBullet reuses the id"
            if step == 25:
                engine.removeBody(new)
                engine.removeBody(bodies[1])
            engine.stepSimulation()
            recorder.frame()
    engine.disconnect(client)
    return recorder


def run_box3d(path: Path) -> carom.record.Recorder:
    engine = pytest.importorskip("robox3d")
    destroy = pytest.importorskip("robox3d._ffi").lib.b3DestroyBody
    world = engine.World(gravity=(0.0, 0.0, 0.0))

    def ball(x: float) -> Any:
        found = world.create_body(position=(x, 0.0, 1.0), kind="dynamic")
        found.add_sphere(0.1, density=1000.0)
        return found

    bodies: list[Any] = []
    with carom.record.Recorder(carom.record.box3d(world, contacts=True, changing=True), path) as recorder:
        for step in range(1, STEPS + 1):
            if step in (5, 10):
                bodies.append(ball(float(len(bodies))))
            if step == 15:
                destroy(bodies[0].id)
                new = ball(5.0)
                assert new.id.index1 == bodies[0].id.index1, "Box3D reuses the place"
            if step == 25:
                destroy(new.id)
                destroy(bodies[1].id)
            world.step(DT / 10)
            recorder.frame()
    return recorder


@pytest.mark.parametrize("run", [run_pybullet, run_box3d])
def test_bodies_of_engines_that_create_and_destroy_them_keep_their_numbers(run: Any, tmp_path: Path) -> None:
    (problem,) = run(tmp_path / "run.rrd").problems
    assert "there is no body before t = 0.05 s. The recording begins there." in problem
    recording = Recording.open(tmp_path / "run.rrd")
    assert recording.lives is not None and recording.lives.tolist() == [[5, 14], [10, 24], [15, 24]]
    table = recording.bodies(0.2)
    assert table["x"].to_pylist() == [1.0, 5.0] and table["name"].to_pylist() == ["body 1", "body 2"]
    assert recording.bodies(0.3).num_rows == 0
