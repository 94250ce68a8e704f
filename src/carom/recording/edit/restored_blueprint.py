"""Makes a layout for a recording without one: the run was killed before it sent one, or it was lost."""

from __future__ import annotations

import numpy as np
import rerun.blueprint as rrb

from carom.recording.layout.blueprint import blueprint
from carom.recording.layout.camera import CameraFit, corners_of
from carom.recording.read.recorded_header import header_of_recording, recorded_curves
from carom.recording.read.recording import Recording
from carom.recording.schema import paths

_LOOKS = 50  # frames by which the camera is placed


def new_layout(recording: Recording) -> rrb.Blueprint:
    """Lay out a recording as the recorder would have done. RecordingError if too little of it is left."""
    header = header_of_recording(recording)
    entries = [e for e in recording.store.entries if e.entity_path == paths.BODIES and e.first_step is not None]
    entries = sorted(entries, key=lambda entry: entry.first_step or 0)
    some = [entries[k] for k in sorted(set(np.linspace(0, len(entries) - 1, _LOOKS).astype(int)))] if entries else []
    fit, corners = None, corners_of(header, recording.origin)
    for chunk in recording.chunks(some):
        centres = next((chunk.batch[name] for name in paths.CENTRES if name in chunk.components), None)
        if centres is None:  # the component's name is damaged
            continue
        first, last = (centres[row].values.flatten().to_numpy().reshape(-1, 3) for row in (0, len(centres) - 1))
        fit = fit or CameraFit(header.radius, first, corners)
        fit.look(last)
    if fit is None:
        fit = CameraFit(header.radius, np.zeros((len(header.radius), 3)), corners)
    return blueprint(header, fit, recorded_curves(recording))
