"""Tables of exact states: all bodies at one time, or one body over an interval; and the checkpoints."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa

from carom.arrays import FloatArray, IntArray
from carom.errors import RecordingError
from carom.recording.read.body_lookup import body_number, shown_body
from carom.recording.read.entities import Entities, Values, reading, values_of
from carom.recording.read.moment import frame_of, goal_of, tolerance
from carom.recording.rrd.messages import release_memory
from carom.recording.schema import paths
from carom.recording.schema.paths import STEP
from carom.scene.units.dimension import TIME
from carom.scene.wording import body_called

if TYPE_CHECKING:
    from carom.physics.checkpoint import Checkpoint
    from carom.recording.read.recording import Recording
    from carom.recording.rrd.messages import Chunk


AXES = {
    "position": ("x", "y", "z"),  # m
    "velocity": ("vx", "vy", "vz"),  # m/s
    "orientation": ("qx", "qy", "qz", "qw"),
    "angular_velocity": ("wx", "wy", "wz"),  # rad/s
}


def bodies_at(recording: Recording, at: float | None) -> pa.Table:
    """Return the state of all bodies at the end of the step that contains a time (s); see `BodyTable`."""
    at = recording.moment(at)
    row, source, checkpoint = frame_of(recording, at), "checkpoint", None
    if row is not None:
        step = int(recording.fingerprints()[STEP][row].as_py())
        checkpoint = recording.checkpoint(step) if step in recording.checkpoint_times else None
    if checkpoint is None:
        window = recording.rerun(goal_of(recording, at))
        checkpoint, source = window.state_at(at), window.source
    numbers = np.flatnonzero(recording.present(checkpoint.step))
    states = state_table([checkpoint], numbers)
    names = recording.bodies.name
    columns = {"body": pa.array(numbers), "name": pa.array([names[number] for number in numbers.tolist()])}
    columns |= {name: states[name] for name in states.column_names if name not in (STEP, "time")}
    told = {"step": str(checkpoint.step), "time": repr(checkpoint.time), "source": source}
    return pa.table(columns).replace_schema_metadata(told)


def state_table(states: Sequence[Checkpoint], which: slice | int | IntArray) -> pa.Table:
    """Tabulate the states of all or some bodies, step by step."""
    each = 1 if isinstance(which, int) else len(states[0].position[which])
    columns: dict[str, Any] = {
        STEP: np.repeat([state.step for state in states], each),
        "time": np.repeat([state.time for state in states], each),
    }
    for quantity, names in AXES.items():
        if getattr(states[0], quantity) is not None:
            values = np.concatenate([getattr(state, quantity)[which].reshape(-1, len(names)) for state in states])
            columns |= dict(zip(names, np.ascontiguousarray(values.T), strict=True))
    return pa.table(columns)


def trajectory(recording: Recording, body: int | str, start: float, end: float, *, replay: bool) -> pa.Table:
    """Return the path of one body; see `Recording.trajectory`."""
    number = body_number(recording, body)
    frames = recording.fingerprints()
    times = frames["time"].to_numpy()
    inside = np.flatnonzero((times >= start - tolerance(start)) & (times <= end + tolerance(end)))
    if len(inside) == 0:
        raise RecordingError(f"{recording.path} has no frame from {recording.units.span(start, end, TIME, 'g')}")
    steps = frames[STEP].to_numpy()[inside]
    if recording.lives is not None:
        first, last = recording.lives[number]
        inside = inside[(steps >= first) & (steps <= last)]
        if len(inside) == 0:
            name = body_called(number, recording.bodies.name[number])
            span = recording.units.span(max(start, float(times[0])), min(end, float(times[-1])), TIME, "g")
            raise RecordingError(f"{recording.path}: {name} does not exist from {span}")
        steps = frames[STEP].to_numpy()[inside]
    if not replay:
        return _recorded_path(recording, number, steps, times[inside])
    window = recording.rerun(float(times[inside[0]]))
    table = state_table(window.states(steps.tolist()), number)
    exact = pa.array(np.ones(table.num_rows, dtype=bool))
    return table.append_column("exact", exact).replace_schema_metadata({"source": window.source})


def _recorded_path(recording: Recording, number: int, steps: IntArray, times: FloatArray) -> pa.Table:
    """Return drawn positions (float32), with the exact states (float64) at checkpoints."""
    position = _drawn(recording, number, steps)
    exact = np.isin(steps, recording.checkpoint_steps)
    states: dict[int, Checkpoint] = {}
    rows = np.flatnonzero(exact)
    for row, state in zip(rows.tolist(), recording.checkpoints(steps[rows].tolist()), strict=True):
        states[row], position[row] = state, state.position[number]
    lost = np.flatnonzero(np.isnan(position).any(axis=1))
    if len(lost):
        step = int(steps[lost[0]])
        raise RecordingError(f"{recording.path} has no positions at step {step}: part of the file is missing")
    columns: dict[str, Any] = {STEP: steps, "time": times}
    columns |= dict(zip(AXES["position"], np.ascontiguousarray(position.T), strict=True))
    for quantity in ("velocity", "orientation", "angular_velocity"):
        if all(getattr(state, quantity) is not None for state in states.values()):
            columns |= _at_checkpoints(quantity, states, number, len(steps))
    told = {"source": "recorded: float64 at checkpoints, float32 elsewhere"}
    return pa.table(columns | {"exact": exact}).replace_schema_metadata(told)


def _drawn(recording: Recording, number: int, steps: IntArray) -> FloatArray:
    """Return the drawn positions of a body, (k, 3) m; NaN where there are none."""
    shown = recording.shown
    place, position = shown.index(shown_body(recording, number)), np.full((len(steps), 3), np.nan)
    entries = recording.store.frames_of(paths.BODIES, steps[0], steps[-1])
    with reading(recording.path):
        for chunk in recording.chunks(entries):
            own = chunk.batch[STEP].to_numpy()
            name = next((name for name in paths.CENTRES if name in chunk.components), None)
            if name is None:
                continue
            values = chunk.batch[name].flatten()
            while pa.types.is_nested(values.type):
                values = values.flatten()
            centres = values.to_numpy().reshape(len(own), len(shown), 3)
            at = np.searchsorted(steps, own)
            known = steps[np.minimum(at, len(steps) - 1)] == own
            position[at[known]] = centres[known, place] + recording.origin
    return position


def _at_checkpoints(quantity: str, states: dict[int, Checkpoint], number: int, rows: int) -> dict[str, pa.Array]:
    """Return columns with values at checkpoints and nulls elsewhere."""
    missing = np.ones(rows, dtype=bool)
    values = np.zeros((rows, len(AXES[quantity])))
    for row, state in states.items():
        values[row], missing[row] = getattr(state, quantity)[number], False
    return {name: pa.array(column, mask=missing) for name, column in zip(AXES[quantity], values.T, strict=True)}


def checkpoints_at(
    recording: Recording, entities: Entities, start: dict[str, Values], steps: Iterable[int]
) -> Iterator[Checkpoint]:
    """Yield the exact states at some steps; see `Recording.checkpoints`.

    Parameters
    ----------
    start
        The state at the beginning of a clip; empty for a whole run.
    """
    from carom.recording.schema.checkpoint_columns import decode  # noqa: PLC0415 - loads Numba

    frames = recording.fingerprints()
    known, bits = frames[STEP].to_numpy(), frames["fingerprint"].to_numpy()
    for step, row in _rows(recording, entities, start, steps):
        release_memory()
        found = decode(step, row, len(recording.bodies.mass))
        frame = int(np.searchsorted(known, step))
        if frame < len(known) and known[frame] == step and int(bits[frame]) != found.fingerprint:
            raise RecordingError(
                f"{recording.path}: the checkpoint at step {step} does not match the fingerprint of its frame; one of "
                "the two is damaged"
            )
        yield found


def _rows(
    recording: Recording, entities: Entities, start: dict[str, Values], steps: Iterable[int]
) -> Iterator[tuple[int, dict[str, Values]]]:
    """Yield the stored components of the states at some steps; a chunk is read once for consecutive steps."""
    chunk: Chunk | None = None
    for step in steps:
        if chunk is None or step not in chunk.batch[STEP].to_numpy():
            chunk = None
            for each in entities.chunks_at(step, paths.CHECKPOINT):
                if step in each.batch[STEP].to_numpy():
                    chunk = each
                    break
        if chunk is not None:
            place = int(np.flatnonzero(chunk.batch[STEP].to_numpy() == step)[-1])
            row = {name: values_of(chunk.batch[name][place]) for name in chunk.components}
            chunk = chunk if chunk.batch.num_rows > 1 else None  # it may have 400 MB
        elif start and int(start[STEP][0]) == step:
            row = {name: values.copy() for name, values in start.items()}
        else:
            raise RecordingError(f"{recording.path} has no checkpoint at step {step}")
        yield step, row
