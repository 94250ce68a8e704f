"""A recording runs again with the same bits, or the first difference is named."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest

import carom
from carom.errors import RecordingError
from carom.physics.frame_store import FrameStore
from carom.physics.schedule import Schedule
from carom.physics.simulation import StepStatus
from carom.physics.space import Space
from carom.plan.auto import frame_interval
from carom.recording.read.first_difference import Difference, value_difference
from carom.recording.read.recording import Recording
from carom.recording.schema import checkpoint_columns, paths
from carom.recording.schema.header import scene_digest
from carom.runs.replay import INTERVAL, replay
from carom.runs.run import simulate
from carom.scene.load import Scene
from carom.scene.units.system import UnitSystem
from carom.state.frame import Frame
from edited_recordings import changed, mapped
from other_processor import OtherProcessor
from small_scenes import cloud

# Parts of durations. All bundled scenes continue with the same bits in tests/runs/test_resume.py; these have between
# them all that a replay reads: walls that move, a piston, a sheared box, sticking friction, crowds, orbits.
REPLAYED = {
    "cloud-collapse": 0.55,
    "drum": 0.1,
    "figure-eight": 0.5,
    "piston": 0.15,
    "shear-cell": 0.1,
    "two-spheres": 0.5,
}
QUICK = ("figure-eight", "two-spheres")
MARKS = {name: [] if name in QUICK else [pytest.mark.slow] for name in REPLAYED}
for name in ("drum", "piston"):  # a minute each
    MARKS[name].append(pytest.mark.nightly)


@pytest.mark.parametrize("name", [pytest.param(name, marks=MARKS[name]) for name in REPLAYED])
def test_a_bundled_scene_replays_with_the_same_bits_on_any_number_of_threads(name: str, tmp_path: Path) -> None:
    scene = Scene.load(name)
    scene = Scene.load(name, [f"time.duration={REPLAYED[name] * scene.time.duration}"])
    recording = carom.run(scene, tmp_path / "run.rrd", threads=2)
    for threads, dense in ((1, tmp_path / "dense.rrd"), (4, None)):
        result = replay(recording, threads=threads, dense=dense)
        assert result.same and result.compared == recording.frames and result.begin == 0
    steps = recording.fingerprints()["step"].to_pylist()[-1]
    assert Recording.open(tmp_path / "dense.rrd").frames == steps + 1, "every step, and frame 0"


def test_a_window_is_replayed_from_the_checkpoint_before_it(cloud_run: Recording) -> None:
    result = replay(cloud_run, 1.0, 2.0)
    before = cloud_run.checkpoint(result.begin)
    assert 0.0 < before.time <= 1.0, "no further back than need be"
    times = cloud_run.fingerprints()["time"].to_numpy()
    assert result.same and result.compared == np.count_nonzero((times >= before.time) & (times <= 2.0))


@pytest.mark.slow
def test_a_recording_with_drag_keeps_its_losses_and_replays_from_any_checkpoint(
    cloud_run: Recording, tmp_path: Path
) -> None:
    medium = {"relaxation_time": 1.0, "medium_velocity": [0.2, 0.0, 0.0]}
    recording = carom.run(cloud(drag=medium), tmp_path / "cloud.rrd")
    assert recording.energy()["drag"][-1].as_py() > 0.0
    for begin in (0.0, 1.0):
        result = replay(recording, begin, 2.0)
        assert result.same and result.compared > 0
    assert "drag" not in cloud_run.energy().column_names, "what is not required leaves no entity"


def test_a_sparse_recording_becomes_a_dense_one_that_replays(cloud_run: Recording, tmp_path: Path) -> None:
    sparse = carom.run(cloud(record={"every": 0.25}), tmp_path / "sparse.rrd")
    result = replay(sparse, 1.0, 2.2, dense=tmp_path / "dense.rrd")  # between two recorded frames
    dense = Recording.open(tmp_path / "dense.rrd")
    assert result.same and result.dense == dense.path
    rows = zip(*(cloud_run.fingerprints()[name].to_pylist() for name in ("step", "fingerprint")), strict=True)
    expected = dict(rows)
    steps = dense.fingerprints()["step"].to_pylist()
    assert steps == list(range(steps[0], steps[-1] + 1)), "every step"
    assert dense.fingerprints()["fingerprint"].to_pylist() == [expected[step] for step in steps]
    times = dense.fingerprints()["time"].to_pylist()
    assert min(times) < 1.0 + 0.02 and 2.2 - 0.02 < max(times) <= 2.2, "no step is longer than 0.02 s"
    summary = dense.summary()
    assert (summary["first_step"], summary["begin"]) == (steps[0], times[0])
    assert replay(dense).same


class Spoiled(Space):
    """A space to whose state something is done after step 50."""

    change: Callable[[Space], None]

    def run(
        self, until: float | None = None, store: FrameStore | None = None, schedule: Schedule | None = None
    ) -> Iterator[Frame]:
        for frame in super().run(until, store, schedule):
            yield frame
            if frame.step == 50:
                self.change(self)


def spoiled(path: Path, change: Callable[[Space], None]) -> Recording:
    """Record such a run."""
    space = Spoiled(cloud())
    space.change = change
    simulate(space, path)
    return Recording.open(path)


@pytest.mark.parametrize("interval", [0.05, None])
@pytest.mark.parametrize("stops", [False, True])
def test_errors_are_judged_again_at_the_same_instants(interval: float | None, stops: bool, tmp_path: Path) -> None:
    """At multiples of an interval or at the frames; also where a run stopped."""
    record = {"every": "step" if stops else 0.31, "check_every": 1000}
    scene = cloud(12, time={"duration": 1.0}, record=record, expect={"energy_error": 1.0})
    space = Spoiled(scene, record_contacts=True)
    space.change = Space.stop if stops else lambda space: None
    space.check_interval = interval
    simulate(space, tmp_path / "run.rrd")
    recording = Recording.open(tmp_path / "run.rrd")
    assert recording.check_interval == interval
    result = replay(recording)
    assert result.same and result.not_compared == ([INTERVAL] if interval else [])
    changed_instants = Recording.open(tmp_path / "run.rrd")
    changed_instants.__dict__["info"] = {**recording.info, "check_interval": 0.7}
    assert not replay(changed_instants).same, "what the errors were is compared"


def test_the_first_frame_body_and_quantity_that_differ_are_named(tmp_path: Path) -> None:
    alone: list[int] = []

    def shift(space: Space) -> None:
        alone.extend(set(range(40)) - set(space.contacts.pairs.ravel().tolist()))
        space.state.position[alone[0], 1] += 1e-3

    result = replay(spoiled(tmp_path / "shifted.rrd", shift))
    assert not result.same and result.difference is not None
    assert (result.difference.step, result.difference.body) == (51, alone[0])
    assert (result.difference.quantity, result.difference.unit) == ("y (as drawn in /world/bodies)", "m")
    assert result.difference.by == pytest.approx(-1e-3, abs=1e-6)  # what was recorded is ahead; drawn in float32
    assert result.compared == 52, "frames 0 to 51"


def test_a_difference_is_told_in_the_units_of_the_scene() -> None:
    found = Difference(3, 3600.0, "x (as drawn)", 0, 1000.0, 1250.0, "left", "m")
    units = UnitSystem({"length": "km", "time": "h"})
    told = 'step 3, t = 1 h: x (as drawn) of body 0 "left", recorded 1.0 km, replayed 1.25 km, off by 0.25 km'
    assert found.text(units) == told
    impacts = Difference(3, 3600.0, "impacts", None, 2, 3)
    assert impacts.text(units).endswith("impacts, recorded 2, replayed 3, off by 1")


def test_each_number_of_a_checkpoint_is_told_with_its_unit() -> None:
    pile = {"gravity": {"constant": 0.0, "uniform": [0.0, 0.0, -9.81]}, "contact": {"static_friction": 0.5}}
    floor = {"plane": [{"normal": [0.0, 0.0, 1.0]}], "body": [{"position": [0.0, 0.0, 0.5], "radius": 0.5}]}
    space = Space(Scene.from_dict({"time": {"duration": 0.1}, **pile, **floor}))
    *_, last = space.run()
    columns = checkpoint_columns.encode([last.checkpoint])
    assert np.any(columns["held_impulse"][0]), "a contact rests"
    told = {}
    for name, (values, _) in columns.items():
        if isinstance(values, np.ndarray) and values.dtype == np.float64:
            row = pa.array(values)
            found = value_difference(1, paths.CHECKPOINT, name, row, pa.array(values + 1.0))
            told[name] = "" if found is None else found.unit
    assert [name for name, unit in told.items() if not unit] == ["orientation"]  # has none
    assert (told["held_impulse"], told["ledger_friction"], told["contact_rest_speed"]) == ("N s", "J", "m/s")


def test_replay_finds_one_changed_bit_of_one_velocity(tmp_path: Path) -> None:
    def nudge(space: Space) -> None:
        # The last bit but one: the next kick passes 0.5 m/s, where it rounds a change of the very last bit away.
        space.state.velocity[3].view(np.int64)[0] ^= 2

    result = replay(spoiled(tmp_path / "nudged.rrd", nudge))
    assert result.difference is not None and result.difference.step == 51


@pytest.mark.parametrize(("begin", "end"), [(-5.0, -1.0), (50.0, 60.0), (2.0, 1.0), (0.0, np.nan)])
def test_a_window_outside_the_recording_is_not_replayed(begin: float, end: float, cloud_run: Recording) -> None:
    with pytest.raises(RecordingError, match=r"is outside|the end is before the start|a time is a number"):
        replay(cloud_run, begin, end)


def test_a_long_replay_asks_first(cloud_run: Recording, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("carom.runs.replay.TRIAL_SECONDS", 0.0)
    asked = []

    def decline(seconds: float) -> bool:
        asked.append(seconds)
        return False

    result = replay(cloud_run, consent=decline)
    assert len(asked) == 1 and asked[0] >= 0.0
    assert not result.same and result.ended == "declined" and result.difference is None


@pytest.mark.slow
def test_what_the_first_step_of_a_replay_compiles_is_no_part_of_the_time_that_it_asks_for(
    cloud_run: Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("carom.runs.replay.TRIAL_SECONDS", 0.0)
    asked, compiling = list[float](), 0.5  # s

    def compile_at_first(status: StepStatus) -> None:
        time.sleep(compiling if status.step == 1 else 0.0)

    def consent(seconds: float) -> bool:
        asked.append(seconds)
        return True

    assert replay(cloud_run, consent=consent, watch=compile_at_first).same
    assert asked[0] < 0.5 * compiling * cloud_run.frames


def test_a_replay_that_is_interrupted_says_how_far_it_got(cloud_run: Recording, tmp_path: Path) -> None:
    def interrupt(status: StepStatus) -> None:
        if status.step == 30:
            raise KeyboardInterrupt

    result = replay(cloud_run, watch=interrupt, dense=tmp_path / "dense.rrd")
    assert (result.ended, result.compared, result.same, result.difference) == ("stopped by the user", 30, False, None)
    dense = Recording.open(tmp_path / "dense.rrd")
    assert dense.outcome == "stopped by the user" and dense.frames == 30, "what there was is kept"


def test_a_replay_by_another_command_compares_all_that_was_recorded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "argv", ["carom", "run", "cloud"])
    carom.run(cloud(12, time={"duration": 0.5}), tmp_path / "cloud.rrd")
    monkeypatch.setattr(sys, "argv", ["carom", "replay", "cloud.rrd"])
    result = replay(Recording.open(tmp_path / "cloud.rrd"))
    assert result.same and result.not_compared == []


def test_a_scene_of_other_bodies_than_the_recorded_ones_is_not_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recording = carom.run(cloud(12, time={"duration": 0.5}), tmp_path / "cloud.rrd")
    monkeypatch.setattr(Recording, "scene_toml", cloud(1_000_000_000).toml)
    monkeypatch.setitem(vars(recording), "info", {**recording.info, "scene_sha256": scene_digest(recording.scene_toml)})
    with pytest.raises(RecordingError, match="has 12 bodies, but its scene has 1000000000: it is damaged"):
        replay(recording)


def test_a_temporary_file_that_cannot_be_written_is_named_with_the_remedy(
    cloud_run: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "missing"))
    with pytest.raises(RecordingError, match=r"again in a temporary file, which failed: .*; set TMPDIR to a folder"):
        replay(cloud_run)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    assert replay(cloud_run, 0.0, 0.2).same
    assert list(tmp_path.iterdir()) == [], "the temporary file is gone"


def test_a_state_that_is_not_finite_is_not_gone_on_from(tmp_path: Path) -> None:
    recording = carom.run(cloud(12, time={"duration": 0.5}), tmp_path / "cloud.rrd")
    nowhere = mapped("position", lambda row: [np.nan] * len(row))
    changed(recording.path, recording.path, "state/checkpoint", nowhere)
    with pytest.raises(RecordingError, match=r"checkpoint at step 0 is damaged: .* is not finite"):
        replay(Recording.open(recording.path))


AGAIN = """
import sys
import carom
for path, until in zip(sys.argv[1::2], map(float, sys.argv[2::2])):
    assert carom.replay(path).same, path
    carom.resume(path, until)
"""


ON_ANOTHER_CPU = ("cloud-collapse", "elastic-gas", "heap", "kepler-orbits", "planet-with-gravel")


@pytest.mark.nightly
@pytest.mark.slow
def test_scenes_of_gravity_and_contacts_replay_and_resume_with_the_same_bits_on_another_cpu(
    other_processor: OtherProcessor, tmp_path: Path
) -> None:
    """Not even the instructions are the same: "generic" has no AVX. Kernels of more scenes compile for minutes."""
    runs = {}  # file → the scene from its start, and when it ends
    for name in ON_ANOTHER_CPU:
        scene, path = Scene.load(name), tmp_path / f"{name}.rrd"
        interval = frame_interval(scene) / 5
        every = f"record.every={interval or 'step'}"
        carom.run(Scene.load(name, [every, f"time.duration={0.05 * scene.time.duration}"]), path)
        until = 0.1 * scene.time.duration
        runs[path] = Scene.load(name, [every, f"time.duration={until}"]), until
    done = subprocess.run(
        [sys.executable, "-c", AGAIN, *(str(word) for path, (_, until) in runs.items() for word in (path, until))],
        env=other_processor.environment
        | {"OPENBLAS_CORETYPE": "Prescott", "NPY_DISABLE_CPU_FEATURES": "X86_V3 X86_V4"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    for path, (whole, _) in runs.items():
        resumed = Recording.open(path).fingerprints()["fingerprint"].to_pylist()
        assert resumed == [frame.fingerprint for frame in Space(whole).run()], path.stem
