"""What `carom shrink` begins with: a scene, a recording, or its own unfinished result."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from carom.errors import RecordingError
from carom.physics.placement import place
from carom.recording.edit.bundle import is_bundle, opened
from carom.recording.read.recorded_scene import recorded_scene, start_of
from carom.recording.read.recording import Recording
from carom.runs.window import checkpoint_before
from carom.scene.load import load_scene
from carom.scene.scene_file import RECORDED
from carom.scene.schema import Scene
from carom.scene.start import InitialBodies


@dataclass(frozen=True, slots=True)
class Source:
    """A scene with its bodies, and what it was called."""

    name: str
    scene: Scene
    start: InitialBodies


def source_of(given: str, overrides: list[str]) -> Source:
    """Read a scene, or the scene and the first checkpoint of a recording or a bundle.

    Raises
    ------
    SceneError, RecordingError
        If there is none, or a recording has nothing to run again.
    """
    path = Path(given)
    if not is_recording(path):
        scene = load_scene(given, overrides)
        return Source(given, scene, place(scene))
    with opened(path) as file:
        recording = Recording.open(file)
        if recording.clip.get("bodies"):
            raise RecordingError(f"{path}: a clip of some bodies cannot be run again; give the whole recording")
        scene = recorded_scene(recording, overrides)
        checkpoint = checkpoint_before(recording, 0.0)
        start = start_of(recording, scene, checkpoint)
    left = scene.time.duration - checkpoint.time
    if left <= 0.0:
        raise RecordingError(f"{path}: it has only its last state, so there is nothing to run again")
    later = scene.time.model_copy(update={"duration": left}) if checkpoint.time > 0.0 else scene.time
    return Source(given, scene.model_copy(update={"time": later}), start)


def is_recording(path: Path) -> bool:
    """Tell whether a file is a recording or a bundle with one."""
    if not path.is_file():
        return False
    with path.open("rb") as file:
        return file.read(len(RECORDED)) == RECORDED or is_bundle(path)
