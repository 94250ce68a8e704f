"""Data of a recording: read from the file if they are there, otherwise computed from an earlier checkpoint."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from carom.arrays import BoolArray, FloatArray, IntArray
from carom.errors import NotRecordedError, RecordingError, SceneError
from carom.recording.export import Snapshot
from carom.recording.read.lookup import end_of_step, goal_of, interval, tolerance
from carom.recording.read.recorded_contacts import MEASURED, named_contacts
from carom.recording.read.recording import Recording
from carom.recording.read.state_columns import state_vectors
from carom.recording.timelines import STEP
from carom.scene.schema.body import SOLID
from carom.state.checkpoint import Checkpoint
from carom.state.frame import Frame

if TYPE_CHECKING:
    from carom.runs.window import Watcher, Window

_ROUNDING = 1e-12  # relative rounding of moments of inertia that were computed from masses and radii


def contacts_of(
    recording: Recording, at: float | None = None, *, replay: bool = False, watch: Watcher | None = None
) -> pa.Table:
    """Return the contacts of the step that contains a time (s); see `Recording.contacts`.

    With ``replay``, the step is always computed, so that all columns are in float64. ``watch`` receives the progress of
    the computation.
    """
    moment = recording.moment(at)

    def computed() -> pa.Table:
        return _window(recording, goal_of(recording, moment), contacts=True, watch=watch).contacts(moment)

    return computed() if replay else _recorded_or(computed, lambda: recording.contacts(moment))


def impacts_of(
    recording: Recording,
    start: float | None = None,
    end: float | None = None,
    *,
    replay: bool = False,
    watch: Watcher | None = None,
) -> pa.Table:
    """Return the impacts of an interval (s); see `Recording.impacts`.

    With ``replay``, the steps are always computed, so that all impacts are there, with all columns in float64.
    ``watch`` receives the progress of the computation.
    """
    first, last = interval(recording, start, end)
    first, last = first - tolerance(first), last + tolerance(last)

    def computed() -> pa.Table:
        return _window(recording, first, contacts=True, watch=watch).impacts(first, last)

    return computed() if replay else _recorded_or(computed, lambda: recording.impacts(start, end))


def time_of_step(recording: Recording, step: int, watch: Watcher | None = None) -> float:
    """Return the time (s) at the end of a step; a step without a frame is rerun, and ``watch`` receives the progress.

    Raises RecordingError if the recording does not contain the step, or cannot be rerun.
    """
    recording.require_frames()
    if (time := end_of_step(recording, step)) is not None:
        return time
    table = recording.fingerprints()
    times, steps = table["time"].to_numpy(), table[STEP].to_numpy()
    row = int(np.searchsorted(steps, step))
    if row in (0, len(steps)):
        raise RecordingError(f"{recording.path} covers steps {steps[0]} to {steps[-1]}; step {step} is outside")
    if recording.engine or recording.is_overlay:
        known = f"the nearest are steps {steps[row - 1]} and {steps[row]}"
        raise RecordingError(f"{recording.path} has no frame of step {step}, and cannot be rerun; {known}")
    begin = float(times[row - 1])
    for frame in _window(recording, begin, watch=watch).frames(begin):
        if frame.step >= step:
            return frame.time
    raise RecordingError(f"{recording.path} ends before step {step} when it is rerun; its bits differ")


def _window(recording: Recording, begin: float, *, contacts: bool = False, watch: Watcher | None = None) -> Window:
    """Return a rerun from a time (s)."""
    from carom.runs.window import Window  # noqa: PLC0415 - most files hold what is asked for; kernels take 0.4 s to import

    return Window(recording, begin, contacts=contacts, watch=watch)


def _recorded_or(computed: Callable[[], pa.Table], recorded: Callable[[], pa.Table]) -> pa.Table:
    """Return the recorded table if it exists and its numbers are within float32 (3.4e38), otherwise ``computed``."""
    try:
        table = recorded()
    except NotRecordedError:
        return computed()
    if any(bool(np.isinf(table[name].to_numpy()).any()) for name in MEASURED):
        with suppress(RecordingError, SceneError):
            return computed()
    return table


def snapshots(
    recording: Recording, at: float | None, *, everything: bool, watch: Watcher | None = None
) -> Iterator[Snapshot]:
    """Yield the state at a time (s), or all recorded frames; steps between checkpoints are recomputed.

    Raises RecordingError if there is no such moment, or a rerun does not give the same bits.
    """
    table = recording.fingerprints()
    times, steps = table["time"].to_numpy(), table[STEP].to_numpy()
    recording.require_frames()
    moment = float(times[0]) if everything else recording.moment(at)
    goal = goal_of(recording, moment)
    energies = recording.energy().column_names
    if recording.engine:
        yield from _kept(recording, steps if everything else steps[[int(np.searchsorted(times, goal))]], energies)
        return
    window = _window(recording, goal, contacts=True, watch=watch)
    own = _own(recording, window.fixed)
    wanted, left = (set(steps.tolist()), len(steps)) if everything else (set[int](), 1)
    frames = window.frames(np.inf if everything else goal)
    chosen = (frame for frame in frames if (frame.step in wanted if everything else frame.time >= goal))
    for frame in itertools.islice(chosen, left):
        if window.differs is not None:
            raise RecordingError(f"{recording.path}: the rerun has different bits from step {window.differs} on")
        left -= 1
        contacts, cell = window.contacts_of(frame), window.cell(frame.time)
        yield _snapshot(recording, energies, frame, *_present(frame, *own), contacts, cell)
    if left:
        raise RecordingError(f"{recording.path} ends earlier when it is rerun; its bits differ")


def _present(
    frame: Frame, body: IntArray, mass: FloatArray, radius: FloatArray, others: dict[str, Any]
) -> tuple[IntArray, FloatArray, FloatArray, dict[str, Any]]:
    """Return the values of the bodies that are not waiting to enter at the time of a frame."""
    if (waits := frame.waits) is None:
        return body, mass, radius, others
    there = ~waits[body]
    return body[there], mass[there], radius[there], {name: values[there] for name, values in others.items()}


def _kept(recording: Recording, steps: IntArray, energies: Sequence[str]) -> Iterator[Snapshot]:
    """Yield the exact states of some frames of a run that cannot be repeated."""
    body, mass, radius, others = _own(recording, np.zeros(len(recording.bodies.mass), np.bool_))
    kept = recording.checkpoint_times
    if missing := [int(step) for step in steps if step not in kept]:
        raise RecordingError(
            f"{recording.path} has no exact state at step {missing[0]} and cannot be rerun; record with exact=True"
        )
    for state in recording.checkpoints(steps.tolist()):
        there = recording.present(state.step)[body]
        own = {name: values[there] for name, values in others.items()}
        contacts = recording.contacts(state.time) if recording.records_contacts else None
        yield _snapshot(recording, energies, state, body[there], mass[there], radius[there], own, contacts)


def _snapshot(
    recording: Recording,
    energies: Sequence[str],  # names of series
    state: Checkpoint | Frame,
    body: IntArray,
    mass: FloatArray,
    radius: FloatArray,
    others: dict[str, NDArray[Any]],
    contacts: pa.Table | None,
    cell: FloatArray | None = None,
) -> Snapshot:
    vectors = state_vectors(state, body, recording.bodies.mass, recording.bodies.inertia)
    known = dict[str, float]()
    for name in energies:
        # the series belongs to a package that is not installed here, or is not an energy
        with suppress(AttributeError):
            known[name] = state.energy.named(name)
    if contacts is not None:
        contacts = named_contacts(recording, contacts).replace_schema_metadata()  # the metadata belong to one step
    return Snapshot(state.step, state.time, body, mass, radius, others, vectors, known, contacts, cell)


def _own(recording: Recording, fixed: BoolArray) -> tuple[IntArray, FloatArray, FloatArray, dict[str, NDArray[Any]]]:
    """Return numbers, masses and radii of the shown bodies, and further columns that differ from the defaults."""
    bodies, shown, found = recording.bodies, np.array(recording.shown, dtype=np.int64), dict[str, NDArray[Any]]()
    mass, radius, inertia = (np.asarray(each)[shown] for each in (bodies.mass, bodies.radius, bodies.inertia))
    if not np.allclose(inertia, SOLID * mass * radius * radius, rtol=_ROUNDING, atol=0.0):
        found["inertia"] = inertia
    if fixed[shown].any():
        found["fixed"] = fixed[shown]
    names = [bodies.name[body] for body in recording.shown]
    if any(name != f"body {row}" for row, name in enumerate(names)):
        found["name"] = np.array(names, dtype=np.str_)
    return shown, mass, radius, found
