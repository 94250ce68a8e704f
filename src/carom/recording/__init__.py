"""What is kept of a run: writing it, reading it back, looking at it. The one package that imports rerun."""

from carom.recording.errors import RecordingError
from carom.recording.header import Header
from carom.recording.recorder import Recorder
from carom.recording.recording import Recording

__all__ = ["Header", "Recorder", "Recording", "RecordingError"]
