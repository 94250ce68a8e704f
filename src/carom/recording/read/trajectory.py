"""The path of one body through a recording, as a table."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from carom.errors import RecordingError
from carom.recording.read.body_names import body_number, shown_body
from carom.recording.read.body_states import AXES, state_table
from carom.recording.read.damage import reading
from carom.recording.read.moment import tolerance
from carom.recording.schema import paths
from carom.recording.schema.timelines import STEP
from carom.scene.units.dimension import TIME

if TYPE_CHECKING:
    from carom.physics.checkpoint import Checkpoint
    from carom.recording.read.recording import Recording

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


def trajectory(recording: Recording, body: int | str, start: float, end: float, *, replay: bool) -> pa.Table:
    """Return the path of one body; see `Recording.trajectory`."""
    number = body_number(recording, body)
    frames = recording.fingerprints()
    times = frames["time"].to_numpy()
    inside = np.flatnonzero((times >= start - tolerance(start)) & (times <= end + tolerance(end)))
    if len(inside) == 0:
        raise RecordingError(f"{recording.path} has no frame from {recording.units.span(start, end, TIME, 'g')}")
    steps = frames[STEP].to_numpy()[inside]
    return (_replayed if replay else _recorded)(recording, number, steps, times[inside])


def _replayed(recording: Recording, number: int, steps: IntArray, times: FloatArray) -> pa.Table:
    from carom.recording.read.window import Window  # noqa: PLC0415 - loads Numba

    window = Window(recording, float(times[0]))
    wanted, found = set(steps.tolist()), list[Any]()
    for frame in window.frames(np.inf):
        if frame.step in wanted:
            found.append(frame.checkpoint)
        if frame.step >= steps[-1]:
            break
    if len(found) < len(steps):
        raise RecordingError(f"{recording.path} ends earlier when it is run again; its bits are not the same")
    table = state_table(found, number)
    exact = pa.array(np.ones(table.num_rows, dtype=bool))
    return table.append_column("exact", exact).replace_schema_metadata({"source": window.source})


def _recorded(recording: Recording, number: int, steps: IntArray, times: FloatArray) -> pa.Table:
    """Take positions from the drawn ones, float32, and whole states from checkpoints, float64."""
    position = _drawn(recording, number, steps)
    exact = np.isin(steps, recording.checkpoint_steps)
    states: dict[int, Checkpoint] = {}
    for row in np.flatnonzero(exact).tolist():
        states[row] = recording.checkpoint(int(steps[row]))
        position[row] = states[row].position[number]
    lost = np.flatnonzero(np.isnan(position).any(axis=1))
    if len(lost):
        step = int(steps[lost[0]])
        raise RecordingError(f"{recording.path} has no positions at step {step}: a piece of it is missing")
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
    entries = [
        entry
        for entry in recording.store.entries
        if entry.entity_path == paths.BODIES
        and entry.first_step is not None
        and entry.first_step <= steps[-1]
        and (entry.last_step or 0) >= steps[0]
    ]
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
    """Make columns that have values at checkpoints, and nulls elsewhere."""
    missing = np.ones(rows, dtype=bool)
    values = np.zeros((rows, len(AXES[quantity])))
    for row, state in states.items():
        values[row], missing[row] = getattr(state, quantity)[number], False
    return {name: pa.array(column, mask=missing) for name, column in zip(AXES[quantity], values.T, strict=True)}
