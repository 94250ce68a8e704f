"""A run that ended, or was ended, goes on as if it had never stopped."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pyarrow as pa
import pytest

import carom
from carom.errors import RecordingError
from carom.physics import schedule as schedules
from carom.physics.space import Space
from carom.plan.auto import frame_interval, integrator
from carom.recording.edit.clip import clip
from carom.recording.edit.repair import repair
from carom.recording.read.recording import Recording
from carom.runs.resume import claimed_target, continue_run, resumable_run
from carom.runs.run import recording_space, simulate
from carom.scene.load import Scene
from small_scenes import bundled, cloud, two_planets

LONG = (  # a tenth of the duration takes the same path
    *("asteroid-belt", "chute", "drum", "hopper", "marbles-in-a-box", "planet-with-gravel", "rubble-collision"),
    *("piston", "shaker", "shear-cell", "dense-shear"),
)
CONTENT = ("fingerprints", "energy", "steps", "momentum", "events", "phases", "dt_limits")


def assert_same_recording(one: Recording, other: Recording) -> None:
    """All data that a reader can get are the same, to the bit."""
    for name in CONTENT:
        assert written_out(getattr(one, name)()) == written_out(getattr(other, name)()), name
    assert one.summary()["moments"] == other.summary()["moments"]
    assert one.summary()["contacts"] == other.summary()["contacts"]
    assert one.summary()["expect"] == other.summary()["expect"]
    last = one.checkpoint_steps[-1]
    for name in ("position", "velocity", "angular_velocity"):
        a, b = getattr(one.checkpoint(last), name), getattr(other.checkpoint(last), name)
        assert a is b is None or a.tobytes() == b.tobytes()
    for step in one.fingerprints()["step"].to_pylist()[:: max(1, one.frames // 20)]:
        assert one.drawn_positions(step).tobytes() == other.drawn_positions(step).tobytes()  # type: ignore[union-attr]


def written_out(table: pa.Table) -> dict[str, str]:
    """Every value with all its digits; a NaN is a NaN."""
    nanoseconds = table["sim_time"].cast(pa.int64())
    table = table.set_column(table.column_names.index("sim_time"), "sim_time", nanoseconds)
    return {name: repr(values) for name, values in table.to_pydict().items()}


def carom_outcome(recording: Recording) -> str:
    """How it ended, in a word: a scene cut short may miss what it promises of its end."""
    return recording.outcome.partition(":")[0]


@pytest.fixture(scope="module")
def _half_second(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return carom.run(cloud(time={"duration": 0.5}), tmp_path_factory.mktemp("cloud") / "cloud.rrd").path


@pytest.fixture
def half_second(_half_second: Path, tmp_path: Path) -> Recording:
    """A run of 0.5 s, which a test may write to."""
    return Recording.open(shutil.copy(_half_second, tmp_path))


def stopped(scene: Scene, path: Path, at: float) -> Recording:
    """Record a scene up to about a time, as the interrupt key leaves it."""
    space = recording_space(scene)
    frames = space.run

    def run_and_stop(**options: Any) -> Any:
        for frame in frames(**options):
            if frame.time >= at:
                space.stop()
            yield frame

    space.run = run_and_stop  # type: ignore[method-assign, assignment]
    outcome = simulate(space, path)
    assert outcome.frames > 3 and outcome.sim_time < scene.time.duration
    return Recording.open(path)


@pytest.mark.parametrize("name", bundled(quick=("five-materials", "kepler-orbits", "two-spheres")))
def test_a_run_that_was_stopped_goes_on_to_what_an_uninterrupted_run_gives(name: str, tmp_path: Path) -> None:
    scene = Scene.load(name)
    scene = Scene.load(name, [f"time.duration={(0.1 if name in LONG else 0.3) * scene.time.duration}"])
    whole = carom.run(scene, tmp_path / "whole.rrd", threads=4)
    part = stopped(scene, tmp_path / "part.rrd", 0.6 * scene.time.duration)
    run = resumable_run(part)
    assert run.step > 0
    outcome = continue_run(run, run.space(threads=1))
    assert outcome.status == carom_outcome(whole) and outcome.path == tmp_path / "part.rrd"
    assert_same_recording(whole, Recording.open(outcome.path))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["part.rrd", "whole.rrd"]


@pytest.mark.parametrize("every", ["auto", 0.2])
def test_a_run_stopped_between_two_frames_goes_on_without_the_frame_of_its_stop(every: Any, tmp_path: Path) -> None:
    scene = cloud(time={"duration": 1.5, "fixed_dt": 0.001}, record={"every": every})
    whole = carom.run(scene, tmp_path / "whole.rrd")
    space = recording_space(scene)
    frames, wanted = space.run, schedules.every(frame_interval(scene))

    def stop_at(step: int, before: float, time: float) -> bool:
        if step == 777:
            space.stop()
        return wanted(step, before, time)

    space.run = lambda **options: frames(schedule=stop_at, **options)  # type: ignore[method-assign]
    assert simulate(space, tmp_path / "part.rrd").steps in (777, 778)
    run = resumable_run(Recording.open(tmp_path / "part.rrd"))
    outcome = continue_run(run, run.space())
    assert_same_recording(whole, Recording.open(outcome.path))


@pytest.mark.slow
def test_a_stopped_run_with_a_piston_goes_on_with_the_force_since_its_last_frame(tmp_path: Path) -> None:
    piston = {"point": [0, 0, 3.5], "normal": [0, 0, -1], "piston": {"mass": 2.0, "force": 5.0}}
    scene = Scene.from_dict(
        {
            "title": "A ball under a piston",
            "body": [{"position": [0.0, 0.0, 1.2], "radius": 1.0, "mass": 1.0}],
            "plane": [{}, piston],
            "gravity": {"constant": 0.0, "uniform": [0.0, 0.0, -9.81]},
            "contact": {"restitution": 0.3},
            "time": {"duration": 2.0, "max_dt": 0.01},
        }
    )
    whole = carom.run(scene, tmp_path / "whole.rrd")
    run = resumable_run(stopped(scene, tmp_path / "part.rrd", 1.2))
    assert_same_recording(whole, Recording.open(continue_run(run, run.space(threads=1)).path))


def test_a_finished_run_goes_on_without_the_step_that_was_cut_short(tmp_path: Path) -> None:
    short = carom.run(cloud(time={"duration": 1.503}, record={"every": 0.02}), tmp_path / "short.rrd")
    long = carom.run(cloud(time={"duration": 2.0}, record={"every": 0.02}), tmp_path / "long.rrd")
    run = resumable_run(short, until=2.0)
    assert run.time < 1.503
    outcome = continue_run(run, run.space(threads=1), tmp_path / "resumed.rrd")
    assert_same_recording(long, Recording.open(outcome.path))
    assert outcome.begin == run.time
    assert Recording.open(tmp_path / "short.rrd").frames == short.frames, "the first recording is as it was"


def test_a_longer_run_keeps_the_integrator_that_its_first_duration_chose(tmp_path: Path) -> None:
    scene = two_planets()
    assert integrator(scene).name == "gauss-radau15"
    short = carom.run(scene, tmp_path / "orbits.rrd")
    run = resumable_run(short, until=7000.0)  # 1100 orbits, for which "auto" would take wisdom-holman
    assert integrator(run.scene).name == "gauss-radau15"


def test_a_continued_recording_says_so_and_keeps_where_it_came_from(half_second: Recording) -> None:
    run = resumable_run(half_second, until=0.8)
    resumed = Recording.open(continue_run(run, run.space()).path)
    assert resumed.versions["carom"] == half_second.versions["carom"]
    assert resumed.properties["resumed.step"] == run.step
    assert resumed.properties["resumed.version.carom"]
    assert "duration = 0.8" in resumed.scene_toml


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "every", "duration", "size"),
    [
        ("cloud-collapse", 2.0, 8000.0, 3_000_000),  # to the first hundred contacts
        # while balls leave and enter, in the second batch of messages
        pytest.param("steady-hopper", 0.01, 3.0, 4_000_000, marks=pytest.mark.nightly),
    ],
)
def test_a_killed_run_goes_on_from_its_last_checkpoint(
    name: str, every: float, duration: float, size: int, tmp_path: Path
) -> None:
    path = tmp_path / "killed.rrd"
    short = ["--set", f"record.every={every}", "--set", f"time.duration={duration}"]
    command = [sys.executable, "-m", "carom", "run", name, "-o", str(path), *short]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    while not (path.exists() and path.stat().st_size > size):
        assert process.poll() is None, "it must be killed under way"
        time.sleep(0.05)
    process.send_signal(signal.SIGKILL)
    process.wait()
    killed = opened_or_repaired(path)
    assert killed.frames > 20 and not killed.outcome.startswith("completed")
    run = resumable_run(killed)
    resumed = Recording.open(continue_run(run, run.space()).path)
    whole = [frame.fingerprint for frame in Space(run.scene).run()]
    assert resumed.fingerprints()["fingerprint"].to_pylist() == whole
    assert resumed.outcome == "completed"


def opened_or_repaired(path: Path) -> Recording:
    """Open what a killed run left, as its message says if it was killed while a message was being written."""
    try:
        return Recording.open(path)
    except RecordingError as error:
        assert "ends inside a message" in str(error) and "carom repair" in str(error)
    whole = path.with_name("repaired.rrd")
    repair(path, whole)
    return Recording.open(whole)


def test_there_is_nothing_to_go_on_with_in_a_run_that_has_got_there(half_second: Recording) -> None:
    with pytest.raises(RecordingError, match=r"simulated to 0\.5 s already; give a later --until"):
        resumable_run(half_second)
    with pytest.raises(RecordingError, match="`carom clip` makes it shorter"):
        resumable_run(half_second, until=0.2)


def test_a_clip_of_some_bodies_cannot_be_resumed(half_second: Recording, tmp_path: Path) -> None:
    clip(half_second.path, tmp_path / "few.rrd", 0.0, 0.2, bodies=[0, 1])
    with pytest.raises(RecordingError, match="is a clip of selected bodies"):
        resumable_run(Recording.open(tmp_path / "few.rrd"), until=0.4)


def test_a_resumed_run_is_written_into_an_rrd_only(half_second: Recording, tmp_path: Path) -> None:
    refused = pytest.raises(RecordingError, match=r"a recording is an \.rrd")
    with refused, claimed_target(half_second.path, tmp_path / "x.txt", False):
        pass


def test_a_run_that_was_killed_after_its_last_frame_is_complete_once_it_is_repaired(half_second: Recording) -> None:
    path = half_second.path
    outcome = next(e for e in Recording.open(path).store.entries if e.entity_path == "__properties/outcome")
    os.truncate(path, outcome.offset - 16)  # the header of a message has 16 bytes
    with pytest.raises(RecordingError, match=r"has all its frames and lacks only its footer; `carom repair .*` writes"):
        resumable_run(Recording.open(path))


def test_a_run_that_fails_at_once_leaves_the_recording_as_it_was(half_second: Recording, tmp_path: Path) -> None:
    before = half_second.path.read_bytes()
    run = resumable_run(half_second, until=1.0)
    space = run.space()
    space.state.velocity[0] = float("nan")
    with pytest.raises(RecordingError, match="unchanged: failed: the state is no longer finite"):
        continue_run(run, space)
    assert half_second.path.read_bytes() == before
    assert [path.name for path in tmp_path.iterdir()] == ["cloud.rrd"]
