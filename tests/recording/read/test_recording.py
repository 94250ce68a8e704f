from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import rerun as rr

import carom
from carom.errors import RecordingError
from carom.recording.edit.repair import repair
from carom.recording.read.recording import Recording
from carom.recording.schema.paths import SCHEMA_VERSION
from carom.recording.write.recorder import FrameRecorder
from carom.runs.run import run
from scripted_run import ScriptedRun
from small_scenes import scene_of

KEPT: dict[str, float | bool] = {"measured": 0.1, "limit": 0.2, "met": True}
HIT: dict[str, float] = {"value": 2.0, "step": 4, "time": 0.2}


@pytest.fixture
def path(tmp_path: Path, scripted: ScriptedRun) -> Path:
    with FrameRecorder(tmp_path / "run.rrd", scripted.header) as recorder:
        for frame in scripted.frames(100):
            recorder.put(frame)
        recorder.finish(
            "completed",
            {
                "contacts.total": 1234,
                "profile.gravity": 0.5,
                **{f"expect.energy_error.{key}": value for key, value in KEPT.items()},
                **{f"moments.impact.{key}": value for key, value in HIT.items()},
                "moments.impact.bodies": "3,17",
            },
        )
    return tmp_path / "run.rrd"


def test_a_recording_without_a_title_is_untitled(tmp_path: Path, scripted: ScriptedRun) -> None:
    with FrameRecorder(tmp_path / "run.rrd", replace(scripted.header, title="")) as recorder:  # Rerun drops empty texts
        recorder.put(next(iter(scripted.frames(1))))
        recorder.finish("completed")
    assert Recording.open(tmp_path / "run.rrd").title == "Untitled scene"


def foreign(path: Path, application_id: str, run: dict[str, Any] | None = None) -> Path:
    with rr.RecordingStream(application_id) as stream:
        stream.set_sinks(rr.FileSink(path))
        if run:
            stream.send_property("run", rr.AnyValues(**run))
        stream.log("x", rr.Scalars(1.0))
    return path


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"no recording at .*nothing\.rrd"):
        Recording.open(tmp_path / "nothing.rrd")


@pytest.mark.parametrize("content", [b"", b"title = 'a scene'\n" * 100, b"RRF2" + bytes(500)])
def test_a_file_that_is_not_a_recording_is_refused_in_one_sentence(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "scene.toml").write_bytes(content)
    with pytest.raises(RecordingError, match=r"scene\.toml (is a scene, not a recording|is not a recording)"):
        Recording.open(tmp_path / "scene.toml")


def test_a_call_without_its_arguments_is_no_damage_of_the_file(path: Path) -> None:
    recording: Any = Recording.open(path)
    with pytest.raises(TypeError, match="argument"):
        recording.drawn_positions()


def test_a_path_in_place_of_a_container_is_answered_with_open(path: Path) -> None:
    made: Any = Recording
    with pytest.raises(TypeError, match=r"Recording\.open\(path\)"):
        made(path)


def test_somebody_elses_recording_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="not made by carom"):
        Recording.open(foreign(tmp_path / "other.rrd", "rerun_example_dna"))


@pytest.mark.parametrize("schema", [SCHEMA_VERSION - 1, SCHEMA_VERSION + 1])
def test_another_schema_is_refused_in_one_sentence_that_names_the_version_which_reads_it(
    tmp_path: Path, schema: int
) -> None:
    path = foreign(tmp_path / "other.rrd", f"carom-{schema}-0123456789ab", {"version.carom": "12.3rc1"})
    own = f"this carom reads version {SCHEMA_VERSION} only"
    reader = "carom 12.3rc1, which recorded it, reads it: `pip install carom==12.3rc1`"
    for read in (Recording.open, lambda path: repair(path, tmp_path / "repaired.rrd")):
        with pytest.raises(RecordingError) as refusal:
            read(path)
        assert str(refusal.value) == f"{path} has schema version {schema}, and {own}; {reader}"


@pytest.mark.parametrize("writer", [None, "1.0 && rm -rf ~", "1.0+local", "1.0\n&& id", "٣.1", "", carom.__version__])
def test_no_command_is_made_of_a_text_that_is_no_other_release(tmp_path: Path, writer: str | None) -> None:
    stated = {} if writer is None else {"version.carom": writer}
    path = foreign(tmp_path / "other.rrd", "carom-99-0123456789ab", stated)
    with pytest.raises(RecordingError, match=r"only; the version of carom that recorded it reads it$"):
        Recording.open(path)


def test_a_file_torn_by_a_power_cut_is_refused_and_says_that_it_is_damaged(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    with pytest.raises(RecordingError, match="damaged"):
        Recording.open(path)


def test_the_summary_has_the_keys_that_scripts_rely_on(path: Path, scripted: ScriptedRun) -> None:
    frames = list(scripted.frames(100))
    summary = Recording.open(path).summary()
    assert summary["scene"]["title"] == scripted.header.title
    assert (summary["bodies"], summary["frames"], summary["steps"]) == (60, 100, 99)
    assert summary["sim_time"] == frames[-1].time
    assert summary["outcome"] == "completed"
    assert summary["energy"]["initial"] == frames[0].energy.total
    assert summary["energy"]["final"] == frames[-1].energy.total
    worst = max(abs(f.energy.integration_error / f.energy.scale) for f in frames)
    assert summary["energy"]["max_error"] == pytest.approx(worst)
    assert summary["momentum"]["max_error"] == max(f.momentum_error or 0.0 for f in frames) > 0
    assert summary["angular_momentum"]["max_error"] is None, "a frame that does not know it makes it unknown"
    deepest = max(
        overlap / scripted.header.radius[pair].min()
        for f in frames
        for overlap, pair in zip(f.contacts.overlaps, f.contacts.pairs, strict=True)
    )
    assert summary["contacts"]["max_overlap"] == pytest.approx(deepest)
    assert summary["versions"] == {"carom": "0.1.0", "rerun": "0.41.0"}


def test_counts_of_the_run_take_precedence_over_the_recorded_frames(path: Path) -> None:
    summary = Recording.open(path).summary()
    assert summary["contacts"]["total"] == 1234
    assert summary["expect"] == {"energy_error": KEPT}
    assert summary["profile"] == {"gravity": 0.5}
    assert summary["moments"] == {"impact": {**HIT, "bodies": [3, 17], "planes": [], "between": ""}}


def test_a_recording_without_a_frame_has_no_moment_to_look_at(tmp_path: Path, scripted: ScriptedRun) -> None:
    with FrameRecorder(tmp_path / "run.rrd", scripted.header) as recorder:
        recorder.finish("failed: no room for the bodies")
    with pytest.raises(RecordingError, match="holds no frame: failed: no room"):
        Recording.open(tmp_path / "run.rrd").moment()


def test_the_most_interesting_moment_is_the_hardest_impact(tmp_path: Path, scripted: ScriptedRun) -> None:
    frames = list(scripted.frames(60))
    hit = frames[33].energy
    harder = replace(hit, ledger=replace(hit.ledger, restitution=hit.ledger.restitution + 1e6))
    with FrameRecorder(tmp_path / "run.rrd", scripted.header) as recorder:
        for frame in frames:
            recorder.put(replace(frame, energy=harder) if frame.step == 33 else frame)
        recorder.finish("completed")
    assert Recording.open(tmp_path / "run.rrd").moment() == frames[33].time


def test_a_ball_that_slides_from_the_start_is_shown_half_way_through_its_slide(tmp_path: Path) -> None:
    """Friction takes μ m g over the length of the slide, at a speed that falls evenly: half is gone early."""
    ball = {"radius": 0.05, "position": [0.0, 0.0, 0.05], "velocity": [1.0, 0.0, 0.0]}
    scene = scene_of(
        [ball],
        gravity={"constant": 0.0, "uniform": [0.0, 0.0, -9.81]},
        contact={"static_friction": 0.2, "kinetic_friction": 0.2},
        time={"duration": 1.0, "fixed_dt": 0.005},
        record={"every": "step"},
        plane=[{}],
    )
    run(scene, tmp_path / "slide.rrd")
    slide = 2.0 / 7.0 / (0.2 * 9.81)  # s, until the ball rolls
    shown = Recording.open(tmp_path / "slide.rrd").moment()
    assert shown == pytest.approx((1.0 - 0.5**0.5) * slide, abs=0.01), "two steps"


def test_a_series_that_no_recording_has_is_refused_with_those_there_are(tmp_path: Path, scripted: ScriptedRun) -> None:
    with FrameRecorder(tmp_path / "run.rrd", scripted.header) as recorder:
        for frame in scripted.frames(3):
            recorder.put(frame)
        recorder.finish("completed")
    recording = Recording.open(tmp_path / "run.rrd")
    with pytest.raises(RecordingError, match=r"there is no series energy/totl; there are .*total"):
        recording.energy("totl")
    assert "total" in recording.energy("total").column_names
