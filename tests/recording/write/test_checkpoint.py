from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pytest

from carom.arrays import FloatArray
from carom.errors import RecordingError
from carom.recording.read.recording import Recording
from carom.recording.rrd import container, messages
from carom.recording.schema import paths
from carom.recording.schema.checkpoint_columns import _components_of, _Row, encode, size
from carom.recording.write.recorder import CheckpointPlan, FrameRecorder
from carom.state.checkpoint import Checkpoint
from carom.state.frame import Frame
from carom.state.saved import BODY, Saved, all_saved
from scripted_run import ScriptedRun


def record(path: Path, scripted: ScriptedRun, frames: list[Frame]) -> Recording:
    with FrameRecorder(path, scripted.header) as recorder:
        for frame in frames:
            recorder.put(frame)
        recorder.finish("completed")
    return Recording.open(path)


def assert_same_bits(stored: Checkpoint, frame: Frame) -> None:
    assert stored.time == frame.time
    assert stored.previous_dt == frame.checkpoint.previous_dt
    assert stored.energy == frame.energy
    pairs = [
        (stored.position, frame.position),
        (stored.velocity, frame.velocity),
        (stored.acceleration, frame.checkpoint.acceleration),
        (stored.orientation, frame.orientation),
        (stored.angular_velocity, frame.angular_velocity),
    ]
    for kept, given in pairs:
        assert (kept is None) == (given is None)
        if kept is not None and given is not None:
            assert kept.dtype == np.float64
            assert kept.tobytes() == given.tobytes()


@pytest.mark.parametrize("spins", [True, False])
def test_a_checkpoint_comes_back_bit_for_bit(tmp_path: Path, spins: bool) -> None:
    scripted = ScriptedRun(20, spins=spins)
    frames = list(scripted.frames(120))
    recording = record(tmp_path / "run.rrd", scripted, frames)
    for state in recording.checkpoints():
        assert_same_bits(state, frames[state.step])


def test_a_single_state_is_encoded_without_copies_of_its_arrays() -> None:
    frame = next(iter(ScriptedRun(20).frames(1)))
    columns = encode([frame.checkpoint])
    for name in ("position", "velocity", "acceleration", "orientation", "angular_velocity"):
        assert np.shares_memory(np.asarray(columns[name][0]), getattr(frame, name)), name


def test_the_first_and_the_last_frame_and_those_before_warnings_have_one(tmp_path: Path) -> None:
    scripted = ScriptedRun(20)
    steps = record(tmp_path / "run.rrd", scripted, list(scripted.frames(117))).checkpoint_steps
    assert {0, 29, 69, 109, 116} <= set(steps), "a warning's is that of the frame before it"
    assert len(steps) == len(set(steps))


def test_checkpoints_take_about_a_tenth() -> None:
    frames = [f for f in ScriptedRun(20).frames(600) if not f.events]
    kept = CheckpointPlan().chosen(frames)
    drawn = sum(28 * 20 + 28 * len(frame.contacts) + 480 for frame in frames)
    taken = sum(size(frame) for frame in kept)
    assert 0.08 * drawn < taken <= 0.1 * drawn + size(frames[0]), "the first is given in advance"
    gaps = np.diff([frame.step for frame in kept])
    assert np.ptp(gaps[1:]) <= 0.2 * np.median(gaps), "evenly, not in bursts"


def test_the_plan_does_not_depend_on_how_frames_come_in_batches() -> None:
    frames = list(ScriptedRun(20).frames(400))
    whole = [frame.step for frame in CheckpointPlan().chosen(frames)]
    plan, parts = CheckpointPlan(), []
    for k in range(0, len(frames), 7):
        parts += [frame.step for frame in plan.chosen(frames[k : k + 7])]
    assert parts == whole


def test_a_run_that_warns_at_every_step_does_not_fill_the_file_with_checkpoints() -> None:
    scripted = ScriptedRun(20)
    warning = next(f for f in scripted.frames(40) if any(e.level == "WARN" for e in f.events))
    frames = [replace(warning, step=step) for step in range(600)]
    kept = CheckpointPlan().chosen(frames)
    assert len(kept) > 4
    assert sum(map(size, kept)) < 0.25 * 600 * 900


def test_asking_for_a_step_without_a_checkpoint_says_so(tmp_path: Path) -> None:
    scripted = ScriptedRun(5)
    recording = record(tmp_path / "run.rrd", scripted, list(scripted.frames(10)))
    with pytest.raises(RecordingError, match="no checkpoint at step 12345"):
        recording.checkpoint(12345)


@pytest.mark.parametrize("step", ["a", 1.5, None, True])
def test_a_step_that_is_not_a_number_is_refused_without_blaming_the_file(
    step: Any, tmp_path: Path, scripted: ScriptedRun
) -> None:
    recording = record(tmp_path / "run.rrd", scripted, list(scripted.frames(20)))
    with pytest.raises(RecordingError, match=r"^checkpoint .*: give one of checkpoint_steps") as refused:
        recording.checkpoint(step)
    assert "damaged" not in str(refused.value)


def test_states_in_order_of_their_steps_decode_each_chunk_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scripted = ScriptedRun(20, exact=True)
    recording = record(tmp_path / "run.rrd", scripted, list(scripted.frames(50)))
    steps = recording.checkpoint_steps
    alone = [recording.checkpoint(step) for step in steps]
    decoded = list[int]()

    def decode(body: bytes, *limits: Any) -> Any:
        decoded.append(len(body))
        return messages.decode(body, *limits)

    monkeypatch.setattr(container, "decode", decode)
    together = list(recording.checkpoints())
    chunks = len(recording.store.frames_of(paths.CHECKPOINT))
    assert len(decoded) == chunks < len(steps) == len(together)
    for one, other in zip(alone, together, strict=True):
        assert one.fingerprint == other.fingerprint and one.step == other.step
    some = [steps[3], steps[1], steps[-1]]
    assert [state.step for state in recording.checkpoints(some)] == some
    with pytest.raises(RecordingError, match="has no checkpoint at step 1000"):
        list(recording.checkpoints([steps[0], 1000]))


@dataclass(frozen=True)
class Part:
    charge: Annotated[FloatArray, Saved("charge", "C", BODY)]
    field: Annotated[FloatArray | None, Saved("field", "V/m", BODY, 3)] = None


def test_a_saved_array_is_one_row_by_which_it_is_stored_read_and_checked() -> None:
    part = Part(np.arange(4.0), np.arange(12.0).reshape(4, 3))
    stored = _components_of(part)
    again = _Row(stored, 4).part(Part)
    assert again.charge.tobytes() == part.charge.tobytes() and again.field.tobytes() == np.arange(12.0).tobytes()
    assert _Row({"charge": stored["charge"]}, 4).part(Part).field is None
    with pytest.raises(ValueError, match="field has 12 values instead of 15"):
        _Row({"charge": np.zeros(5), "field": stored["field"]}, 5).part(Part)


def test_no_two_saved_fields_have_one_name_and_all_but_numbers_have_a_unit() -> None:
    table = list(all_saved(Checkpoint))
    assert len({each.name for each in table}) == len(table) > 30
    without = {each.name for each in table if not each.unit and not each.is_pairs}
    assert without == {"orientation", "orbit_series", "orbit_order", "pistons", "release_slots", "release_totals"}
