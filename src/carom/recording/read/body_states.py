"""The exact state of the bodies at a time, as a table: from a checkpoint, or by a replay of the steps up to it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from carom.errors import RecordingError
from carom.recording.read.moment import frame_of, tolerance
from carom.recording.schema.timelines import STEP
from carom.scene.units.dimension import TIME

if TYPE_CHECKING:
    from carom.physics.checkpoint import Checkpoint
    from carom.recording.read.recording import Recording

AXES = {
    "position": ("x", "y", "z"),  # m
    "velocity": ("vx", "vy", "vz"),  # m/s
    "orientation": ("qx", "qy", "qz", "qw"),
    "angular_velocity": ("wx", "wy", "wz"),  # rad/s
}


def bodies_at(recording: Recording, at: float | None) -> pa.Table:
    """Return the state of all bodies at the end of the step that contains a time (s); see `BodyTable`."""
    at = recording.moment(at)
    checkpoint, source = _checkpoint_of(recording, at), "checkpoint"
    if checkpoint is None:
        checkpoint, source = _replayed(recording, at)
    n = len(checkpoint.position)
    states = state_table([checkpoint], slice(None))
    columns = {"body": pa.array(np.arange(n)), "name": pa.array(recording.bodies.name)}
    columns |= {name: states[name] for name in states.column_names if name not in (STEP, "time")}
    told = {"step": str(checkpoint.step), "time": repr(checkpoint.time), "source": source}
    return pa.table(columns).replace_schema_metadata(told)


def state_table(states: Sequence[Checkpoint], which: slice | int | NDArray[np.int64]) -> pa.Table:
    """Tabulate states, step by step: those of all bodies, of some, or of one."""
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


def _checkpoint_of(recording: Recording, at: float) -> Checkpoint | None:
    row = frame_of(recording, at)
    if row is None:
        return None
    step = int(recording.fingerprints()[STEP][row].as_py())
    return recording.checkpoint(step) if step in recording.checkpoint_times else None


def _replayed(recording: Recording, at: float) -> tuple[Checkpoint, str]:
    from carom.recording.read.window import Window  # noqa: PLC0415 - loads Numba

    goal = min(at - tolerance(at), float(recording.fingerprints()["time"][-1].as_py()))
    window = Window(recording, goal)
    for frame in window.frames(goal):
        if frame.time >= goal:
            return frame.checkpoint, window.source
    when = recording.units.text(at, TIME, ".9g")
    raise RecordingError(f"{recording.path} ends before {when} when it is run again; its bits are not the same")
