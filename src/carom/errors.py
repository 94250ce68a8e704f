"""The exceptions that carom raises; each message is one sentence for a person."""

from carom.physics.error import PhysicsError
from carom.recording.errors import RecordingError
from carom.runs.error import ExperimentError
from carom.scene.error import SceneError

__all__ = ["ExperimentError", "PhysicsError", "RecordingError", "SceneError"]
