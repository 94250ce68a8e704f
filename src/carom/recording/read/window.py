"""Runs a window of a recording again, for data that was not recorded."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

from carom.errors import RecordingError, SceneError
from carom.physics.frame import Frame
from carom.physics.status import StepStatus
from carom.recording.read.restore import fixed_of, recorded_scene, space_of

if TYPE_CHECKING:
    from carom.physics.checkpoint import Checkpoint
    from carom.recording.read.recording import Recording

Watcher = Callable[[StepStatus], None]


class Window:
    """Steps of a recording run again, from the last checkpoint before a time on.

    Parameters
    ----------
    recording
        What to run again.
    before
        s; the checkpoint is earlier than this, unless there is none.
    contacts
        Whether frames carry what contacts did.
    threads
        Threads for the kernels; the bits do not depend on it.
    watch
        Called after every frame with where the run stands.

    Raises
    ------
    RecordingError, SceneError
        If the recording cannot be run again.
    """

    def __init__(
        self,
        recording: Recording,
        before: float,
        *,
        contacts: bool = False,
        threads: int | None = None,
        watch: Watcher | None = None,
    ) -> None:
        self._recording = recording
        self._watch = watch
        table = recording.fingerprints()
        self._fingerprints = dict(zip(table["step"].to_pylist(), table["fingerprint"].to_pylist(), strict=True))
        checkpoint = _checkpoint_before(recording, before)
        self.begin = checkpoint.step
        self.differs: int | None = None  # the first recorded step whose bits are others
        try:
            scene = recorded_scene(recording)
        except SceneError as error:
            raise RecordingError(f"{recording.path} cannot be run again: {error}") from error
        self.fixed = fixed_of(scene)  # (n,)
        self.box = scene.domain.size if scene.domain.boundary == "periodic" else None  # m
        self._space = space_of(recording, scene, checkpoint, threads, record_contacts=contacts)

    @property
    def source(self) -> str:
        """Where its numbers come from, in words."""
        same = "with the same bits" if self.differs is None else f"with other bits from step {self.differs} on"
        return f"replayed from step {self.begin}, {same}"

    def frames(self, first: float) -> Iterator[Frame]:
        """Yield the frame that it begins with, then the recorded frames, and from a time (s) on every step."""
        recorded = self._fingerprints
        for frame in self._space.run(schedule=lambda step, before, time: time >= first or step in recorded):
            bits = recorded.get(frame.step)
            if bits is not None and bits != frame.fingerprint and self.differs is None:
                self.differs = frame.step
            if self._watch:
                self._watch(self._space.status)
            yield frame


def _checkpoint_before(recording: Recording, time: float) -> Checkpoint:
    """Return the last checkpoint before a time, else the first that there is."""
    times = recording.checkpoint_times
    if not times:
        raise RecordingError(f"{recording.path} has no checkpoint to start from: {recording.outcome}")
    earlier = [step for step, at in times.items() if at < time]
    return recording.checkpoint(earlier[-1] if earlier else next(iter(times)))
