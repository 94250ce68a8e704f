"""A picture of a recording, rendered without a screen."""

from __future__ import annotations

import time
from pathlib import Path

from carom.recording.errors import RecordingError
from carom.recording.read.recording import Recording
from carom.recording.view.canvas import Canvas
from carom.recording.view.presentation import presentation
from carom.recording.view.viewer import Viewer

_ALIKE = 3  # equal pictures in a row, after which nothing is still loading
_PAUSE = 0.7  # s between two of them
_LIMIT = 120.0  # s


def render(path: str | Path, at: float | None, out_png: str | Path, size: tuple[int, int] = (1600, 1000)) -> float:
    """Render the window at a simulated time (s) into a PNG; return that time.

    Without a time it is the most interesting moment: the hardest impact, else the most contacts. RecordingError if
    the recording cannot be read, there is no Vulkan driver, or a view cannot show what it should.
    """
    recording = Recording.open(path)
    moment = recording.moment(at)
    with Viewer("--headless", "--window-size", f"{size[0]}x{size[1]}") as viewer:
        viewer.show(recording)
        if not recording.is_overlay:
            viewer.add(presentation(recording, moment, Canvas(*size)))
        viewer.go_to(recording, moment)
        png = _settled(viewer)
        reports = [f"{view.name}: {report}" for view in viewer.client.get_state().views for report in view.reports]
    if reports:
        raise RecordingError(f"the viewer cannot show all of {path}: " + "; ".join(reports))
    try:
        Path(out_png).write_bytes(png)
    except OSError as error:
        raise RecordingError(f"cannot write {out_png}: {error.strerror}") from error
    return moment


def _settled(viewer: Viewer) -> bytes:
    """Take pictures until they stay the same: the viewer loads what it shows bit by bit."""
    alike, last = 0, b""
    end = time.monotonic() + _LIMIT
    while alike < _ALIKE:
        if time.monotonic() > end:
            raise RecordingError(f"the viewer's picture did not settle within {_LIMIT:.0f} s")
        time.sleep(_PAUSE)
        png = viewer.screenshot()
        alike = alike + 1 if png == last else 1
        last = png
    return last
