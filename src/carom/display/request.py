"""The request for a view of a recording: a moment or an event, bodies, plots and colours.

`ShownStep` is the step that contains the moment. The step is computed again if it has no frame, or if its frame lacks
data.
"""

from __future__ import annotations

import time as clock
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from carom.arrays import FloatArray, IntArray
from carom.errors import PhysicsError, RecordingError
from carom.physics.simulation import StepStatus
from carom.recording.read.frame_rows import RecordedPositions
from carom.recording.read.lookup import frame_of, tolerance
from carom.recording.read.named_events import Pair
from carom.recording.read.recorded_contacts import rows_of_engine
from carom.recording.read.recording import Recording
from carom.recording.schema.header import Header, TimeScale
from carom.recording.timelines import STEP
from carom.recording.write.impact_frames import Instant, instants, velocities_at
from carom.runs.window import Window
from carom.state.frame import CollisionGraph, Frame


@dataclass(frozen=True, slots=True)
class Request:
    """A moment of a recording, the bodies to show close up, plots, and colours.

    Without a time and an event, the moment is the hardest impact or, without impacts, the step with the most contacts.
    Giving both raises RecordingError.
    """

    at: float | None = None  # s
    event: str | None = None  # name of an event, whose bodies the close-up view shows
    # bodies of the close-up view: two numbers or names separated by a comma, or one for a body on a plane
    bodies: str | None = None
    plot: str | None = None  # quantities of bodies to plot, such as ``top.z,top.omega``
    colour_by: str | None = None  # property that sets the colours; by default as the scene states
    edges: str = "impulse"  # quantity that the edges beside the bodies show: "impulse", or the "stage" of the solver
    # causes of rotation: "one" arrow for a torque and its angular acceleration, with both numbers, or "both" arrows
    arrows: str = "one"

    def __post_init__(self) -> None:
        """Refuse two moments."""
        if self.at is not None and self.event is not None:
            raise RecordingError("give a time (at) or an event, not both")


def pair_of_step(frame: Frame, bodies: int) -> Pair | None:
    """Return the ends of the contact with the largest impulse, or of the first contact; None without any."""
    graph = frame.contacts
    if not len(graph):
        return None
    rows = frame.contact_rows
    row = graph.first
    if rows is not None and len(rows) == len(graph):
        parts = np.stack([rows[name] for name in ("normal_impulse", "friction_x", "friction_y", "friction_z")], axis=1)
        row = int(np.argmax(np.linalg.norm(parts, axis=1)))
    i, j = (int(end) for end in graph.pairs[row])
    return Pair(i, j) if j < bodies else Pair(i, None, j - bodies)


Watcher = Callable[[StepStatus], None]

PATIENCE = 60.0  # s of repeated steps, for a step without a frame
IMPATIENCE = 10.0  # s of repeated steps, for a step with a frame
_MOST_BYTES = 50_000_000  # bytes, largest size of the frames between two recorded frames
_BODY_BYTES = 300  # bytes of a body in a frame


@dataclass(frozen=True, slots=True)
class ShownStep:
    """A step of a recording, as shown."""

    step: int
    time: float  # s, time at the end of the step
    # (n, 3) m, positions of the shown bodies from the recording's origin; NaN for bodies that wait
    position: FloatArray
    frame: Frame | None = None  # the step, if it was repeated
    before: Frame | None = None  # the frame before the frames in `added`
    added: Sequence[Frame] = ()  # repeated steps: the shown step, the steps between recorded frames, and the next frame
    state: Instant | None = None  # energies and spins before and after an instant within the step
    velocities: FloatArray | None = None  # (2, b, 3) m/s, velocities of an instant's bodies before and after it
    missing: str = ""  # why the step could not be repeated, if the step has no frame


def shown_step(
    recording: Recording, at: float, within: int | None = None, *, dense: bool = False, watch: Watcher = lambda _: None
) -> ShownStep:
    """Find the step that contains a time (s), and repeat it if that takes no more than a minute.

    If the time is the end of one step and the start of the next, ``within`` is the step to show, by default the step
    that ends. With ``dense``, all steps up to the next recorded frame are added. ``watch`` is called while steps are
    repeated. Raises RecordingError if there is no frame.
    """
    table = recording.fingerprints()
    times, steps = table["time"].to_numpy(), table[STEP].to_numpy()
    recording.require_frames()
    row, goal = frame_of(recording, at), at - tolerance(at)
    if row is not None and within is not None and steps[row] < within:
        row, goal = _row_of(within, steps), float(np.nextafter(times[row], np.inf))
    if row is not None:
        goal = float(times[row])
    last = row if row is not None else max(0, int(np.searchsorted(times, goal)) - 1)
    position = RecordedPositions(recording).drawn(int(steps[last])) - recording.origin
    drawn = ShownStep(int(steps[last]), float(times[last]), position)
    if not recording.shows_all:
        return drawn if row is not None else replace(drawn, missing="the clip shows only some of the bodies")
    if recording.engine and recording.records_contacts and row is not None:
        return replace(drawn, frame=_frame_of_engine(recording, row))
    try:
        limit = IMPATIENCE if row is not None else PATIENCE
        found = _run(recording, goal, times, within if row is None else None, limit, dense, watch)
    except (RecordingError, PhysicsError) as error:
        missing = str(error)
    else:
        if found is not None:
            return found
        missing = f"rerunning it takes more than {PATIENCE:.0f} s"
    return drawn if row is not None else replace(drawn, missing=missing)


def _frame_of_engine(recording: Recording, row: int) -> Frame | None:
    """Return a frame of another engine with its state and its contacts; None if it has no exact state."""
    step = int(recording.fingerprints()[STEP][row].as_py())
    if step not in recording.checkpoint_times:
        return None
    state = recording.checkpoint(step)
    rows, dt = rows_of_engine(recording, row)
    pairs = np.stack([rows["i"], rows["j"]], axis=1)
    normals = np.stack([rows["nx"], rows["ny"], rows["nz"]], axis=1)
    return Frame(
        step=step,
        time=state.time,
        dt=dt,
        dt_limit="",
        position=state.position,
        velocity=state.velocity,
        acceleration=state.acceleration,
        orientation=state.orientation,
        angular_velocity=state.angular_velocity,
        torque=None,
        angular_acceleration=None,
        contacts=CollisionGraph(pairs, normals, np.zeros(len(rows)), np.zeros(len(rows), dtype=np.int64)),
        energy=state.energy,
        momentum=np.zeros(3),
        angular_momentum=np.zeros(3),
        sweeps=0,
        phase="",
        events=(),
        previous_dt=dt,
        memory=None,
        books=state.books,
        contact_rows=rows,
    )


def at_impact(
    step: ShownStep,
    pair: Pair,
    header: Header,
    origin: FloatArray,
    near: float,
    clock: TimeScale,
    *,
    at_end: bool = False,
) -> ShownStep | None:
    """Return the instant of an impact within a repeated step; None if the pair has no impact before the step ends.

    The frame of the instant holds positions and contacts, and its state holds the quantities that jump at the instant.
    Among several impacts of the pair, the nearest to the time ``near`` (s) is chosen, and among equally near impacts
    the fastest. If ``near`` is the end of the step, the fastest impact is chosen. An impact within a nanosecond of the
    end of the step is shown at this end, and found only with ``at_end``.
    """
    frame, n = step.frame, header.bodies
    earlier = [one for one in (step.before, *step.added) if one is not None and one.step < step.step]
    if frame is None or frame.impacts is None or not earlier:
        return None
    before, impacts = earlier[-1], frame.impacts
    j = pair.j if pair.j is not None else None if pair.plane is None else n + pair.plane
    partner = impacts["j"] >= n if j is None else impacts["j"] == j
    is_within = clock.nanoseconds(impacts["time"]) < clock.nanoseconds([frame.time])
    own = np.flatnonzero((impacts["i"] == pair.i) & partner & (is_within != at_end))
    if not len(own):
        return None
    off = np.abs(impacts["time"][own] - near)
    off[off <= tolerance(near)] = 0.0
    if abs(near - frame.time) <= tolerance(near):  # ``near`` is the end of the step, not the time of an impact
        off[:] = 0.0
    k = own[np.lexsort((-impacts["approach_speed"][own], off))[:1]]
    (state,) = instants(header, before, frame, impacts, k, np.ones(1, np.int64))
    position = np.asarray(state.frame.seen - origin)
    shown = ShownStep(step.step, state.frame.time, position, state.frame, step.before, step.added, state=state)
    return replace(shown, velocities=velocities_at(header, before, frame, impacts, int(k[0]), state.bodies))


def _row_of(step: int, steps: IntArray) -> int | None:
    """Return the row of a step's frame; None if the step has no frame."""
    row = int(np.searchsorted(steps, step))
    return row if row < len(steps) and steps[row] == step else None


def _run(
    recording: Recording, goal: float, times: FloatArray, within: int | None, limit: float, dense: bool, watch: Watcher
) -> ShownStep | None:
    """Repeat the steps until a step contains a time (s), or until the next frame; None if the search takes too long.

    If the time is the end of one step and the start of the next, ``within`` is the number of the step to show.
    """
    own = int(np.searchsorted(times, goal))
    earlier = float(times[max(0, own - 1)])
    until = float(times[own]) if dense and own < len(times) else goal
    most = max(2, _MOST_BYTES // (_BODY_BYTES * len(recording.shown)))
    added: list[Frame] = []
    before, shown = None, None
    started: float | None = None
    window = Window(recording, goal, watch=watch, contacts=True)
    for frame in window.frames(earlier):
        started = clock.monotonic() if started is None else started
        if clock.monotonic() - started > limit:
            return None
        if frame.time <= earlier and frame.time < goal:
            before = frame
            continue
        if len(added) == most:  # only the last steps are kept
            before = added.pop(0)
        added.append(frame)
        if shown is None and frame.time >= goal and (within is None or frame.step >= within):
            shown = frame
        if shown is not None and frame.time >= until:
            break
    if window.differs is not None:
        raise RecordingError(f"when rerun, its bits differ from step {window.differs} on")
    if shown is None:
        return None
    position = np.asarray(shown.seen - recording.origin)
    return ShownStep(shown.step, shown.time, position, shown, before, added)
