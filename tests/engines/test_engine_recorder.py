"""Runs of other engines are recorded, and what is wrong in them is named in the frame where it happens."""

from __future__ import annotations

import dataclasses
import errno
import io
import subprocess
import sys
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import carom
from carom.engines.adapters.pybullet import calls_per_frame
from carom.engines.snapshot_writer import Unrecorded
from carom.engines.source import StateMemory, engine_package
from carom.errors import RecordingError
from carom.recording.read.recorded_scene import header_of_recording
from carom.recording.read.recording import Recording
from carom.recording.schema.series import recorded as series_of
from carom.runs.outcome import overview
from carom_command import carom as command

FAULT = 100  # the step from which each fault is planted
MET = 101  # the step in which the two bodies meet: faults of impacts occur then
STEPS = 130
DT = 0.002  # s; bodies overlap by 2 % of a radius before they bounce
G = np.array([0.0, 0.0, -9.81])


class Toy:
    """A correct engine of three spheres, two of which meet head on at step 100; a fault can be planted in a step."""

    def __init__(self, fault: Callable[[Toy], None] | None = None) -> None:
        self.model = carom.record.Model(
            engine="toy 1.0", mass=[1.0, 2.0, 1.0], radius=[0.1, 0.1, 0.1], gravity=(0.0, 0.0, -9.81)
        )
        self.position = np.array([[-0.3, 0.02, 0.0], [0.3, 0.0, 0.0], [5.0, 0.0, 0.0]])
        self.velocity = np.array([[1.0, 0.0, 3.0], [-1.0, 0.0, 3.0], [0.0, 1.0, 3.0]])
        self.spin = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 5.0]])
        self.steps, self._fault, self.collides = 0, fault, True

    @property
    def time(self) -> float:
        return self.steps * DT

    def step(self) -> None:
        self.steps += 1
        self.position += self.velocity * DT + 0.5 * G * DT * DT
        self.velocity += G * DT
        if self.steps >= FAULT and self._fault:
            self._fault(self)
        if self.collides:
            self.bounce(1.0)

    def bounce(self, restitution: float) -> bool:
        apart = self.position[1] - self.position[0]
        normal = apart / np.linalg.norm(apart)
        closing = float((self.velocity[0] - self.velocity[1]) @ normal)
        touch = bool(np.linalg.norm(apart) <= 0.2 and closing > 0.0)
        if touch:
            self.push((1.0 + restitution) * closing / 1.5 * normal)
        return touch

    def push(self, impulse: np.ndarray, other: np.ndarray | None = None) -> None:
        self.velocity[0] -= impulse
        self.velocity[1] += (impulse if other is None else other) / 2.0

    def state(self) -> carom.record.State:
        return carom.record.State(self.time, self.position, self.velocity, angular_velocity=self.spin)


def recorded(toy: Toy, path: Path, steps: int = STEPS) -> list[carom.record.Fault]:
    with carom.record.Recorder(toy, path) as recorder:
        for _ in range(steps):
            toy.step()
            recorder.frame()
    return recorder.faults


def energy_from_nothing(toy: Toy) -> None:
    toy.collides = not toy.bounce(2.0)


def missed_impact(toy: Toy) -> None:
    toy.collides = False


def force_off_centre(toy: Toy) -> None:
    """Equal and opposite impulses that do not act along one line."""
    if toy.steps == FAULT:
        toy.push(np.array([0.0, 0.5, 0.0]))


def lost_momentum(toy: Toy) -> None:
    apart = toy.position[1] - toy.position[0]
    if toy.collides and np.linalg.norm(apart) <= 0.2:
        toy.push(np.array([1.0, 0.0, 0.0]), np.array([0.5, 0.0, 0.0]))
        toy.collides = False


def not_a_number(toy: Toy) -> None:
    toy.velocity[2, 1] = np.nan


class Clockless(Toy):
    """An engine that does not report the time."""

    counted = 0

    @property
    def time(self) -> float:
        return self.counted * DT

    def stepped(self) -> None:
        self.counted += 1


def test_a_source_that_counts_the_time_is_right_where_not_every_frame_is_recorded(tmp_path: Path) -> None:
    toy = Clockless()
    with carom.record.Recorder(toy, tmp_path / "toy.rrd", every=4) as recorder:
        for _ in range(8):
            toy.step()
            recorder.frame()
    times = Recording.open(tmp_path / "toy.rrd").trajectory(0)["time"].to_pylist()
    assert times == [0.0, 4 * DT, 8 * DT]


def test_a_source_says_how_many_calls_make_a_frame_unless_the_recorder_is_told(tmp_path: Path) -> None:
    times = {}
    for every in (None, 1):
        toy = Toy()
        toy.model = replace(toy.model, every=4)
        with carom.record.Recorder(toy, tmp_path / f"{every}.rrd", every=every) as recorder:
            for _ in range(8):
                toy.step()
                recorder.frame()
        times[every] = Recording.open(tmp_path / f"{every}.rrd").trajectory(0)["time"].to_pylist()
    assert times == {None: [0.0, 4 * DT, 8 * DT], 1: [step * DT for step in range(9)]}


def test_pybullet_is_read_seldom_where_it_has_many_bodies() -> None:
    assert {bodies: calls_per_frame(bodies) for bodies in (1, 199, 200, 799, 800, 10_000)} == {
        1: 1,
        199: 1,
        200: 2,
        799: 4,
        800: 5,
        10_000: 5,
    }


@pytest.fixture(scope="module")
def healthy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("toy") / "toy.rrd"
    assert recorded(Toy(), path) == []
    return path


@pytest.mark.parametrize(
    ("fault", "law", "bodies", "happens", "named"),
    [
        (energy_from_nothing, "energy", (0, 1), MET, MET),
        (missed_impact, "missed-impact", (0, 1), MET, MET),  # known once they have passed through each other
        (force_off_centre, "angular-momentum", (0, 1), FAULT, FAULT),
        (lost_momentum, "momentum", (0, 1), MET, MET),
        (not_a_number, "not-finite", (2,), FAULT, FAULT),
    ],
)
def test_each_planted_fault_is_named_within_a_frame_with_its_bodies(
    fault: Callable[[Toy], None], law: str, bodies: tuple[int, ...], happens: int, named: int, tmp_path: Path
) -> None:
    toy = Toy()
    while toy.velocity[0, 0] > 0.0:
        toy.step()
    assert toy.steps == MET
    faults = recorded(Toy(fault), tmp_path / "run.rrd")
    first = next(found for found in faults if found.law == law)
    assert first.step == named <= happens + 1 and first.bodies == bodies
    assert first.step == min(found.step for found in faults), "another law is named earlier"
    recording = Recording.open(tmp_path / "run.rrd")
    assert (first.step, f"law-{law}") in [(event.step, event.kind) for event in recording.warnings()]
    assert recording.summary()["laws"][law]["step"] == first.step


def lossy(toy: Toy) -> None:
    toy.bounce(0.5)


def friction_that_pushes(toy: Toy) -> None:
    """Bounce with a loss, and with friction along the slip that adds less energy than the bounce takes."""
    before = toy.velocity.copy()
    if toy.bounce(0.5):
        apart = toy.position[1] - toy.position[0]
        distance = np.linalg.norm(apart)
        normal, arm = apart / distance, 0.5 * distance
        slip = before[1] - before[0] - arm * np.cross(toy.spin[0] + toy.spin[1], normal)
        slip -= slip @ normal * normal
        impulse = 0.2 * slip  # on body 1
        toy.push(impulse)
        for body in range(2):
            toy.spin[body] += arm * np.cross(impulse, normal) / (0.4 * toy.model.mass[body] * 0.1**2)


@pytest.mark.parametrize(
    ("fault", "restitution", "law"),
    [(lossy, 0.5, ""), (lossy, 1.0, "restitution"), (friction_that_pushes, None, "friction")],
)
def test_an_impact_that_loses_what_its_law_does_not_say_is_named(
    fault: Callable[[Toy], None], restitution: float | None, law: str, tmp_path: Path
) -> None:
    toy = Toy(fault)
    toy.spin[0, 2] = 10.0
    toy.model = dataclasses.replace(toy.model, restitution=restitution)
    faults = recorded(toy, tmp_path / "run.rrd")
    assert [found.law for found in faults] == ([law] if law else [])
    assert all(found.step == MET and found.bodies == (0, 1) for found in faults)


class Spinning:
    """Two spheres in free space, apart and at rest but for their spins, which change by one rounding in step 3."""

    def __init__(self, spin: float, drift: float) -> None:
        self.model = carom.record.Model(engine="toy", mass=[1.0, 1.0], radius=[0.5, 0.5])
        self.spin, self.drift, self.steps = spin, drift, 0

    def state(self) -> carom.record.State:
        spin, velocity = np.full((2, 3), [0.0, 0.0, self.spin]), np.zeros((2, 3))
        if self.steps >= 3:
            spin[0], velocity[0, 0] = np.nextafter(spin[0], 0.0), self.drift
        return carom.record.State(0.1 * self.steps, [[-2.0, 0, 0], [2.0, 0, 0]], velocity, angular_velocity=spin)


def spun(spinning: Spinning, path: Path) -> list[carom.record.Fault]:
    with carom.record.Recorder(spinning, path) as recorder:
        for spinning.steps in range(1, 6):
            recorder.frame()
    return recorder.faults


@pytest.mark.parametrize(("spin", "drift"), [(3.0, 0.0), (3.0, 1e-17), (0.0, 1e-17)])
def test_a_rounding_of_bodies_at_rest_that_spin_or_not_breaks_no_law(spin: float, drift: float, tmp_path: Path) -> None:
    # 10⁻¹⁷ m/s for 0.1 s change no position of 2 m
    assert spun(Spinning(spin, drift), tmp_path / "run.rrd") == []
    if spin:
        assert Recording.open(tmp_path / "run.rrd").closing["energy.max_error"] < 1e-15  # of the energy of the spins


def test_a_slow_motion_that_begins_without_a_cause_breaks_the_laws_of_momentum_and_energy(tmp_path: Path) -> None:
    laws = {fault.law for fault in spun(Spinning(0.0, 1e-12), tmp_path / "run.rrd")}
    assert laws >= {"momentum", "energy"}


def test_faults_of_an_engine_in_other_units_are_told_in_them(tmp_path: Path) -> None:
    for number, (fault, unit) in enumerate([(energy_from_nothing, " g cm²/ms², "), (missed_impact, " cm/ms.")]):
        toy = Toy(fault)
        path = tmp_path / f"{number}.rrd"
        with carom.record.Recorder(toy, path, units="cm, ms, g") as recorder:
            for _ in range(STEPS):
                toy.step()
                recorder.frame()
        assert any(unit in each.text for each in recorder.faults)
        assert Recording.open(path).units.named == "cm, ms, g"
    with pytest.raises(RecordingError, match="a mass is missing"):
        carom.record.Recorder(Toy(), tmp_path / "no.rrd", units="cm, ms")


def plastic(toy: Toy) -> None:
    toy.collides = not toy.bounce(0.25)


def test_what_energy_does_in_contact_is_neither_restitution_nor_an_error_of_the_engine(tmp_path: Path) -> None:
    # μ = 2/3 kg, 2 m/s: (1 - e²) μ v² / 2 = 1.25 J are lost where the bodies meet head on, slightly less askew
    recorded(Toy(plastic), tmp_path / "run.rrd")
    recording = Recording.open(tmp_path / "run.rrd")
    energy = recording.summary()["energy"]
    assert -1.25 < energy["change_in_contact"] < -1.2
    assert abs(energy["change_without_contact"]) < 1e-12  # the toy is exact in flight
    assert energy["final"] - energy["initial"] == pytest.approx(
        energy["change_in_contact"] + energy["change_without_contact"], abs=1e-12
    )
    texts = [command("inspect", "run.rrd", cwd=tmp_path).stdout, *(text for _, text in overview(recording))]
    legends = [series.legend for series in series_of(header_of_recording(recording))]
    said = " ".join(" ".join([*texts, *legends, *recording.events()["text"].to_pylist()]).split())
    assert "integration error" not in said and "restitution" not in said and "integrator" not in said
    assert " J while bodies touched: by contacts and errors of the engine, not distinguished" in said
    assert "without contact, which the law admits: at most" in said


def test_a_run_in_which_nothing_touches_has_no_hardest_impact_and_no_deepest_overlap(tmp_path: Path) -> None:
    recorded(Toy(), tmp_path / "run.rrd", steps=10)
    moments = Recording.open(tmp_path / "run.rrd").summary()["moments"]
    assert not {"impact", "overlap", "contacts"} & set(moments)


def test_a_gap_so_small_that_it_counts_as_touching_is_no_negative_overlap(tmp_path: Path) -> None:
    toy = Toy()
    toy.position[:2] = [[-0.10001, 0.0, 0.0], [0.10001, 0.0, 0.0]]
    toy.velocity[:2] = 0.0
    with carom.record.Recorder(toy, tmp_path / "run.rrd") as recorder:
        recorder.frame()
    contacts = Recording.open(tmp_path / "run.rrd").summary()["contacts"]
    assert contacts["total"] > 0 and contacts["max_overlap"] == 0.0


def test_a_point_takes_no_part_in_contacts_and_leaves_the_others_judged(tmp_path: Path) -> None:
    contacts = []
    for name, fault in (("right", None), ("wrong", missed_impact)):
        toy = Toy(fault)
        toy.model = replace(toy.model, radius=[0.1, 0.1, 0.0])
        toy.position[2], toy.velocity[2] = [0.0, 0.01, 0.0], [0.0, 0.0, 3.0]  # where the two spheres meet
        faults = recorded(toy, tmp_path / f"{name}.rrd")
        assert ("missed-impact" in {fault.law for fault in faults}) == (name == "wrong")
        contacts.append(Recording.open(tmp_path / f"{name}.rrd").summary()["moments"].get("impact", {}).get("bodies"))
    assert contacts == [[0, 1], None]


def test_a_recording_of_another_engine_is_read_like_any_other(healthy: Path) -> None:
    recording = Recording.open(healthy)
    assert recording.engine == "toy 1.0" and recording.outcome == "completed" and recording.frames == STEPS + 1
    summary = recording.summary()
    assert summary["laws"] == {} and summary["warnings"] == []
    assert summary["energy"]["max_error"] < 1e-12  # a few roundings
    assert summary["contacts"]["impacts"] == 1 and summary["moments"]["impact"]["bodies"] == [0, 1]
    path = recording.trajectory(2)
    assert all(path["exact"].to_pylist())
    assert path["vz"][-1].as_py() == pytest.approx(3.0 - 9.81 * STEPS * DT, rel=1e-12)  # 130 sums


def test_commands_that_need_a_second_run_say_that_another_engine_cannot_be_run(healthy: Path, tmp_path: Path) -> None:
    for words in (("replay",), ("resume",), ("contacts", "--replay")):
        done = command(*words, str(healthy), cwd=tmp_path)
        assert done.returncode == 2 and "was recorded from toy 1.0" in done.stderr
        assert done.stderr.count("\n") == 1


def test_clips_and_exports_need_no_second_run(healthy: Path, tmp_path: Path) -> None:
    assert (
        command("clip", str(healthy), "--from", "0.1", "--to", "0.14", "-o", "clip.rrd", cwd=tmp_path).returncode == 0
    )
    clip = Recording.open(tmp_path / "clip.rrd")
    assert clip.engine == "toy 1.0" and clip.frames == 21
    assert command("export", "clip.rrd", "--at", "0.12", "-o", "one.npz", cwd=tmp_path).returncode == 0
    with np.load(tmp_path / "one.npz", allow_pickle=False) as arrays:
        assert arrays["velocity"][0, 2, 2] == pytest.approx(3.0 - 9.81 * 0.12, rel=1e-12)  # sixty sums
    done = command("diff", str(healthy), "clip.rrd", cwd=tmp_path)
    assert done.returncode == 0 and "Same bits in all 21 common frames" in done.stdout
    told = command("inspect", str(healthy), cwd=tmp_path).stdout
    assert "toy 1.0; the recording has only states" in told and "carom replay" not in told


def test_the_last_frames_are_written_when_an_exception_leaves_the_context(tmp_path: Path) -> None:
    toy, path = Toy(), tmp_path / "last.rrd"
    with pytest.raises(ZeroDivisionError), carom.record.Recorder(toy, path, last=5) as recorder:
        for _ in range(STEPS):
            toy.step()
            recorder.frame()
        raise ZeroDivisionError("in the user's loop")
    recording = Recording.open(path)
    assert recording.fingerprints()["step"].to_pylist() == list(range(STEPS - 4, STEPS + 1))
    assert recording.outcome == "failed: ZeroDivisionError: in the user's loop"


def test_the_last_frames_are_written_on_demand_and_not_at_all_by_a_run_that_ends_well(tmp_path: Path) -> None:
    toy, path = Toy(), tmp_path / "last.rrd"
    with carom.record.Recorder(toy, path, last=5) as recorder:
        for step in range(STEPS):
            toy.step()
            recorder.frame()
            if step == 9:
                written = recorder.write(tmp_path / "asked.rrd")
                assert written is not None and written.frames == 5
    assert not path.exists()


@pytest.mark.filterwarnings("error")  # a user's -W error may not end the run, either
def test_a_state_that_is_not_finite_writes_the_last_frames_and_ends_the_recording(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "last.rrd"
    toy = Toy(not_a_number)
    with carom.record.Recorder(toy, path, last=5) as recorder:
        for _ in range(STEPS):
            toy.step()
            if not recorder.frame():
                break
    assert toy.steps == FAULT
    assert Recording.open(path).fingerprints()["step"].to_pylist() == list(range(FAULT - 5, FAULT))
    assert Recording.open(path).outcome.startswith("failed: Velocity of body 2")
    said = f"carom: {path}: Velocity of body 2 is nan in component 1. The recording ends before this state.\n"
    assert capfd.readouterr().err == said and [f"carom: {path}: {text}\n" for text in recorder.problems] == [said]


def test_a_source_with_wrong_arrays_is_refused_before_a_file_is_made(tmp_path: Path) -> None:
    path = tmp_path / "run.rrd"
    changes: list[tuple[dict[str, Any], str]] = [
        ({"mass": [1.0, -2.0, 1.0]}, r"mass\[1\] is -2; it cannot be negative"),
        ({"radius": [0.1, 0.1]}, r"radius has the shape \(2,\) instead of \(3,\)"),
        ({"names": ["a"]}, "names has 1 entries for 3 bodies"),
        ({"fixed": ["no", "yes", "no"]}, r"fixed\[0\] is 'no'; it must be True or False"),
        ({"judged": [1, 0, 2]}, r"judged\[2\] is 2; it must be True or False"),
        ({"fixed": [True]}, r"fixed has the shape \(1,\) instead of \(3,\)"),
        ({"constant": -1.0}, "constant is -1; it must be a number that is not negative"),
        ({"constant": [1.0, 2.0]}, r"constant is \[1.0, 2.0\]; it must be a number that is not negative"),
        ({"softening": -0.5}, "softening is -0.5; it must be a number that is not negative"),
        ({"softening": float("nan")}, "softening is nan; it must be a number that is not negative"),
        ({"constant": "x"}, "constant is not an array of numbers"),
        ({"time_step": -1.0}, "time_step is -1; it must be a number that is not negative"),
        ({"mass": ["a", "b", "c"]}, "mass is not an array of numbers"),
        ({"mass": [[1.0], [2.0, 3.0], [1.0]]}, "mass is not an array of numbers"),
        ({"engine": ""}, "engine is ''; it must be a name"),
        ({"engine": None}, "engine is None; it must be a name"),
        ({"box": [1.0, 1.0, 0.0]}, "all three sizes must be positive"),
        ({"box": [1.0, 1.0, -1.0]}, "all three sizes must be positive"),
        ({"planes": [carom.record.Plane((0.0, 0.0, float("nan")))]}, "the normals of the planes.* is nan"),
        ({"planes": [((0.0, 0.0, 1.0), float("nan"))]}, "the offsets of the planes.* is nan"),
        ({"planes": [5.0]}, "planes must be a list of carom.record.Plane"),
    ]
    for change, message in changes:
        toy = Toy()
        toy.model = replace(toy.model, **change)
        with pytest.raises(carom.errors.RecordingError, match=message), carom.record.Recorder(toy, path):
            pass
        assert not path.exists()
    path.touch()
    with pytest.raises(carom.errors.RecordingError, match="exists"):
        carom.record.Recorder(Toy(), path)


@pytest.mark.parametrize(
    ("frames", "message"),
    [
        ({"last": 2.5}, "last = 2.5: expected a whole number of frames, at least one"),
        ({"last": 0}, "last = 0: expected a whole number of frames, at least one"),
        ({"every": 1.5}, "every = 1.5: expected 1 to record each call of `frame`, 2 for every second call, and so on"),
        ({"every": "2"}, "every = '2': expected 1 to record each call of `frame`, 2 for every second call, and so on"),
        ({"duration": float("nan")}, "duration = nan: expected the time that the run will reach"),
        ({"duration": -1.0}, "duration = -1.0: expected the time that the run will reach"),
    ],
)
def test_a_number_of_frames_that_is_not_whole_and_positive_is_refused(
    tmp_path: Path, frames: dict[str, Any], message: str
) -> None:
    with pytest.raises(RecordingError, match=message):
        carom.record.Recorder(Toy(), tmp_path / "run.rrd", **frames)


def test_a_model_that_records_no_call_is_refused(tmp_path: Path) -> None:
    toy = Toy()
    toy.model = replace(toy.model, every=0)
    with pytest.raises(RecordingError, match="every = 0"):
        carom.record.Recorder(toy, tmp_path / "run.rrd")


@pytest.mark.parametrize("source", [None, object(), Toy])
def test_what_is_no_source_is_named_with_what_it_needs(source: Any, tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="is not a source: it needs `model`, a"):
        carom.record.Recorder(source, tmp_path / "run.rrd")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"time": None}, "the time of the state is None; it must be a number"),
        ({"time": float("nan")}, "time.* is nan, which is not finite"),
        ({"velocity": None}, "velocity has the shape|velocity is no array"),
        ({"position": np.zeros((3, 2))}, r"position has the shape \(3, 2\) instead of \(3, 3\)"),
        ({"orientation": np.zeros((3, 4))}, r"orientation\[0\] has the length 0; it must be a quaternion of length 1"),
    ],
)
def test_a_first_state_that_is_none_leaves_no_file_and_no_claim(
    change: dict[str, Any], message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, state = tmp_path / "run.rrd", Toy.state
    with monkeypatch.context() as patch:
        patch.setattr(Toy, "state", lambda toy: replace(state(toy), **change))
        with pytest.raises(RecordingError, match=message), carom.record.Recorder(Toy(), path):
            pass
    assert not path.exists()
    with carom.record.Recorder(Toy(), path):
        pass


def test_a_source_that_returns_no_state_is_told_what_to_return(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Toy, "state", lambda toy: (0.0, toy.position, toy.velocity))
    with (
        pytest.raises(RecordingError, match=r"`state` of Toy returned tuple; return a carom\.record\.State"),
        carom.record.Recorder(Toy(), tmp_path / "run.rrd"),
    ):
        pass


def divides_by_zero(toy: Toy) -> carom.record.State:
    return carom.record.State(1.0 / 0.0, toy.position, toy.velocity)


LEFT_OUT: list[tuple[dict[str, Any] | Callable[[Toy], Any], str]] = [
    (
        {"position": np.zeros((1, 3))},
        "position has the shape (1, 3), but had (3, 3); where bodies come and go, give each state their ids",
    ),
    ({"velocity": np.zeros(3)}, "velocity has the shape (3,), but had (3, 3)"),
    ({"angular_velocity": None}, "angular_velocity has the shape (), but had (3, 3)"),
    ({"time": "late"}, "the time of the state is 'late'; it must be a number"),
    ({"time": float("nan")}, "toy 1.0: the time is nan, which is not finite"),
    (divides_by_zero, "ZeroDivisionError: float division by zero"),
    (lambda _: "no state", "AttributeError: 'str' object has no attribute"),
]
COMPUTED: list[tuple[dict[str, Any] | Callable[[Toy], Any], str]] = [
    ({"contacts": [[0, 3]]}, "toy 1.0: a contact has the number 3; bodies and planes are 0 to 2"),
    ({"contacts": [0, 1, 2]}, "toy 1.0: contacts has the shape (3,) instead of (m, 2)"),
    ({"contacts": ["a"]}, "toy 1.0: contacts must be whole numbers"),
]


@pytest.mark.parametrize(("change", "message"), LEFT_OUT + COMPUTED)
def test_what_cannot_be_recorded_is_noted_once_and_the_loop_and_the_recording_go_on(
    change: dict[str, Any] | Callable[[Toy], Any],
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    right, toy = Toy.state, Toy()
    path = tmp_path / "run.rrd"

    def state(toy: Toy) -> Any:
        if toy.steps not in (10, 12):
            return right(toy)
        return change(toy) if callable(change) else replace(right(toy), **change)

    monkeypatch.setattr(Toy, "state", state)
    with carom.record.Recorder(toy, path) as recorder:
        for _ in range(20):
            toy.step()
            assert recorder.frame()
    recording = Recording.open(path)
    missing = 0 if (change, message) in COMPUTED else 2
    assert recording.outcome == "completed" and recording.frames == 21 - missing
    (problem,) = recorder.problems
    assert problem.startswith(message) and capfd.readouterr().err == f"carom: {path}: {problem}\n"
    noted = [event.text for event in recording.warnings() if event.kind == "not-recorded"]
    assert noted == [problem, "2 problems of recording in all."]


APART = """
import resource, shutil, sys, threading, time
from pathlib import Path
import numpy as np
import carom

class Toy:
    model = carom.record.Model(engine="toy", mass=np.ones(300), radius=np.full(300, 0.1))
    position, velocity, time = np.arange(900.0).reshape(300, 3), np.ones((300, 3)), 0.0
    def step(self):
        self.time += 0.1
        self.position = self.position + 0.1 * self.velocity
    def state(self):
        return carom.record.State(self.time, self.position, self.velocity)

def run(recorder, steps, toy):
    for _ in range(steps):
        toy.step()
        recorder.frame()

toy = Toy()
resource.setrlimit(resource.RLIMIT_FSIZE, (9_000_000, 9_000_000))
with carom.record.Recorder(toy, "full.rrd") as recorder:
    run(recorder, 1000, toy)
print("went on", recorder.frame(), round(toy.time))
Path("gone").mkdir()
with carom.record.Recorder(toy, "gone/run.rrd") as recorder:
    run(recorder, 5, toy)
    shutil.rmtree("gone")
print("went on")
Path("gone").mkdir()
with carom.record.Recorder(toy, "gone/ring.rrd", last=3) as recorder:
    run(recorder, 5, toy)
    shutil.rmtree("gone")
    print("went on", recorder.write())
    toy.position[1, 1] = np.nan
    recorder.frame()
print("went on", len(recorder.faults), recorder.write("ring.rrd").frames)

def loop(recorder, toy):
    time.sleep(0.2)  # longer than the main thread
    run(recorder, 7, toy)

toys = [Toy(), Toy(), Toy()]
run(carom.record.Recorder(toys[0], "without-context.rrd"), 5, toys[0])
ring = carom.record.Recorder(toys[1], "ring-without-context.rrd", last=3)
threading.Thread(target=loop, args=(carom.record.Recorder(toys[2], "thread.rrd"), toys[2])).start()
run(ring, 5, toys[1])
raise SystemError("in the loop")
"""
Apart = tuple[subprocess.CompletedProcess[str], Path]


@pytest.fixture(scope="module")
def apart(tmp_path_factory: pytest.TempPathFactory) -> Apart:
    """A process that records toys on a full disk, in folders that go, and without contexts; and its folder."""
    folder = tmp_path_factory.mktemp("apart")
    command = [sys.executable, "-c", APART]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False), folder


def test_a_full_disk_and_a_folder_that_went_end_the_recording_and_not_the_run(apart: Apart) -> None:
    done, folder = apart
    assert done.stdout.splitlines() == [
        "went on False 100",
        "went on",
        "went on None",
        "went on 1 3",
    ]
    recording = Recording.open(folder / "full.rrd")
    assert 10 < recording.frames < 1000 and "no space left on the disk" in recording.outcome
    said = done.stderr.partition("Traceback")[0].splitlines()
    assert said[0].startswith("carom: full.rrd: cannot write more of full.rrd")
    assert [line.split(":")[1].strip() for line in said] == [
        "full.rrd",
        "gone/run.rrd",
        "gone/ring.rrd",
        "gone/ring.rrd",
    ]


def test_a_recorder_without_a_context_is_closed_when_the_program_ends(apart: Apart) -> None:
    done, folder = apart
    assert done.returncode == 1 and done.stderr.endswith("SystemError: in the loop\n")
    assert done.stderr.count("Traceback") == 1
    names = ("without-context", "ring-without-context", "thread")
    recordings = [Recording.open(folder / f"{name}.rrd") for name in names]
    assert [recording.frames for recording in recordings] == [5, 3, 7]
    for recording in recordings:
        assert recording.outcome == "interrupted: the program ended before Recorder.finish"


def test_problems_are_noted_without_a_stderr(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Full(io.StringIO):
        def write(self, text: str) -> int:
            raise OSError(errno.ENOSPC, text)

    closed = io.StringIO()
    closed.close()
    for stderr in (None, Full(), closed):
        noted = Unrecorded(tmp_path)
        with monkeypatch.context() as patch:
            patch.setattr(sys, "stderr", stderr)
            for number in (7, 8):
                noted.add(1, 0.1, RecordingError(f"the {number} is wrong"), "So be it.")
        assert noted.texts == ["the 7 is wrong. So be it."] and noted.count == 2


@pytest.mark.parametrize("tolerance", [-1.0, float("nan")])
def test_a_tolerance_that_would_find_nothing_is_refused(tolerance: float) -> None:
    with pytest.raises(RecordingError, match=r"the tolerance overlap is .*; it must be 0 or more"):
        carom.record.Tolerances(overlap=tolerance)


def test_whole_numbers_of_numpy_are_numbers_of_frames_and_flags(tmp_path: Path) -> None:
    toy = Toy()
    toy.model = replace(toy.model, fixed=np.array([0, 0, 0]), judged=[1.0, True, np.True_])
    with carom.record.Recorder(toy, tmp_path / "run.rrd", every=np.int64(2), last=np.int32(2)) as recorder:  # type: ignore[arg-type]
        recorder.frame()


@pytest.mark.parametrize("last", [None, 3])
def test_a_clock_that_goes_back_ends_the_recording_with_the_frames_before_it(last: int | None, tmp_path: Path) -> None:
    toy = Toy()
    with carom.record.Recorder(toy, tmp_path / "run.rrd", last=last) as recorder:
        for _ in range(5):
            toy.step()
            assert recorder.frame()
        toy.steps = 0  # as MuJoCo resets itself where others have NaN
        assert not recorder.frame() and not recorder.frame()
    recording = Recording.open(tmp_path / "run.rrd")
    assert recording.frames == (last or 6)
    assert recording.outcome == f"failed: {recorder.problems[0].removesuffix(' The recording ends before this state.')}"
    assert "the time decreased from 0.01 to 0 s" in recording.outcome


def test_a_snapshot_keeps_a_state_that_the_engine_overwrites_and_tells_whether_it_is_bounded() -> None:
    position, velocity = np.ones((3, 3)), np.zeros((3, 3))
    snapshot = StateMemory.like(carom.record.State(0.0, position, velocity))
    snapshot.take(carom.record.State(1.5, position, velocity))
    assert snapshot.bounded
    position[:] = 2.0
    assert snapshot.state.time == 1.5 and (snapshot.state.position == 1.0).all()
    for wrong in (np.nan, np.inf, -np.inf, -1e200):
        velocity[2, 1] = wrong
        snapshot.take(carom.record.State(2.0, position, velocity))
        assert not snapshot.bounded, wrong
    snapshot.take(carom.record.State(np.nan, position, np.zeros((3, 3))))
    assert not snapshot.bounded


def test_an_infinite_number_in_single_precision_is_not_bounded() -> None:
    block = np.zeros((2, 6), np.float32)
    snapshot = StateMemory(carom.record.State(0.0, block[:, :3], block[:, 3:]), block)
    assert snapshot.bounded
    block[1, 2] = np.inf
    assert not snapshot.bounded


class Landing:
    """A body of another shape that falls to a plane and stops there, beside a sphere that rests."""

    model = carom.record.Model(
        engine="toy 1.0",
        mass=[1.0, 1.0],
        radius=[0.2, 0.1],
        judged=[False, True],
        gravity=(0.0, 0.0, -9.81),
        planes=[carom.record.Plane((0.0, 0.0, 1.0), 0.0, "floor")],
    )
    time = 0.0

    def state(self) -> carom.record.State:
        height = 1.0 - 0.5 * 9.81 * self.time**2
        speed = -9.81 * self.time if height > 0.1 else 0.0
        position = [[0.0, 0.0, max(height, 0.1)], [3.0, 0.0, 0.1]]
        return carom.record.State(self.time, position, [[0.0, 0.0, speed], [0.0, 0.0, 0.0]])


def test_energy_that_a_body_which_is_not_judged_loses_in_a_contact_is_no_fault(tmp_path: Path) -> None:
    landing = Landing()
    with carom.record.Recorder(landing, tmp_path / "run.rrd") as recorder:
        for step in range(1, 100):
            landing.time = 0.01 * step
            recorder.frame()
    assert recorder.faults == []


def test_the_loss_of_a_body_which_is_not_judged_is_no_integration_error_and_its_sphere_makes_no_impact(
    tmp_path: Path,
) -> None:
    landing = Landing()
    with carom.record.Recorder(landing, tmp_path / "run.rrd") as recorder:
        for step in range(1, 100):
            landing.time = 0.01 * step
            recorder.frame()
    recording = Recording.open(tmp_path / "run.rrd")
    summary, energy = recording.summary(), recording.energy()
    assert summary["energy"]["max_error"] < 1e-12
    lost = energy["total"][0].as_py() - energy["total"][-1].as_py()
    assert lost > 8.0 and energy["restitution"][-1].as_py() == pytest.approx(lost)
    assert summary["contacts"]["impacts"] == 0 and summary["judged"] == 1
    assert "judged 1 of 2 bodies; the other bodies are not free spheres" in " ".join(
        command("inspect", "run.rrd", cwd=tmp_path).stdout.split()
    )


@pytest.mark.needs("rebound")
def test_rebound_is_read_from_its_memory_even_after_it_moved() -> None:
    import rebound

    simulation = rebound.Simulation()
    for k in range(3):
        simulation.add(m=1.0, x=float(k), vy=0.5 * k)
    source = carom.record.rebound(simulation)
    before = source.state()
    simulation.add(m=1.0)
    for _ in range(1000):  # until REBOUND has moved its particles
        simulation.add(m=1.0, x=9.0)
    for _ in range(1001):
        simulation.remove(3)
    simulation.particles[2].x = 7.0
    assert before.position[2, 0] == 2.0
    assert source.state().position[:, 0].tolist() == [0.0, 1.0, 7.0]
    assert source.state().velocity[:, 1].tolist() == [0.0, 0.5, 1.0]


@pytest.mark.needs("rebound")
def test_variational_particles_of_rebound_are_no_bodies(tmp_path: Path) -> None:
    import rebound

    simulation = rebound.Simulation()
    for mass, x, speed in ((1.0, 0.0, 0.0), (1e-3, 1.0, 1.0), (1e-3, 2.0, 0.7)):
        simulation.add(m=mass, r=0.01, x=x, vy=speed)
    simulation.add_variation()
    simulation.init_megno()
    with carom.record.Recorder(carom.record.rebound(simulation), tmp_path / "run.rrd") as recorder:
        simulation.integrate(0.1)
        recorder.frame()
    last = Recording.open(tmp_path / "run.rrd").bodies(0.1)
    assert last["x"].to_pylist() == [particle.x for particle in simulation.particles[:3]]


@pytest.mark.needs("rebound")
def test_rebound_is_recorded_in_the_units_of_the_simulation() -> None:
    import rebound

    found = []
    for units, constant in ((("AU", "yr", "Msun"), None), (None, 1.0), (None, 6.674e-11)):
        simulation = rebound.Simulation()
        if units:
            simulation.units = units
        else:
            simulation.G = constant
        simulation.add(m=1.0)
        found.append(carom.record.rebound(simulation).model.units)
    assert found == ["au, yr, M_sun", "dimensionless", ""]


def test_a_source_names_its_units_unless_the_recorder_does(tmp_path: Path) -> None:
    toy = Toy()
    toy.model = replace(toy.model, units="km, h, kg")
    for given, named in ((None, "km, h, kg"), ("cm, ms, g", "cm, ms, g")):
        path = tmp_path / f"{given}.rrd"
        with carom.record.Recorder(toy, path, units=given):
            pass
        assert Recording.open(path).units.named == named


@pytest.mark.needs("rebound")
def test_rebound_is_recorded_with_its_gravity(tmp_path: Path) -> None:
    import rebound

    simulation = rebound.Simulation()
    simulation.add(m=1.0, r=0.1)
    simulation.add(m=1e-3, a=1.0, e=0.1, r=0.01)
    with carom.record.Recorder(carom.record.rebound(simulation), tmp_path / "run.rrd") as recorder:
        while simulation.t < 6.0:
            simulation.steps(1)
            recorder.frame()
    assert recorder.faults == []
    summary = Recording.open(tmp_path / "run.rrd").summary()
    assert summary["scene"]["engine"].startswith("rebound ")
    assert summary["energy"]["initial"] == pytest.approx(simulation.energy(), rel=1e-12)  # of an orbit, by IAS15
    assert summary["energy"]["max_error"] < 1e-12 and summary["momentum"]["max_error"] < 1e-12  # likewise


@pytest.mark.needs("mujoco")
def test_mujoco_is_recorded_with_its_planes_and_its_spheres_rest_on_them(tmp_path: Path) -> None:
    import mujoco

    ball = '<body name="ball" pos="0 0 0.11"><freejoint/><geom type="sphere" size="0.1" mass="1"/></body>'
    text = f'<mujoco><worldbody><geom name="floor" type="plane" size="0 0 1"/>{ball}</worldbody></mujoco>'
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    data.qvel[3:] = [0.0, 0.0, 2.0]
    with carom.record.Recorder(carom.record.mujoco(model, data), tmp_path / "run.rrd") as recorder:
        while data.time < 0.4:
            mujoco.mj_step(model, data)
            recorder.frame()
    recording = Recording.open(tmp_path / "run.rrd")
    assert [event.text for event in recording.warnings()] == []
    path = recording.trajectory("ball")
    assert path["z"][-1].as_py() == pytest.approx(0.1, rel=0.02)  # soft contacts give way a little
    assert path["wz"][0].as_py() == 2.0 and path["qw"][0].as_py() == 1.0
    assert recording.summary()["moments"]["impact"]["between"] == 'body 0 "ball" and floor'


@pytest.mark.needs("mujoco")
def test_a_limb_of_mujoco_has_the_velocity_of_its_centre_of_mass() -> None:
    import mujoco

    arm = '<joint type="hinge" axis="0 1 0"/><geom type="sphere" size="0.1" pos="0.5 0 0"/>'
    model = mujoco.MjModel.from_xml_string(f'<mujoco><worldbody><body pos="4 0 1">{arm}</body></worldbody></mujoco>')
    data = mujoco.MjData(model)
    data.qpos[0], data.qvel[0] = 0.3, 2.0
    state = carom.record.mujoco(model, data).state()
    assert state.position[0] == pytest.approx([4.0 + 0.5 * np.cos(0.3), 0.0, 1.0 - 0.5 * np.sin(0.3)], abs=1e-12)
    assert state.velocity[0] == pytest.approx([-np.sin(0.3), 0.0, -np.cos(0.3)], abs=1e-12)
    assert state.angular_velocity[0] == pytest.approx([0.0, 2.0, 0.0], abs=1e-12)


def test_an_engine_that_is_not_installed_is_named_with_the_line_that_installs_it() -> None:
    with pytest.raises(carom.errors.RecordingError, match="pip install rebound-next"):
        engine_package("rebound_next", "rebound-next")


@pytest.mark.needs("mujoco")
def test_mujoco_that_becomes_unstable_and_resets_itself_leaves_its_last_frames(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import mujoco

    monkeypatch.chdir(tmp_path)  # MuJoCo writes a log
    ball = '<body pos="0 0 9"><freejoint/><geom type="sphere" size="0.1" mass="1"/></body>'
    model = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{ball}</worldbody></mujoco>")
    data = mujoco.MjData(model)
    with carom.record.Recorder(carom.record.mujoco(model, data), "crash.rrd", last=5) as recorder:
        for step in range(1, 31):
            data.xfrc_applied[1, 0] = np.nan if step == 20 else 0.0
            mujoco.mj_step(model, data)
            recorder.frame()
    recording = Recording.open(tmp_path / "crash.rrd")
    assert recording.fingerprints()["step"].to_pylist() == list(range(15, 20))
    assert "the engine was reset, or reset itself" in recording.outcome


class SilentError(Exception):
    def __str__(self) -> str:
        raise RuntimeError("no text")


def odd_text(toy: Any) -> None:
    raise SilentError


def steering_text(toy: Any) -> None:
    raise ValueError("\ud83d\x1b[2J\n" * 10**5)  # no UTF-8, an order to a terminal, and much of both


def complex_positions(toy: Any) -> carom.record.State:
    return carom.record.State(toy.time, toy.position + 1j, toy.velocity, angular_velocity=toy.spin)


def masked_positions(toy: Any) -> carom.record.State:
    hidden = np.ma.masked_less(toy.position, 1.0)
    return carom.record.State(toy.time, hidden, toy.velocity, angular_velocity=toy.spin)


def dates(toy: Any) -> carom.record.State:
    return carom.record.State(toy.time, toy.position, np.zeros((3, 3), "M8[s]"), angular_velocity=toy.spin)


def half_contacts(toy: Any) -> carom.record.State:
    state = carom.record.State(toy.time, toy.position, toy.velocity, angular_velocity=toy.spin)
    state.contacts = [[0.5, 1.5]]
    return state


def endless_time(toy: Any) -> carom.record.State:
    return carom.record.State(10**400, toy.position, toy.velocity, angular_velocity=toy.spin)


@pytest.mark.parametrize(
    ("state", "said"),
    [
        (odd_text, "SilentError: its text cannot be made (RuntimeError)"),
        (steering_text, r"ValueError: \ud83d\u001b[2J \ud83d"),
        (complex_positions, "position has complex numbers"),
        (masked_positions, "position has masked values"),
        (dates, "velocity has values of the type datetime64[s]"),
        (half_contacts, "contacts must be whole numbers"),
        (endless_time, "it must be a number"),
    ],
)
def test_a_state_of_no_use_costs_a_note_and_neither_the_run_nor_a_digit(
    state: Callable[[Any], Any], said: str, tmp_path: Path
) -> None:
    toy = Toy()
    with carom.record.Recorder(toy, tmp_path / "toy.rrd") as recorder:
        for step in range(6):
            toy.step()
            toy.__dict__.pop("state", None)
            if step == 3:
                toy.__dict__["state"] = lambda: state(toy)
            assert recorder.frame()
    (problem,) = recorder.problems
    assert said in problem and len(problem) < 10_000 and "\x1b" not in problem
    recording = Recording.open(tmp_path / "toy.rrd")
    assert recording.frames == (7 if state is half_contacts else 6)  # contacts are then computed from distances
    assert recording.outcome == "completed"


def test_an_exception_without_a_text_leaves_the_context_as_it_is_and_a_whole_file(tmp_path: Path) -> None:
    toy = Toy()
    with pytest.raises(SilentError), carom.record.Recorder(toy, tmp_path / "toy.rrd"):
        raise SilentError
    assert "its text cannot be made" in Recording.open(tmp_path / "toy.rrd").outcome


@pytest.mark.parametrize("mass", [[10**400, 1.0, 1.0], np.array([1.0, 1j, 1.0]), np.zeros(3, "m8[s]")])
def test_numbers_that_are_none_of_a_body_are_refused_in_a_sentence(mass: Any, tmp_path: Path) -> None:
    toy = Toy()
    toy.model = replace(toy.model, mass=mass)
    with pytest.raises(RecordingError, match=r"toy 1\.0: mass is not an array of numbers"):
        carom.record.Recorder(toy, tmp_path / "toy.rrd")
    with pytest.raises(RecordingError, match="expected the time that the run will reach"):
        carom.record.Recorder(Toy(), tmp_path / "toy.rrd", duration=10**400)
    assert list(tmp_path.iterdir()) == []


def test_texts_of_a_program_that_no_file_can_hold_cost_no_frame(tmp_path: Path) -> None:
    odd, toy = "\ud83d\x1b[2J\0\n", Toy()
    toy.model = replace(toy.model, engine=odd, names=[odd, "b", odd])
    with carom.record.Recorder(toy, tmp_path / "toy.rrd", title=odd) as recorder:
        toy.step()
        recorder.frame()
    recording = Recording.open(tmp_path / "toy.rrd")
    assert recorder.problems == [] and recording.frames == 2 and recording.finished
    assert recording.bodies.name[0] == "\\ud83d\x1b[2J\0\n"


def test_frames_of_two_threads_and_of_a_state_that_records_itself_make_a_file_that_can_be_read(tmp_path: Path) -> None:
    toy, count = Toy(), 100
    with carom.record.Recorder(toy, tmp_path / "toy.rrd") as recorder:
        own = toy.state
        toy.__dict__["state"] = lambda: (recorder.frame(), own())[1]
        recorder.frame()
        del toy.__dict__["state"]

        def work() -> None:
            for _ in range(count):
                recorder.frame()

        threads = [threading.Thread(target=work) for _ in range(2)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    within, still = recorder.problems  # the toy takes no step, so its time does not advance
    assert "within `state`" in within and "did not advance" in still
    recording = Recording.open(tmp_path / "toy.rrd")
    assert recording.frames == 2 * count + 2 and recording.finished
    assert recording.fingerprints()["step"].to_pylist() == list(range(2 * count + 2))


def test_no_name_of_an_engine_steers_the_terminal(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    toy = Toy()
    toy.model = replace(toy.model, engine="x\x1b[2J\u202ey 1.0")
    with carom.record.Recorder(toy, tmp_path / "run.rrd") as recorder:
        recorder.frame()  # the time did not advance
    said = capsys.readouterr().err
    assert "y 1.0: the time did not advance" in said
    assert "\x1b" not in said and "\u202e" not in said
