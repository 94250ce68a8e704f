import socket
from pathlib import Path

import pytest

from carom.display.viewer import Viewer
from carom.errors import RecordingError
from carom.recording.read.recording import Recording
from carom.recording.write.recorder import FrameRecorder
from needs import PICTURES
from scripted_run import ScriptedRun


def test_nobody_listening_is_told_at_once(tmp_path: Path, scripted: ScriptedRun) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{taken.getsockname()[1]}"
        with pytest.raises(RecordingError, match="no viewer listens"):
            FrameRecorder(tmp_path / "run.rrd", scripted.header, live=address)
    assert not (tmp_path / "run.rrd").exists()


def test_an_address_without_a_port_is_explained(tmp_path: Path, scripted: ScriptedRun) -> None:
    with pytest.raises(RecordingError, match="HOST:PORT"):
        FrameRecorder(tmp_path / "run.rrd", scripted.header, live="localhost")


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:the live viewer has gone")
@pytest.mark.needs(PICTURES)
def test_a_viewer_that_goes_away_does_not_stop_the_file(tmp_path: Path, scripted: ScriptedRun) -> None:
    frames = list(scripted.frames(400))
    with Viewer("--headless") as viewer:
        recorder = FrameRecorder(tmp_path / "run.rrd", scripted.header, live=viewer.address)
        for frame in frames[:200]:
            recorder.put(frame)
        viewer.until("receive the run", 30, lambda: bool(viewer.client.get_state().recordings))
    for frame in frames[200:]:
        recorder.put(frame)
    recorder.finish("completed")
    assert Recording.open(tmp_path / "run.rrd").frames == 400
