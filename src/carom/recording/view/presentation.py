"""Chooses how a recording is shown at one moment: where the camera stands, and what is laid out."""

from __future__ import annotations

import numpy as np

from carom.recording.errors import RecordingError
from carom.recording.read.positions import RecordedPositions
from carom.recording.read.recording import Recording
from carom.recording.schema.clock import Clock
from carom.recording.schema.timelines import STEP
from carom.recording.view.blueprint import ALL, WINDOW, blueprint
from carom.recording.view.camera import CameraFit, corners_of
from carom.recording.view.canvas import Canvas
from carom.recording.view.recorded_curves import recorded_curves
from carom.recording.view.recorded_header import header_of_recording
from carom.recording.view.supplement import Supplement


def presentation(recording: Recording, moment: float, canvas: Canvas = WINDOW, only: str = ALL) -> Supplement:
    """Return the layout that shows a moment (s).

    Parameters
    ----------
    recording, moment
        What to show.
    canvas
        The window.
    only
        The one view to show, or all.

    Raises
    ------
    RecordingError
        If there is no frame, or nothing that the view could show.
    """
    header = header_of_recording(recording)
    position = RecordedPositions(recording).drawn(step_at(recording, moment)) - recording.origin
    camera = CameraFit(header.radius, position, corners_of(header, recording.origin))
    return Supplement(
        blueprint(header, camera, recorded_curves(recording), canvas, only), Clock(float(recording.info["time_scale"]))
    )


def step_at(recording: Recording, moment: float) -> int:
    """Return the step of the last frame up to a moment (s), else of the first frame."""
    table = recording.fingerprints()
    if table.num_rows == 0:
        raise RecordingError(f"{recording.path} holds no frame: {recording.outcome}")
    row = int(np.searchsorted(table["time"].to_numpy(), moment, side="right")) - 1
    return int(table[STEP][max(0, row)].as_py())
