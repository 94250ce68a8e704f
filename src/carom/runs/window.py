"""Reruns a window of a recording, for data that were not recorded."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa

from carom.arrays import FloatArray
from carom.contact_table import NO_ROWS, ImpactSums
from carom.errors import PhysicsError, RecordingError, SceneError
from carom.physics.simulation import StepStatus
from carom.physics.space import Space
from carom.recording.read.lookup import goal_of, tolerance
from carom.recording.read.recorded_contacts import of_shown, table_of_rows, with_angular_impulses
from carom.recording.read.recorded_scene import fixed_of, recorded_scene, start_of
from carom.recording.read.recording import Recording
from carom.recording.read.state_columns import BodyTrajectories, state_table, state_vectors
from carom.recording.read.tables import frames_with, frames_within, shown_bodies, table_of_bodies
from carom.scene.load import Scene
from carom.scene.units.dimension import TIME
from carom.state.checkpoint import Checkpoint
from carom.state.frame import Frame

Watcher = Callable[[StepStatus], None]


def rerun(
    recording: Recording | str | Path,
    before: float,
    *,
    contacts: bool = False,
    threads: int | None = None,
    watch: Watcher | None = None,
) -> Window:
    """Run a recording again from its last checkpoint before a time (s), for data that the file does not hold.

    Like a `Recording`, the result offers bodies, contacts, impacts and trajectories, but computes them, in float64. A
    rerun only moves forward: request later times after earlier ones.

    Parameters
    ----------
    recording
        The recording, or its file.
    before
        s, the first requested time.
    contacts
        Whether contacts and impacts are requested.
    threads
        Threads for the kernels; the bits do not depend on it.
    watch
        Called after every frame with the progress.

    Raises
    ------
    RecordingError
        If the recording has no checkpoint, or cannot be rerun.
    """
    opened = recording if isinstance(recording, Recording) else Recording.open(recording)
    return Window(opened, before - tolerance(before), contacts=contacts, threads=threads, watch=watch)


class Window:
    """A window of a recording that is rerun, from the last checkpoint before a time (s).

    With ``contacts``, frames carry the contact table. ``watch`` receives the progress after every frame. Raises
    RecordingError or SceneError if the recording cannot be rerun.
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
        checkpoint = checkpoint_before(recording, float(np.nextafter(before, -np.inf)))
        self.begin = checkpoint.step
        self.differs: int | None = None  # first recorded step whose bits differ
        # sums of impacts since the previous frame, by step, for the frames of `impacts`
        self.impact_sums: dict[int, ImpactSums] = {}
        try:
            scene = recorded_scene(recording)
        except SceneError as error:
            raise RecordingError(f"{recording.path} cannot be rerun: {error}") from error
        self.fixed = fixed_of(scene)  # (n,)
        self._domain = scene.domain
        self._space = space_of(recording, scene, checkpoint, threads, record_contacts=contacts)

    def cell(self, time: float) -> FloatArray | None:
        """Return the size of the periodic box, (3,) m; for a sheared box, the vectors to its images at a time (s)."""
        if self._domain.period is None:
            return None
        size = np.array(self._domain.period)
        return self._domain.shear.cell(size, time) if self._domain.shear else size

    @property
    def source(self) -> str:
        """The source of the window's numbers, in words."""
        same = "with the same bits" if self.differs is None else f"with different bits from step {self.differs} on"
        return f"replayed from step {self.begin}, {same}"

    def frames(self, first: float) -> Iterator[Frame]:
        """Yield the first frame, then the recorded frames and, from a time (s) on, every step."""
        recorded = self._fingerprints
        for frame in self._space.run(schedule=lambda step, before, time: time >= first or step in recorded):
            bits = recorded.get(frame.step)
            if bits is not None and bits != frame.fingerprint and self.differs is None:
                self.differs = frame.step
            if self._watch:
                self._watch(self._space.status)
            yield frame

    def state_at(self, at: float) -> Frame:
        """Return the frame at the end of the step that contains a time (s)."""
        goal = goal_of(self._recording, at)
        for frame in self.frames(goal):
            if frame.time >= goal:
                return frame
        raise self._ends_before(at)

    def states(self, steps: Sequence[int], bodies: Sequence[int]) -> list[dict[str, FloatArray]]:
        """Return the states of selected bodies in recorded frames; ``steps`` has the frames' steps, ascending."""
        wanted, states = set(steps), list[dict[str, FloatArray]]()
        if steps[0] < self.begin:
            raise RecordingError(f"the rerun begins at step {self.begin}, after step {steps[0]}: rerun an earlier time")
        own, all_bodies = np.array(bodies, dtype=np.int64), self._recording.bodies
        for frame in self.frames(np.inf):
            if frame.step in wanted:
                states.append(state_vectors(frame, own, all_bodies.mass, all_bodies.inertia))
            if frame.step >= steps[-1]:
                break
        if len(states) < len(steps):
            raise RecordingError(f"{self._recording.path} ends earlier when it is rerun; its bits differ")
        return states

    def bodies(self, at: float) -> pa.Table:
        """Return the state of all bodies at the end of the step that contains a time (s); see `BodyTable`."""
        return table_of_bodies(self._recording, self.state_at(at), self.source)

    def trajectory(self, body: int | str, start: float = -np.inf, end: float = np.inf) -> pa.Table:
        """Return the path of one body, with one row for each frame between two times (s); see `Recording`."""
        number, steps, times = frames_with(self._recording, body, start, end)
        table = state_table(steps.tolist(), times.tolist(), self.states(steps.tolist(), [number]))
        exact = pa.array(np.ones(table.num_rows, dtype=bool))
        return table.append_column("exact", exact).replace_schema_metadata({"source": self.source})

    def trajectories(
        self, bodies: Sequence[int | str] | None = None, start: float = -np.inf, end: float = np.inf
    ) -> BodyTrajectories:
        """Return the paths of several bodies, with all quantities, between two times (s); see `Recording`."""
        numbers, (steps, times) = shown_bodies(self._recording, bodies), frames_within(self._recording, start, end)
        states = self.states(steps.tolist(), numbers)
        common = [name for name in states[0] if all(name in state for state in states)]
        vectors = {name: np.stack([state[name] for state in states]) for name in common}
        exact = np.ones(len(steps), dtype=np.bool_)
        return BodyTrajectories(np.array(numbers, dtype=np.int64), steps, times, exact, vectors, self.source)

    def contacts(self, at: float) -> pa.Table:
        """Return the contact table of the step that contains a time (s)."""
        goal = goal_of(self._recording, at)
        for frame in self.frames(goal):
            if frame.time >= goal and (table := self.contacts_of(frame)) is not None:
                return table
        raise self._ends_before(at)

    def impacts(self, first: float, last: float) -> pa.Table:
        """Return the impacts of the recorded steps from one time to another (s)."""
        steps = self._recording.fingerprints()["step"]
        begin, end, left_out = int(steps[0].as_py()), int(steps[-1].as_py()), 0
        found = [NO_ROWS]
        for frame in self.frames(np.inf):
            if frame.impacts is not None:
                found.append(frame.impacts)
                left_out += frame.impacts_left_out
            if frame.impact_sums is not None:
                self.impact_sums[frame.step] = ImpactSums.of(frame.impact_sums)
            if frame.time > last or frame.step >= end:
                break
        rows = np.concatenate(found)
        inside = (rows["step"] >= begin) & (rows["time"] >= first) & (rows["time"] <= last)
        table = self._of_recording(table_of_rows(rows[inside], self.source))
        return table.replace_schema_metadata({"source": self.source, "left_out": str(left_out)})

    def contacts_of(self, frame: Frame) -> pa.Table | None:
        """Return the contact table of a frame; None if the frame has no table."""
        if frame.contact_rows is None:
            return None
        return self._of_recording(table_of_rows(frame.contact_rows, self.source, frame.dt))

    def _of_recording(self, table: pa.Table) -> pa.Table:
        return with_angular_impulses(of_shown(table, self._recording), self._recording)

    def _ends_before(self, at: float) -> RecordingError:
        when = self._recording.units.text(at, TIME, ".9g")
        return RecordingError(f"{self._recording.path} ends before {when} when it is rerun; its bits differ")


def checkpoint_before(recording: Recording, time: float) -> Checkpoint:
    """Return the last checkpoint at or before a time (s), or otherwise the first one.

    Raises
    ------
    RecordingError
        If there is none.
    """
    times = recording.checkpoint_times
    if not times:
        raise RecordingError(f"{recording.path} has no checkpoint to start from: {recording.outcome}")
    earlier = [step for step, at in times.items() if at <= time]
    return recording.checkpoint(earlier[-1] if earlier else next(iter(times)))


def space_of(
    recording: Recording,
    scene: Scene,
    checkpoint: Checkpoint,
    threads: int | None = None,
    continued: bool = True,
    record_contacts: bool = False,
) -> Space:
    """Build a space in the state of a checkpoint.

    Bodies come from the recording, since random numbers may differ between libraries.

    Parameters
    ----------
    continued
        Whether the recorded run continues; otherwise the bodies of the checkpoint start another run. At the start of a
        run, a space already has the checkpoint's state and the contacts of frame 0.
    record_contacts
        Whether frames carry the contact table.

    Raises
    ------
    SceneError
        If the scene cannot run on this machine or in this version.
    RecordingError
        If the bodies cannot be simulated.
    """
    try:
        space = Space(scene, threads, start_of(recording, scene, checkpoint), record_contacts=record_contacts)
        needs, kept = space.requirements, (checkpoint.angular_velocity is not None, checkpoint.orientation is not None)
        if (needs.spin.modelled, needs.orientation.modelled) != kept:
            raise RecordingError(f"{recording.path}: its scene and its checkpoints do not agree on whether bodies spin")
        if continued:
            space.check_interval = recording.check_interval
        if continued and checkpoint.step > 0:
            space.restore(checkpoint)
        elif continued:
            space.begin_as(checkpoint)
    except PhysicsError as error:
        raise RecordingError(f"{recording.path} cannot be resumed from step {checkpoint.step}: {error}") from None
    return space
