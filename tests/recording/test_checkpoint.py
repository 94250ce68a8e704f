from pathlib import Path

import numpy as np
import pytest

from carom.physics.frame import Frame
from carom.recording.checkpoint import CheckpointPlan, StoredState, size
from carom.recording.errors import RecordingError
from carom.recording.recorder import Recorder
from carom.recording.recording import Recording
from merry import Merry


def record(path: Path, merry: Merry, frames: list[Frame]) -> Recording:
    with Recorder(path, merry.header) as recorder:
        for frame in frames:
            recorder.put(frame)
        recorder.finish("completed")
    return Recording.open(path)


def assert_same_bits(stored: StoredState, frame: Frame) -> None:
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
    merry = Merry(20, spins=spins)
    frames = list(merry.frames(120))
    recording = record(tmp_path / "run.rrd", merry, frames)
    for state in recording.checkpoints():
        assert_same_bits(state, frames[state.step])


def test_the_first_and_the_last_frame_and_warnings_have_one(tmp_path: Path) -> None:
    merry = Merry(20)
    steps = record(tmp_path / "run.rrd", merry, list(merry.frames(117))).checkpoint_steps
    assert {0, 30, 70, 110, 116} <= set(steps)
    assert len(steps) == len(set(steps))


def test_checkpoints_take_about_a_tenth() -> None:
    merry = Merry(20)
    frames = [f for f in merry.frames(600) if not f.events]
    plan, one, written, kept = CheckpointPlan(size(20, spins=True)), size(20, spins=True), 0, []
    for k in range(0, len(frames), 50):
        batch = frames[k : k + 50]
        chosen = plan.chosen(batch, written, 900 * len(batch))
        written += 900 * len(batch) + len(chosen) * one
        kept += [frame.step for frame in chosen]
    assert 0.05 < len(kept) * one / written <= 0.1
    assert np.ptp(np.diff(kept)) <= 5, "evenly, not in bursts"


def test_a_run_that_warns_at_every_step_does_not_fill_the_file_with_checkpoints() -> None:
    merry = Merry(20)
    warning = next(f for f in merry.frames(40) if any(e.level == "WARN" for e in f.events))
    plan = CheckpointPlan(size(20, spins=True))
    kept = plan.chosen([warning] * 600, 0, 600 * 900)
    assert 4 < len(kept) * size(20, spins=True) / 900 < 0.25 * 600


def test_asking_for_a_step_without_a_checkpoint_says_so(tmp_path: Path) -> None:
    merry = Merry(5)
    recording = record(tmp_path / "run.rrd", merry, list(merry.frames(10)))
    with pytest.raises(RecordingError, match="no checkpoint at step 12345"):
        recording.checkpoint(12345)
