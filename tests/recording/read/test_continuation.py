"""The data that a resumed run takes over from the recording of the previous run."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from carom.event import Event
from carom.recording.read.frame_rows import Continuation
from carom.recording.read.recording import Recording
from carom.recording.schema import paths
from carom.recording.write.recorder import FrameRecorder
from scripted_run import ScriptedRun

LARGEST = Event(8, 0.4, "INFO", "Hardest impact of the run, 3 J of approach (½ μ v_n²): a and b.", "extreme")
FRAMES = 20


def recorded(path: Path, scripted: ScriptedRun, event: Event) -> Recording:
    """Record a run with one event on its way, one extreme, and an end."""
    with FrameRecorder(path, scripted.header) as recorder:
        for frame in scripted.frames(FRAMES):
            recorder.put(replace(frame, events=(event,) if frame.step == event.step else ()))
        recorder.finish("interrupted: stopped by the user", {}, (LARGEST,))
    return Recording.open(path)


def texts_carried_over(recording: Recording) -> list[str]:
    chunks = [chunk for chunk in Continuation(recording, FRAMES - 1).chunks() if chunk.entity_path == paths.EVENTS]
    return [row[0] for chunk in chunks for row in chunk.batch["TextLog:text"].to_pylist()]


@pytest.mark.parametrize("text", ["end: of a long fall", "This is 9 times the pace of the run: it crawls."])
def test_a_resumed_run_keeps_events_by_their_kind_whatever_their_text_says(
    text: str, tmp_path: Path, scripted: ScriptedRun
) -> None:
    event = Event(5, 0.25, "WARN", text, "pace")
    assert texts_carried_over(recorded(tmp_path / "run.rrd", scripted, event)) == [text]
