"""The exact states and the paths of bodies as tables, and checkpoints."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa

from carom.arrays import FloatArray, IntArray
from carom.errors import NotRecordedError, RecordingError
from carom.recording.read.entities import (
    Values,
    centres_of,
    plain,
    reading,
    values_of,
)
from carom.recording.read.lookup import body_number, frame_of, shown_body, tolerance
from carom.recording.read.state_columns import (
    STATE_QUANTITIES,
    BodyTrajectories,
    in_columns,
    state_table,
    state_vectors,
    with_units,
)
from carom.recording.rrd.messages import release_memory
from carom.recording.schema import paths
from carom.recording.timelines import STEP
from carom.scene.units.dimension import TIME
from carom.scene.wording import body_called
from carom.state.checkpoint import Checkpoint
from carom.state.frame import Frame

if TYPE_CHECKING:
    from carom.recording.read.recorded_data import RecordedData
    from carom.recording.rrd.messages import Chunk


def bodies_at(recording: RecordedData, at: float | None) -> pa.Table:
    """Return the state of all bodies at the end of the step that contains a time (s); see `BodyTable`."""
    at = recording.moment(at)
    row, checkpoint = frame_of(recording, at), None
    if row is not None:
        step = int(recording.fingerprints()[STEP][row].as_py())
        checkpoint = recording.checkpoint(step) if step in recording.checkpoint_times else None
    if checkpoint is None:
        when = recording.units.text(at, TIME, ".9g")
        raise NotRecordedError(
            recording.path, f"the exact state at the end of the step that contains {when}", recording.engine
        )
    return table_of_bodies(recording, checkpoint, "checkpoint")


def table_of_bodies(recording: RecordedData, state: Checkpoint | Frame, source: str) -> pa.Table:
    """Return a state as a table of all bodies; see `BodyTable`."""
    numbers = np.flatnonzero(recording.present_in(state))
    vectors = state_vectors(state, numbers, recording.bodies.mass, recording.bodies.inertia)
    states = state_table([state.step], [state.time], [vectors])
    names = recording.bodies.name
    columns = {"body": pa.array(numbers), "name": pa.array([names[number] for number in numbers.tolist()])}
    columns |= {name: states[name] for name in states.column_names if name not in (STEP, "time")}
    told = {"step": str(state.step), "time": repr(state.time), "source": source}
    return with_units(pa.table(columns)).replace_schema_metadata(told)


def trajectory(recording: RecordedData, body: int | str, start: float, end: float) -> pa.Table:
    """Return the path of one body; see `Recording.trajectory`."""
    number, steps, times = frames_with(recording, body, start, end)
    found = _recorded_paths(recording, [shown_body(recording, number)], steps, times)
    columns: dict[str, Any] = {STEP: steps, "time": times}
    for quantity in STATE_QUANTITIES:
        if quantity.name in found.vectors:
            unknown = ~found.exact if quantity.name != "position" else None
            for name, values in in_columns(quantity, found.vectors[quantity.name][:, 0]).items():
                columns[name] = pa.array(values, mask=unknown)
    return with_units(pa.table(columns | {"exact": found.exact})).replace_schema_metadata({"source": found.source})


def trajectories(
    recording: RecordedData, bodies: Sequence[int | str] | None, start: float, end: float
) -> BodyTrajectories:
    """Return the paths of several bodies; see `Recording.trajectories`."""
    return _recorded_paths(recording, shown_bodies(recording, bodies), *frames_within(recording, start, end))


def shown_bodies(recording: RecordedData, bodies: Sequence[int | str] | None) -> list[int]:
    """Return the numbers of bodies, by default of all bodies that the recording shows."""
    return list(recording.shown) if bodies is None else [shown_body(recording, body) for body in bodies]


def frames_within(recording: RecordedData, start: float, end: float) -> tuple[IntArray, FloatArray]:
    """Return steps and times (s) of the frames in an interval (s); RecordingError if there is none."""
    frames = recording.fingerprints()
    times = frames["time"].to_numpy()
    inside = np.flatnonzero((times >= start - tolerance(start)) & (times <= end + tolerance(end)))
    if len(inside) == 0:
        raise RecordingError(f"{recording.path} has no frame from {recording.units.span(start, end, TIME, 'g')}")
    return frames[STEP].to_numpy()[inside], times[inside]


def frames_with(recording: RecordedData, body: int | str, start: float, end: float) -> tuple[int, IntArray, FloatArray]:
    """Return a body's number, and steps and times (s) of the frames with this body in an interval (s)."""
    number = body_number(recording, body)
    steps, times = frames_within(recording, start, end)
    if recording.lives is None:
        return number, steps, times
    first, last = recording.lives[number]
    inside = (steps >= first) & (steps <= last)
    if not inside.any():
        name, known = body_called(number, recording.bodies.name[number]), recording.fingerprints()["time"]
        span = recording.units.span(max(start, known[0].as_py()), min(end, known[-1].as_py()), TIME, "g")
        raise RecordingError(f"{recording.path}: {name} does not exist from {span}")
    return number, steps[inside], times[inside]


_OF_STATES = ("velocity", "orientation", "angular_velocity")  # quantities that are unknown without an exact state


def _recorded_paths(
    recording: RecordedData, numbers: Sequence[int], steps: IntArray, times: FloatArray
) -> BodyTrajectories:
    """Return drawn positions (float32) of bodies in frames, with the exact states (float64) at checkpoints."""
    shown, own_places = recording.shown, np.array(numbers, dtype=np.int64)
    places = np.searchsorted(np.array(shown), own_places)
    position = np.full((len(steps), len(numbers), 3), np.nan)
    with reading(recording.path):
        for chunk in recording.chunks(recording.store.frames_of(paths.BODIES, steps[0], steps[-1])):
            own, centres = chunk.batch[STEP].to_numpy(), centres_of(chunk)
            if centres is None:
                continue
            drawn = plain(centres).to_numpy().reshape(len(own), len(shown), 3)
            at = np.searchsorted(steps, own)
            known = steps[np.minimum(at, len(steps) - 1)] == own
            position[at[known]] = drawn[known][:, places] + recording.origin
    exact = np.isin(steps, recording.checkpoint_steps)
    rows, states = np.flatnonzero(exact), list[dict[str, FloatArray]]()
    for checkpoint in recording.checkpoints(steps[rows].tolist()):
        states.append(state_vectors(checkpoint, own_places, recording.bodies.mass, recording.bodies.inertia))
        if (waits := checkpoint.waits) is not None:
            states[-1] = {name: np.where(waits[own_places, None], np.nan, each) for name, each in states[-1].items()}
    vectors = {"position": position}
    for quantity in STATE_QUANTITIES:
        if all(quantity.name in state for state in states) and (states or quantity.name in _OF_STATES):
            values = vectors.setdefault(
                quantity.name, np.full((len(steps), len(numbers), len(quantity.columns)), np.nan)
            )
            for row, state in zip(rows, states, strict=True):
                values[row] = state[quantity.name]
    lost = np.isnan(position).any(axis=2) & (not recording.info.get("admits"))
    if recording.lives is not None:
        first, last = recording.lives[own_places].T
        lost &= (first >= 0) & (first <= steps[:, None]) & (steps[:, None] <= last)
    if lost.any():
        step = int(steps[np.flatnonzero(lost.any(axis=1))[0]])
        raise RecordingError(f"{recording.path} has no positions at step {step}: part of the file is missing")
    told = "recorded: float64 at checkpoints, float32 elsewhere"
    return BodyTrajectories(own_places, steps, times, exact, vectors, told)


def checkpoints_at(recording: RecordedData, start: dict[str, Values], steps: Iterable[int]) -> Iterator[Checkpoint]:
    """Yield the exact states at some steps; ``start`` is the state before the frames of a clip, otherwise empty."""
    from carom.recording.schema.checkpoint_columns import decode  # noqa: PLC0415 - loads Numba

    frames = recording.fingerprints()
    known, bits = frames[STEP].to_numpy(), frames["fingerprint"].to_numpy()
    chunk: Chunk | None = None  # one chunk serves consecutive steps
    for step in steps:
        if chunk is None or step not in chunk.batch[STEP].to_numpy():
            chunk = None  # a chunk is freed before the next one is read, since it may have 400 MB
            chunk, _ = recording.row(paths.CHECKPOINT, step) or (None, 0)
        if chunk is not None:
            place = int(np.flatnonzero(chunk.batch[STEP].to_numpy() == step)[-1])
            row = {name: values_of(chunk.batch[name][place]) for name in chunk.components}
            chunk = chunk if chunk.batch.num_rows > 1 else None
        elif start and int(start[STEP][0]) == step:
            row = {name: values.copy() for name, values in start.items()}
        else:
            raise RecordingError(f"{recording.path} has no checkpoint at step {step}")
        release_memory()
        found = decode(step, row, len(recording.bodies.mass))
        frame = int(np.searchsorted(known, step))
        if frame < len(known) and known[frame] == step and int(bits[frame]) != found.fingerprint:
            differs = f"the checkpoint at step {step} does not match the fingerprint of its frame"
            raise RecordingError(f"{recording.path}: {differs}; one of the two is damaged")
        yield found
