"""A run: recorded whole, stopped early, or failed, it leaves a readable file that says how it ended."""

from __future__ import annotations

import gc
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import carom
from carom.errors import DamageError, RecordingError
from carom.physics.diagnostics.extremes import add_energy
from carom.physics.simulation import StepStatus
from carom.physics.space import Space
from carom.recording.read.recording import Recording
from carom.recording.schema.header import SweepMember
from carom.recording.write.encoder import BatchEncoder
from carom.runs.outcome import judge
from carom.runs.resume import resumable_run
from carom.runs.run import Outcome, recording_of, recording_space, simulate
from carom.scene.load import Scene, scene_from_text
from carom.scene.scene_file import bundled_scenes
from carom.state.books import Extreme, Extremes
from carom.state.frame import Frame
from small_scenes import NIGHTLY, NIGHTLY_MARKS, cloud, pair
from small_scenes import bundled as bundled_names


def test_the_public_run_returns_the_recording(tmp_path: Path) -> None:
    recording = carom.run(pair(), tmp_path / "pair.rrd")
    energy = recording.energy()
    assert energy.num_rows == recording.frames > 10
    assert recording.outcome == "completed"


def test_a_file_that_exists_is_replaced_only_when_asked(tmp_path: Path) -> None:
    path = tmp_path / "pair.rrd"
    path.write_bytes(b"precious")
    with pytest.raises(RecordingError, match="exists; give force=True"):
        carom.run(pair(), path)
    assert path.read_bytes() == b"precious"
    assert carom.run(pair(), path, force=True).outcome == "completed"


def test_a_missing_folder_and_a_folder_are_refused_before_anything_runs(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="there is no folder"):
        carom.run(pair(), tmp_path / "nowhere" / "x.rrd")
    with pytest.raises(RecordingError, match="a folder; name a file"):
        carom.run(pair(), tmp_path)


def test_a_name_that_the_viewer_would_not_take_for_a_recording_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"run.txt: a recording is an \.rrd"):
        carom.run(cloud(), tmp_path / "run.txt")
    assert not list(tmp_path.iterdir())


def test_runs_of_one_process_may_vary_a_key_over_words_numbers_and_lists(tmp_path: Path) -> None:
    given = ["auto", 0.5, 2, [0, 0, 1], True]
    for k, value in enumerate(given):
        member = SweepMember(f"run {k}", {"time.max_dt": value, "seed": 1}, "carom sweep")
        simulate(Space(pair()), tmp_path / f"{k}.rrd", member=member)
    kept = [Recording.open(tmp_path / f"{k}.rrd").parameters["time.max_dt"] for k in range(len(given))]
    assert kept == given


def test_python_seeks_garbage_seldom_during_a_run_and_as_before_after_it(
    tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    class Watched(Space):
        def run(self, *arguments: Any, **options: Any) -> Iterator[Frame]:
            thresholds.append(gc.get_threshold())
            yield from super().run(*arguments, **options)

    request.addfinalizer(partial(gc.set_threshold, *gc.get_threshold()))
    before, thresholds = (700, 10, 10), list[tuple[int, int, int]]()
    gc.set_threshold(*before)
    simulate(Watched(pair()), tmp_path / "pair.rrd")
    assert thresholds == [(100_000, 10, 10)]
    assert gc.get_threshold() == before


def test_recording_changes_no_bit_and_the_fingerprints_in_the_file_are_those_of_the_run(cloud_run: Recording) -> None:
    run = [frame.fingerprint for frame in Space(cloud()).run()]
    assert cloud_run.fingerprints()["fingerprint"].to_pylist() == run


def test_the_first_checkpoint_is_the_exact_start(cloud_run: Recording) -> None:
    state = cloud_run.checkpoint(0)
    start = Space(cloud()).state
    assert np.array_equal(state.position, start.position)
    assert np.array_equal(state.velocity, start.velocity)
    assert np.array_equal(state.acceleration, start.acceleration)


def test_the_scene_in_the_file_runs_again(cloud_run: Recording, tmp_path: Path) -> None:
    path = tmp_path / "again.toml"
    path.write_text(cloud_run.scene_toml, encoding="utf-8")
    assert Scene.load(path) == cloud()


def test_a_promise_about_contacts_and_velocities_is_judged_and_recorded(tmp_path: Path) -> None:
    scene = pair(time={"duration": 4.0, "max_dt": 0.3}, expect={"contact_audit": 1e-12})
    outcome = simulate(Space(scene), tmp_path / "kept.rrd")
    assert outcome.status == "completed"
    (verdict,) = outcome.verdicts
    assert verdict.met and 0.0 <= verdict.measured < 1e-15
    assert Recording.open(outcome.path).summary()["expect"]["contact_audit"]["met"]
    none_asked = judge(scene, Extremes(), 4.0)[0]
    assert not none_asked.met and none_asked.measured == float("inf")


def test_a_missed_expectation_is_said_in_the_file(tmp_path: Path) -> None:
    late = {"timing": "end-of-step"}
    scene = pair(time={"duration": 4.0, "max_dt": 0.3}, contact=late, expect={"max_overlap": 1e-9})
    outcome = simulate(Space(scene), tmp_path / "pair.rrd")
    assert outcome.status == "expectation missed"
    assert "max_overlap" in outcome.reason
    assert Recording.open(outcome.path).outcome.startswith("expectation missed: max_overlap")


@pytest.mark.slow
def test_a_run_that_is_watched_without_a_pause_records_what_one_alone_does(
    cloud_run: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("carom.runs.run.POLL", 0.0)
    seen: list[StepStatus] = []
    outcome = simulate(recording_space(cloud()), tmp_path / "watched.rrd", watch=seen.append)
    watched = Recording.open(outcome.path)
    assert watched.fingerprints().equals(cloud_run.fingerprints())
    assert watched.steps().equals(cloud_run.steps())
    assert watched.events().equals(cloud_run.events())
    steps = [status.step for status in seen]
    assert len(set(steps)) > 10 and steps == sorted(steps)


def test_a_watcher_that_fails_ends_the_run_with_a_closed_recording(tmp_path: Path) -> None:
    space = Space(cloud(time={"duration": 3000.0}))

    def fail(status: StepStatus) -> None:
        raise ZeroDivisionError("of the watcher")

    with pytest.raises(ZeroDivisionError):
        simulate(space, tmp_path / "x.rrd", watch=fail)
    assert "physics" not in {thread.name for thread in threading.enumerate()}
    recording = Recording.open(tmp_path / "x.rrd")
    assert recording.outcome == "failed: ZeroDivisionError: of the watcher"
    assert recording.fingerprints()["step"][-1].as_py() == space.step


def test_a_state_that_stops_being_finite_leaves_a_readable_file_that_says_so(tmp_path: Path) -> None:
    space = Space(cloud(time={"duration": 3000.0}))

    def break_it(status: StepStatus) -> None:
        space.state.velocity[3] = np.nan

    outcome = simulate(space, tmp_path / "broken.rrd", watch=break_it)
    assert outcome.status == "failed" and "no longer finite" in outcome.reason
    recording = Recording.open(outcome.path)
    assert recording.outcome.startswith("failed") and recording.frames == outcome.frames > 0


@pytest.mark.parametrize(
    ("fault", "status"),
    [
        (ValueError("a bug"), "error"),
        (MemoryError(), "error"),
        (DamageError("a chunk is damaged"), "error"),  # of the recording that is continued
        (RecordingError("no space left"), "disk"),
    ],
)
def test_an_error_of_the_recorder_is_not_called_one_of_the_disk(
    fault: Exception, status: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*arguments: Any) -> None:
        raise fault

    monkeypatch.setattr(BatchEncoder, "rows", fail)
    outcome = simulate(Space(cloud(time={"duration": 0.1})), tmp_path / "x.rrd")
    assert outcome.status == status and not outcome.ok
    assert Recording.open(outcome.path).outcome.startswith(f"{status}: ")
    with pytest.raises(RecordingError):
        recording_of(outcome)


def failing(error: Exception, after: float = 0.3) -> Space:
    """Return a space whose physics raises an error after a simulated time in s."""
    space = Space(cloud(time={"duration": 1.0}))
    frames = space.run

    def run_and_fail(**options: Any) -> Any:
        for frame in frames(**options):
            if frame.time > after:
                raise error
            yield frame

    space.run = run_and_fail  # type: ignore[method-assign, assignment]
    return space


def test_a_run_that_is_out_of_memory_is_closed_and_says_so(tmp_path: Path) -> None:
    outcome = simulate(failing(MemoryError()), tmp_path / "x.rrd")
    assert outcome.status == "failed" and outcome.reason.startswith("out of memory at t = 0.3")
    recording = Recording.open(tmp_path / "x.rrd")
    assert recording.finished and recording.outcome.startswith("failed: out of memory") and recording.frames > 0


def test_a_run_that_fails_before_its_first_frame_leaves_a_file_that_says_why(tmp_path: Path) -> None:
    outcome = simulate(failing(MemoryError(), after=-1.0), tmp_path / "x.rrd")
    recording = Recording.open(tmp_path / "x.rrd")
    assert recording.frames == outcome.frames == 0 and recording.outcome.startswith("failed: out of memory at t = 0 s")
    assert recording.info["bodies"] == cloud().count
    with pytest.raises(RecordingError, match="holds no frame: failed: out of memory"):
        resumable_run(recording)


def test_a_defect_in_the_physics_is_raised_after_the_recording_is_closed(tmp_path: Path) -> None:
    with pytest.raises(ZeroDivisionError):
        simulate(failing(ZeroDivisionError("of ours")), tmp_path / "x.rrd")
    recording = Recording.open(tmp_path / "x.rrd")
    assert recording.finished and recording.outcome == "failed: ZeroDivisionError: of ours"


def test_a_quantity_that_is_not_conserved_keeps_no_promise() -> None:
    extremes = Extremes(angular_momentum_error=None, overlap=Extreme(0.1, 1, 1.0))
    verdicts = judge(pair(expect={"angular_momentum_error": 1.0, "max_overlap": 0.2}), extremes, 10.0)
    assert [verdict.met for verdict in verdicts] == [False, True]


def test_a_promise_of_impacts_is_one_from_below() -> None:
    few, enough = (judge(pair(expect={"impacts": 2}), Extremes(impacts=n), 10.0)[0] for n in (1, 2))
    assert not few.met and enough.met
    assert str(few) == "impacts: 1 (at least 2; missed)"


def test_a_most_number_of_impacts_is_one_from_above() -> None:
    few, many = (judge(pair(expect={"most_impacts": 2}), Extremes(impacts=n), 10.0)[0] for n in (2, 3))
    assert few.met and str(many) == "most_impacts: 3 (at most 2; missed)"


def test_a_state_from_theory_is_compared_at_the_end_in_the_units_of_the_scene(tmp_path: Path) -> None:
    """A ball thrown at 2 cm/s is 2 cm away after 1 s; the scene expects 3 cm, and the right velocity."""
    scene = scene_from_text(
        """
        units = "cm, s, g"
        time.duration = 1.0
        gravity.constant = 0.0
        [[body]]
        name = "thrown"
        velocity = [2.0, 0.0, 0.0]
        [[expect.state]]
        body = "thrown"
        position = [3.0, 0.0, 0.0]
        position_error = 0.5
        velocity = [2.0, 0.0, 0.0]
        velocity_error = 1e-12
        """,
        "x.toml",
    )
    outcome = simulate(recording_space(scene, 1), tmp_path / "x.rrd")
    assert outcome.status == "expectation missed"
    assert [str(verdict) for verdict in outcome.verdicts] == [
        'position_0: 1, error of "thrown" in cm (at most 0.5; missed)',
        'velocity_0: 0, error of "thrown" in cm/s (at most 1e-12)',
    ]
    told = Recording.open(tmp_path / "x.rrd").summary()["expect"]
    assert told["position_0"]["measured"] == pytest.approx(1.0) and told["velocity_0"]["met"]
    unknown = judge(scene, Extremes(), 1.0)
    assert not any(verdict.met for verdict in unknown), "a state that is not known meets no promise"
    assert not any(verdict.judged for verdict in judge(scene, Extremes(), 0.5))


def test_a_promise_about_the_end_is_judged_at_the_end_that_it_was_made_for() -> None:
    scene = pair(time={"duration": 4.0}, expect={"impacts": 2, "final_kinetic": 0.0, "max_overlap": 0.0})
    extremes = Extremes(impacts=1, overlap=Extreme(0.1, 1, 1.0), kinetic=Extreme(0.5, 9, 3.0))
    judged = {
        time: {verdict.name: verdict.met for verdict in judge(scene, extremes, time) if verdict.judged}
        for time in (3.0, 4.0, 5.0)
    }
    assert judged[3.0] == {"max_overlap": False}
    assert judged[4.0] == {"max_overlap": False, "impacts": False, "final_kinetic": False}
    assert judged[5.0] == {"max_overlap": False, "impacts": False}, "there are no fewer impacts in a longer run"
    early = {verdict.name: verdict for verdict in judge(scene, extremes, 3.0)}["final_kinetic"]
    assert early.met and str(early) == "final_kinetic: 0.5 (at most 0 at t = 4 s; not judged)"


def test_a_run_shortened_by_an_override_does_not_miss_a_promise_about_the_end(tmp_path: Path) -> None:
    text = pair(time={"duration": 4.0}, expect={"impacts": 1, "max_overlap": 0.1}).toml
    scene = scene_from_text(text, "pair.toml", ["time.duration=0.5"])
    outcome = simulate(Space(scene), tmp_path / "short.rrd")
    assert outcome.status == "completed", outcome.reason
    assert [verdict.judged for verdict in outcome.verdicts] == [True, False]
    recording = Recording.open(outcome.path)
    expected = recording.summary()["expect"]
    assert expected["max_overlap"]["judged"] and not expected["impacts"]["judged"]
    longer = resumable_run(recording, until=4.0)
    assert longer.scene.expect.duration == longer.scene.time.duration == 4.0


def test_the_energy_gain_counts_from_the_lowest_energy_so_far() -> None:
    # The rebound takes three quarters of the energy out; a rise after it that stays below the start must still be seen.
    space = Space(pair())
    start, *_, last = list(space.run())
    extremes, energy = space.extremes, last.energy
    assert extremes.energy_gain.value <= 1e-15  # no gravity: round-off of the impulse
    add_energy(extremes, last.step + 1, 99.0, replace(energy, translational=energy.translational + 0.1))
    assert extremes.energy_gain.value == pytest.approx(0.1 / energy.scale, rel=1e-12)  # the subtraction's round-off
    assert extremes.energy_gain.time == 99.0 and start.energy.total > energy.total + 0.1


Bundled = Callable[[str], Outcome]


@pytest.fixture(scope="module")
def bundled(tmp_path_factory: pytest.TempPathFactory) -> Bundled:
    """Runs bundled scenes, each of them once."""
    folder = tmp_path_factory.mktemp("bundled")

    @cache
    def run(name: str) -> Outcome:
        return simulate(Space(Scene.load(name)), folder / f"{name}.rrd")

    return run


LONG = (  # seconds each
    *("asteroid-belt", "chute", "cloud-collapse", "drum", "hopper", "piston", "shaker"),
    *("marbles-in-a-box", "planet-with-gravel", "rubble-collision", "shear-cell", "dense-shear"),
    "steady-hopper",
)
SHORT = [name for name in bundled_scenes() if name not in LONG]
ADMITTED = {"piston": ("limit",)}  # it falls on a packing: inelastic impacts of ever smaller speeds within one step


@pytest.mark.parametrize("name", bundled_names(quick=tuple(SHORT)))
def test_every_bundled_scene_meets_its_expectations_and_warns_of_nothing(name: str, bundled: Bundled) -> None:
    outcome = bundled(name)
    assert outcome.status == "completed", outcome.reason
    assert outcome.moments.energy_error is not None and outcome.moments.energy_error.value <= 1e-3
    events = Recording.open(outcome.path).events().select(["kind", "level"]).to_pylist()
    assert {event["kind"] for event in events if event["level"] == "WARN"} <= set(ADMITTED.get(name, ()))


@pytest.mark.parametrize(
    "names",
    [
        SHORT,
        pytest.param([name for name in LONG if name not in NIGHTLY], marks=pytest.mark.slow),
        pytest.param(NIGHTLY, marks=NIGHTLY_MARKS),
    ],
    ids=["short", "long", "longest"],
)
def test_the_recordings_of_bundled_scenes_are_what_rerun_calls_valid(names: Sequence[str], bundled: Bundled) -> None:
    files = [str(bundled(name).path) for name in names]
    verified = subprocess.run(
        [sys.executable, "-m", "rerun", "rrd", "verify", *files], capture_output=True, text=True, check=False
    )
    assert verified.returncode == 0, verified.stderr


@pytest.mark.slow
def test_the_file_is_at_most_a_fifth_larger_than_its_arrays(bundled: Bundled) -> None:
    outcome = bundled("cloud-collapse")
    assert outcome.size <= 1.2 * outcome.payload


@pytest.mark.slow
def test_phases_tell_free_colliding_and_settled_apart(bundled: Bundled) -> None:
    phases = Recording.open(bundled("cloud-collapse").path).phases()["state"].to_pylist()  # each where it begins
    assert phases[:2] == ["warm-up", "free"]
    assert "colliding" in phases
    assert phases[-1] == "settled"
