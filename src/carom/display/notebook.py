"""Shows a recording in a notebook. Needs `carom[notebook]`."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from rerun.notebook import RecordingOpenEvent, TimelineChangeEvent, Viewer, ViewerEvent

from carom.display.presentation import asked
from carom.display.request import Request
from carom.errors import RecordingError, install_extra
from carom.private_folder import temporary_folder
from carom.recording.read.recording import Recording
from carom.recording.schema.header import TimeScale
from carom.recording.timelines import SIM_TIME
from carom.recording.write.rerun_compat import send_to_notebook


def show(
    recording: Recording | str | Path,
    at: float | None = None,
    *,
    height: int = 600,
    event: str | None = None,
    bodies: str | None = None,
) -> None:
    """Display Rerun's viewer below the cell of a notebook, paused at a moment. Needs `carom[notebook]`.

    The moment, the event and the bodies are chosen as in `carom.view`. The height is in pixels; the width is the width
    of the cell. Raises RecordingError if there is no such moment, event or body, or rerun-notebook is not installed.
    """
    recording = recording if isinstance(recording, Recording) else Recording.open(recording)
    request = Request(at, event, bodies)
    if recording.is_overlay:
        moment, extra = recording.moment(request.at), b""
    else:
        shown = asked(recording, request, dense=True)
        with temporary_folder() as folder:
            path = folder / "moment.rrd"
            shown.supplement.save(path, recording.store.application_id, recording.store.store_id)
            moment, extra = shown.time, path.read_bytes()
    try:
        viewer = Viewer(width="auto", height=height, use_global_recording=False)
    except ImportError:
        raise RecordingError(f"a notebook needs rerun-notebook: {install_extra('notebook')}") from None
    shown_at = np.timedelta64(int(TimeScale(float(recording.info["time_scale"])).nanoseconds([moment])[0]), "ns")
    waiting = {RecordingOpenEvent, TimelineChangeEvent}  # the viewer ignores times until it knows the timeline

    def pause(happened: ViewerEvent) -> None:
        if type(happened) in waiting:
            waiting.remove(type(happened))
            viewer.set_time_ctrl(timeline=SIM_TIME, duration=shown_at, play=False)

    viewer.on_event(pause)
    viewer.display()
    send_to_notebook(viewer, recording.path.read_bytes())
    if extra:
        send_to_notebook(viewer, extra)
    viewer.set_time_ctrl(timeline=SIM_TIME, duration=shown_at, play=False)
