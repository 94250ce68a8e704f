import json
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from carom import record
from carom.recording.edit import bundle
from carom.recording.write.recorder import FrameRecorder
from carom.runs.run import run
from carom_command import carom
from scripted_run import ScriptedRun
from small_scenes import pair


@pytest.fixture
def other(tmp_path: Path) -> Path:
    """A copy of `run.rrd` with other fingerprints and another scene."""
    scripted = ScriptedRun(20, scene_toml='title = "A merry-go-round"\nseed = 3\n')
    with FrameRecorder(tmp_path / "other.rrd", scripted.header) as recorder:
        for frame in scripted.frames(100):
            moved = frame.position + (1e-3 if frame.step >= 40 else 0.0)
            recorder.put(replace(frame, position=moved))
        recorder.finish("completed")
    return tmp_path / "other.rrd"


def test_the_same_bits_exit_0(run_file: Path, tmp_path: Path) -> None:
    shutil.copy(run_file, tmp_path / "copy.rrd")
    done = carom("diff", "run.rrd", "copy.rrd", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "Same bits in all 100 common frames." in done.stdout


def test_a_moment_names_the_bodies_that_are_furthest_apart_then(run_file: Path, other: Path, tmp_path: Path) -> None:
    said = carom("diff", "run.rrd", "other.rrd", "--step", "50", "--json", cwd=tmp_path)
    found = json.loads(said.stdout)["moment"]
    assert (found["step"], found["time"]) == (50, 2.5) and len(found["bodies"]) == 3
    assert found["apart"] == pytest.approx([3**0.5 * 1e-3] * 3, rel=1e-3), "recorded in float32"
    shown = carom("diff", "run.rrd", "other.rrd", "--at", "1", cwd=tmp_path).stdout
    (line,) = (line for line in shown.splitlines() if line.startswith("moment"))
    assert "step 20, t = 1 s: 0.00e+00 m apart (rms)" in line


def test_a_difference_exits_1_and_says_where_and_what_it_looks_like(
    run_file: Path, other: Path, tmp_path: Path
) -> None:
    done = carom("diff", "run.rrd", "other.rrd", "-o", "both.rrd", cwd=tmp_path)
    assert done.returncode == 1, done.stderr
    for part in (
        "seed: nothing in A, 3 in B",
        "100 frames, matched by step",
        "A jump, not round-off: at step 40, t = 2 s",
    ):
        assert part in done.stdout
    assert (tmp_path / "both.rrd").exists()
    shown = carom("inspect", "both.rrd", cwd=tmp_path)
    assert shown.returncode == 0, shown.stderr
    for part in ("run.rrd", "other.rrd", "A jump, not round-off: at step 40", "carom view both.rrd"):
        assert part in shown.stdout
    refused = carom("contacts", "both.rrd", cwd=tmp_path)
    assert refused.returncode == 2 and "contains several runs" in refused.stderr


def test_diff_prints_json_that_a_script_can_use(run_file: Path, other: Path, tmp_path: Path) -> None:
    done = carom("diff", "run.rrd", "other.rrd", "--json", cwd=tmp_path)
    assert done.returncode == 1
    document = json.loads(done.stdout, parse_constant=lambda name: pytest.fail(f"{name} is not JSON"))
    assert document["same_bits"] is False and document["verdict"]["kind"] == "jump"
    assert document["first_difference"]["step"] == 40
    assert document["scene"] == {"seed": [None, 3]}
    assert len(document["curve"]) == 100 and document["curve"][99]["rms"] == pytest.approx(1e-3 * 3**0.5, rel=1e-3)


def test_the_first_impact_that_differs_is_said_and_by_how_much(tmp_path: Path) -> None:
    for name, speed in (("a", 1.0), ("b", 1.5)):
        scene = pair(speed, time={"duration": 2.0, "fixed_dt": 0.01}, record={"every": 0.5})
        run(scene, tmp_path / f"{name}.rrd")
    done = carom("diff", "a.rrd", "b.rrd", cwd=tmp_path)
    assert done.returncode == 1, done.stderr
    shown = " ".join(done.stdout.split())
    assert "impacts 1 in A, 1 in B, up to the same time first different: impact 1, body 0 and body 1, t = 1 s" in shown
    assert "+1.00e+00 m/s in approach speed" in shown
    document = json.loads(carom("diff", "a.rrd", "b.rrd", "--json", cwd=tmp_path).stdout)
    assert document["impacts"]["counts"] == [1, 1] and document["impacts"]["first_in_one_only"] is None
    first = document["impacts"]["first_difference"]
    assert first["a"]["number"] == first["b"]["number"] == 1
    assert first["b"]["bodies"] == [0, 1] and first["b"]["between"] == "body 0 and body 1"
    assert first["b"]["time"] == pytest.approx(2.0 / 3.0, rel=1e-6)


def test_the_zip_of_a_report_is_compared_like_a_recording(tmp_path: Path) -> None:
    recording = run(pair(time={"duration": 1.0, "fixed_dt": 0.01}), tmp_path / "run.rrd")
    bundle.pack(tmp_path / "run.zip", {bundle.CLIP: recording.path})
    done = carom("diff", "run.zip", "run.rrd", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "run.zip, " in done.stdout and "Same bits in all " in done.stdout


class Toy:
    """An engine that moves two bodies as carom does before they meet."""

    def __init__(self, model: record.Model) -> None:
        self.model, self.step = model, 0

    def state(self) -> record.State:
        time = self.step / 64  # no rounding
        position = [[-2.0 + time, 0.0, 0.0], [2.0 - time, 0.0, 0.0]]
        return record.State(time, position, [[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]])


@pytest.mark.slow
def test_against_another_engine_no_scene_is_compared(tmp_path: Path) -> None:
    # one line for all that the other recording lacks, not one for each key; positions are compared, not bits
    bodies = run(pair(time={"duration": 58 / 64, "fixed_dt": 1 / 64}), tmp_path / "carom.rrd").bodies
    toy = Toy(record.Model(engine="toy 1.0", mass=bodies.mass, radius=bodies.radius))
    with record.Recorder(toy, tmp_path / "toy.rrd") as recorder:
        for step in range(1, 59):
            toy.step = step
            recorder.frame()
    done = carom("diff", "carom.rrd", "toy.rrd", cwd=tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    shown = " ".join(done.stdout.split())
    assert "scene not compared: B was recorded from toy 1.0" in shown and "nothing in B" not in shown
    assert "No difference within the precision of the recordings in all " in shown


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["run.rrd", "nothing.rrd"], "no recording at nothing.rrd"),
        (["taken.rrd", "run.rrd"], "taken.rrd is not a recording"),
        (["run.rrd", "run.rrd", "-o", "taken.rrd"], "exists; give --force"),
        (["run.rrd", "run.rrd", "-o", "run.rrd", "--force"], "is the recording itself"),
    ],
)
def test_a_mistake_is_one_message_and_exit_code_2(
    arguments: list[str], said: str, run_file: Path, tmp_path: Path
) -> None:
    (tmp_path / "taken.rrd").touch()
    done = carom("diff", *arguments, cwd=tmp_path)
    assert done.returncode == 2, done.stderr
    assert said in done.stderr and "Traceback" not in done.stderr
