"""Opens a recording in a viewer window, at a moment."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from carom.recording.read.recording import Recording
from carom.recording.view.presentation import Presentation, asked
from carom.recording.view.viewer import Viewer


def open_window(
    path: str | Path,
    at: float | None = None,
    *,
    event: str | None = None,
    bodies: str | None = None,
    plot: str | None = None,
    colour_by: str | None = None,
    say: Callable[[str], None] = lambda _: None,
) -> None:
    """Open a recording, paused at a moment; return when the window is closed.

    Parameters
    ----------
    path
        The recording.
    at
        s; without it, the event, else the most interesting moment.
    event
        Its name; the close-up view shows its bodies.
    bodies
        The bodies of the close-up view, by numbers or names with a comma between them.
    plot
        Quantities of bodies to plot, such as ``top.z,top.omega``.
    colour_by
        What tells the bodies apart; by default what the scene says.
    say
        Called with the reason where the step of that moment cannot be shown.

    Raises
    ------
    RecordingError
        If the recording cannot be read, there is no such moment, event, body or quantity, or no screen.
    """
    recording = Recording.open(path)
    shown: Presentation | None = None
    moment = at
    if not recording.is_overlay:
        shown = asked(recording, at, event, bodies, plot=plot, colour_by=colour_by, dense=True)
        moment = shown.time
    with Viewer() as viewer:
        viewer.show(recording)
        if shown is not None:
            viewer.add(shown.supplement)
            say(shown.missing)
        if moment is not None:
            viewer.go_to(recording, moment)
        viewer.wait()
