"""Opens a recording in a viewer window, at a moment."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from carom.recording.read.recording import Recording
from carom.show.presentation import Presentation, asked
from carom.show.request import Request
from carom.show.viewer import Viewer


def open_window(path: str | Path, request: Request, *, say: Callable[[str], None] = lambda _: None) -> None:
    """Open a recording, paused at a moment; return when the window is closed.

    Parameters
    ----------
    path
        The recording.
    request
        What to show of it.
    say
        Called with the reason if the step of that moment cannot be shown.

    Raises
    ------
    RecordingError
        If the recording cannot be read, there is no such moment, event, body or quantity, or no screen.
    """
    recording = Recording.open(path)
    shown: Presentation | None = None
    moment = request.at
    if not recording.is_overlay:
        shown = asked(recording, request, dense=True)
        moment = shown.time
    with Viewer() as viewer:
        viewer.show(recording)
        if shown is not None:
            viewer.add(shown.supplement)
            say(shown.missing)
        if moment is not None:
            viewer.go_to(recording, moment)
        viewer.wait()
