"""A picture of a recording, rendered without a screen."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from carom.recording.errors import RecordingError
from carom.recording.read.recording import Recording
from carom.recording.view.blueprint import ALL
from carom.recording.view.canvas import Canvas
from carom.recording.view.light_theme import light_theme
from carom.recording.view.presentation import presentation
from carom.recording.view.viewer import Viewer

_ALIKE = 3  # equal pictures in a row, after which nothing is still loading
_PAUSE = 0.7  # s between two of them
_LIMIT = 120.0  # s
_BORDER = (7, 71)  # points of a window about its only view, that is title, edges and the strip to move the window by


def render(
    path: str | Path,
    at: float | None,
    out_png: str | Path,
    size: tuple[int, int] = (1600, 1000),
    *,
    view: str = ALL,
    theme: str = "dark",
) -> float:
    """Render a recording at a simulated time (s) into a PNG; return that time.

    Parameters
    ----------
    path
        The recording.
    at
        s; without it, the most interesting moment: the hardest impact, else the most contacts.
    out_png
        Where to write the picture.
    size
        Width and height in pixels.
    view
        One view that fills the picture, or all of them.
    theme
        Of the viewer, "dark" or "light"; the 3D views are dark in both.

    Raises
    ------
    RecordingError
        If the recording cannot be read, there is no Vulkan driver, or a view cannot show what it should.
    """
    recording = Recording.open(path)
    moment = recording.moment(at)
    whole = view == ALL or recording.is_overlay
    canvas = Canvas(*size, framed=whole)
    extra = None if recording.is_overlay else presentation(recording, moment, canvas, view)
    window = size if whole else (size[0] + _BORDER[0], size[1] + _BORDER[1])
    with _viewer(window, theme) as viewer:
        viewer.show(recording)
        if extra is not None:
            viewer.add(extra)
        viewer.go_to(recording, moment)
        png = _settled(viewer, None if whole else viewer.only_view())
        reports = [f"{shown.name}: {report}" for shown in viewer.client.get_state().views for report in shown.reports]
    if reports:
        raise RecordingError(f"the viewer cannot show all of {path}: " + "; ".join(reports))
    try:
        Path(out_png).write_bytes(png)
    except OSError as error:
        raise RecordingError(f"cannot write {out_png}: {error.strerror}") from error
    return moment


@contextmanager
def _viewer(size: tuple[int, int], theme: str) -> Iterator[Viewer]:
    window = ("--window-size", f"{size[0]}x{size[1]}")
    if theme == "dark":
        with Viewer("--headless", *window) as viewer:
            yield viewer
        return
    with light_theme(size) as environment, Viewer("--persist-state", *window, environment=environment) as viewer:
        yield viewer


def _settled(viewer: Viewer, view: str | None) -> bytes:
    """Take pictures until they stay the same: the viewer loads what it shows bit by bit."""
    alike, last = 0, b""
    end = time.monotonic() + _LIMIT
    while alike < _ALIKE:
        if time.monotonic() > end:
            raise RecordingError(f"the viewer's picture did not settle within {_LIMIT:.0f} s")
        time.sleep(_PAUSE)
        png = viewer.screenshot(view)
        alike = alike + 1 if png == last else 1
        last = png
    return last
