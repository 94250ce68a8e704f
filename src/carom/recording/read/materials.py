"""The materials of a recorded scene."""

from __future__ import annotations

from typing import TYPE_CHECKING

from carom.errors import RecordingError, SceneError
from carom.recording.schema.materials import ShownMaterials

if TYPE_CHECKING:
    from carom.recording.read.recording import Recording


def materials_of(recording: Recording) -> ShownMaterials | None:
    """Return the materials of a recording; None if it has none, or this version cannot read the scene."""
    if "material" not in recording.scene_toml:  # reading a scene of many bodies takes seconds
        return None
    from carom.recording.read.restore import recorded_scene  # noqa: PLC0415 - loads the physics

    try:
        return ShownMaterials.of(recorded_scene(recording))
    except (RecordingError, SceneError):
        return None
