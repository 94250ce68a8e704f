"""The exceptions that carom raises; each message is one sentence for a person."""

from carom.experiment.error import ExperimentError
from carom.physics.error import PhysicsError
from carom.recording.errors import RecordingError
from carom.scene.error import SceneError

__all__ = ["ExperimentError", "PhysicsError", "RecordingError", "SceneError"]
