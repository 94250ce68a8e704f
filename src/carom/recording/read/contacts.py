"""The contacts of one step of a recording: as they were recorded, or else by running the step again."""

from __future__ import annotations

from operator import itemgetter
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from carom.errors import DamageError, RecordingError
from carom.physics.contact.contact_table import IMPACT_MODE
from carom.recording.read.contact_tables import check_pairs, finite, modes, of_shown, table_of, table_of_rows
from carom.recording.read.damage import reading
from carom.recording.read.moment import frame_of, tolerance
from carom.recording.rrd.messages import Chunk
from carom.recording.schema import paths
from carom.recording.schema.timelines import STEP
from carom.scene.units.dimension import TIME

if TYPE_CHECKING:
    from carom.recording.read.recording import Recording
    from carom.recording.read.window import Watcher

FloatArray = NDArray[np.float64]

_SAME = 1e-5  # relative, of sums of float32 impulses, and of the length of a float32 line
_TIME_AND_PLACE = ("time", "x", "y", "z", "nx", "ny", "nz")  # of an impact


def contacts(recording: Recording, at: float | None, *, replay: bool, watch: Watcher | None = None) -> pa.Table:
    """Return the contacts of the step that a time (s) is in; see `Recording.contacts`."""
    at = recording.moment(at)
    row = frame_of(recording, at)
    if recording.records_contacts and row is not None and not replay:
        with reading(recording.path):
            table = _recorded(recording, row)
        return finite(table, lambda: _replayed(recording, at, watch))
    return _replayed(recording, at, watch)


def _replayed(recording: Recording, at: float, watch: Watcher | None) -> pa.Table:
    from carom.recording.read.window import Window  # noqa: PLC0415 - loads Numba

    goal = min(at - tolerance(at), float(recording.fingerprints()["time"][-1].as_py()))
    window = Window(recording, goal, contacts=True, watch=watch)
    for frame in window.frames(goal):
        if frame.time >= goal and frame.contact_rows is not None:
            return of_shown(table_of_rows(frame.contact_rows, window.source), recording)
    when = recording.units.text(at, TIME, ".9g")
    raise RecordingError(f"{recording.path} ends before {when} when it is run again; its bits are not the same")


def _recorded(recording: Recording, row: int) -> pa.Table:
    frames = recording.fingerprints()
    step, time = int(frames[STEP][row].as_py()), float(frames["time"][row].as_py())
    held = [e for e in recording.store.entries if e.entity_path == paths.CONTACTS and e.holds(step)]
    for chunk in recording.chunks(held):
        own = np.flatnonzero(chunk.batch[STEP].to_numpy() == step)
        if len(own):
            return _table(recording, chunk, int(own[-1]), step, time)
    raise RecordingError(f"{recording.path} has no contacts at step {step}: a piece of it is missing")


def _table(recording: Recording, chunk: Chunk, row: int, step: int, time: float) -> pa.Table:
    """Read a row; contact points and normals are those of its lines."""
    radius = recording.bodies.radius
    pairs = _values(chunk, "bodies", row, pa.uint32()).astype(np.int64).reshape(-1, 2)
    check_pairs(pairs, len(radius), paths.CONTACTS)
    count = len(pairs)
    lines = _values(chunk, "LineStrips3D:strips", row, pa.float32()).astype(np.float64).reshape(-1, 2, 3)
    impulses = {name: _values(chunk, name, row, pa.float32()) for name in ("normal_impulse", "tangential_impulse")}
    mode = _values(chunk, "mode", row, pa.uint8())
    if {len(lines), len(mode), *map(len, impulses.values())} != {count}:
        raise DamageError(f"/{paths.CONTACTS} has columns of different lengths at step {step}")
    reach = lines[:, 1] - lines[:, 0]
    length = np.linalg.norm(reach, axis=1)
    normal = np.divide(reach, length[:, None], out=np.zeros_like(reach), where=length[:, None] > 0.0)
    meets = pairs[:, 1] < len(radius)
    radii = radius[pairs[:, 0]], radius[np.where(meets, pairs[:, 1], 0)]
    arm = np.where(meets, length * radii[0] / (radii[0] + radii[1]), radii[0])
    point = lines[:, 0] + recording.origin + arm[:, None] * normal
    columns: dict[str, Any] = {
        STEP: np.full(count, step),
        "time": np.full(count, time),
        **dict(zip(("i", "j"), pairs.T.copy(), strict=True)),
        **dict(zip(("x", "y", "z"), point.T.copy(), strict=True)),
        **dict(zip(("nx", "ny", "nz"), normal.T.copy(), strict=True)),
        **{name: values.astype(np.float64) for name, values in impulses.items()},
        "mode": modes(mode, paths.CONTACTS),
    }
    apart = length > (radii[0] + np.where(meets, radii[1], 0.0)) * (1.0 + _SAME)
    columns |= _of_impacts(recording, columns, mode == IMPACT_MODE, apart)
    return table_of(columns, "recorded")


def _of_impacts(
    recording: Recording, columns: dict[str, Any], struck: NDArray[np.bool_], apart: NDArray[np.bool_]
) -> dict[str, Any]:
    """Take approach speeds and energies from the step's impacts, where these are all that the contact did.

    Bodies that are apart again at the end of the step were somewhere else when they met: time, point and normal are
    then those of the hardest impact.
    """
    count, impulse = len(struck), columns["normal_impulse"]
    speed, lost, given, known = np.zeros(count), np.zeros(count), np.zeros(count), np.zeros(count, dtype=bool)
    hardest = [dict[str, Any]() for _ in range(count)]
    if struck.any():
        time = float(columns["time"][0])
        dt = recording.steps("dt")
        began = time - float(dt["dt"].to_numpy()[np.argmin(np.abs(dt["time"].to_numpy() - time))])
        place = {pair: row for row, pair in enumerate(zip(columns["i"].tolist(), columns["j"].tolist(), strict=True))}
        for impact in recording.impacts(began, time).to_pylist():
            row = place.get((impact["i"], impact["j"]))
            if row is not None and struck[row] and impact[STEP] == columns[STEP][0]:
                speed[row] = max(speed[row], impact["approach_speed"])
                lost[row] += impact["energy_lost"]
                given[row] += impact["normal_impulse"]
                hardest[row] = max(hardest[row] or impact, impact, key=itemgetter("normal_impulse"))
        known = struck & (np.abs(given - impulse) <= _SAME * impulse)
    met: dict[str, Any] = {name: columns[name].copy() for name in _TIME_AND_PLACE}
    for k in np.flatnonzero(known & apart).tolist():
        for name in _TIME_AND_PLACE:
            met[name][k] = hardest[k][name]
    return met | {name: pa.array(v, mask=~known) for name, v in (("approach_speed", speed), ("energy_lost", lost))}


def _values(chunk: Chunk, name: str, row: int, kind: pa.DataType) -> NDArray[Any]:
    """Copy one row of a component, flat. DamageError if it is not there or of another type."""
    if name not in chunk.components:
        raise DamageError(f"/{chunk.entity_path} has no {name}")
    values = chunk.batch[name][row].values
    if values is None:
        raise DamageError(f"/{chunk.entity_path} has a row without its {name}")
    while pa.types.is_nested(values.type):
        values = values.flatten()
    if values.type != kind or values.null_count:
        raise DamageError(f"{name} of /{chunk.entity_path} of type {values.type}")
    return np.array(values.to_numpy())
