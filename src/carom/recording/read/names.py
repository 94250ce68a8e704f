"""Names of the bodies, planes and walls of a recording."""

from __future__ import annotations

from typing import TYPE_CHECKING

from carom.errors import RecordingError, SceneError
from carom.recording.read.restore import recorded_scene
from carom.scene.start import half_spaces
from carom.scene.wording import Names

if TYPE_CHECKING:
    from carom.recording.read.recording import Recording


def names_of(recording: Recording) -> Names:
    """Return the names of all bodies, planes and walls; planes have none if this version cannot read the scene."""
    if recording.engine:
        return Names(recording.bodies.name, str(recording.info.get("plane_names", "")).split("\n"))
    try:
        planes = half_spaces(recorded_scene(recording)).name
    except (RecordingError, SceneError):
        planes = []
    return Names(recording.bodies.name, planes)
