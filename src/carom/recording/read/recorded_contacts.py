"""Tables of contacts and impacts, and the contacts of one step as they were recorded."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from operator import itemgetter
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from carom.arrays import BoolArray, FloatArray, IntArray, Records
from carom.contact_table import CONTACT_ROW, IMPACT_MODE, MODES
from carom.errors import DamageError, NotRecordedError, RecordingError
from carom.recording.read.entities import plain, reading
from carom.recording.read.lookup import frame_of, names_of
from carom.recording.read.state_columns import with_units
from carom.recording.rrd.messages import Chunk
from carom.recording.schema import paths
from carom.recording.timelines import STEP
from carom.scene.units.dimension import TIME
from carom.state.checkpoint import Checkpoint

if TYPE_CHECKING:
    from carom.recording.read.recorded_data import RecordedData


_COLUMNS = (  # columns: name, type and unit
    ("step", pa.int64(), ""),
    ("time", pa.float64(), "s"),  # time of the impact, or end of the step
    ("i", pa.int64(), ""),  # i < j
    ("j", pa.int64(), ""),  # the second body; numbers of n and above are planes and walls
    *((name, pa.float64(), "m") for name in ("x", "y", "z")),  # the contact point
    *((name, pa.float64(), "") for name in ("nx", "ny", "nz")),  # the normal from i to j
    ("approach_speed", pa.float64(), "m/s"),
    ("normal_impulse", pa.float64(), "N s"),
    ("tangential_impulse", pa.float64(), "N s"),
    ("mode", pa.string(), ""),
    ("energy_lost", pa.float64(), "J"),
    ("normal_force", pa.float64(), "N"),  # impulse divided by the length of the step; null for an impact
    ("tangential_force", pa.float64(), "N"),  # null for impacts
    ("angular_impulse_i", pa.float64(), "N m s"),  # |r × J| about the centre of i; null without spins
    # |r × J| about the centre of j; null without spins, and for planes and walls
    ("angular_impulse_j", pa.float64(), "N m s"),
)
SCHEMA = pa.schema([(name, kind) for name, kind, _ in _COLUMNS])
UNITS = {name: unit for name, _, unit in _COLUMNS if unit}
# columns that are recorded in float32
MEASURED = ("approach_speed", "normal_impulse", "tangential_impulse", "energy_lost")
SOURCE = "source"  # key of a table's metadata: the source of its rows, in words


def table_of(columns: Mapping[str, Any], source: str) -> pa.Table:
    """Make a table of columns; missing columns are null."""
    rows = len(columns["step"])
    arrays = [
        pa.array(columns[field.name], field.type) if field.name in columns else pa.nulls(rows, field.type)
        for field in SCHEMA
    ]
    return pa.table(arrays, schema=SCHEMA).replace_schema_metadata({SOURCE: source})


def table_of_rows(rows: Records, source: str, dt: float = 0.0) -> pa.Table:
    """Make a table of rows, (k,) `CONTACT_ROW`; given the length ``dt`` of their step (s), the table has forces."""
    plain = ("step", "time", "i", "j", "x", "y", "z", "nx", "ny", "nz", "approach_speed", "normal_impulse")
    columns: dict[str, Any] = {name: np.ascontiguousarray(rows[name]) for name in plain}
    friction = np.stack([rows["friction_x"], rows["friction_y"], rows["friction_z"]])
    columns["tangential_impulse"] = np.sqrt(np.sum(friction * friction, axis=0))
    columns["energy_lost"] = rows["restitution_loss"] + rows["friction_loss"]
    columns |= forces(columns, rows["mode"], dt)
    return table_of(columns | {"mode": modes(rows["mode"], "a replay")}, source)


def forces(columns: Mapping[str, Any], mode: NDArray[np.uint8], dt: float) -> dict[str, pa.Array]:
    """Return the forces (N) of contacts: their impulses over a step of dt s. An impact has an impulse, but no force."""
    unknown = mode == IMPACT_MODE if dt > 0.0 else np.ones(len(mode), dtype=bool)
    return {
        f"{kind}_force": pa.array(columns[f"{kind}_impulse"] / (dt or 1.0), mask=unknown)
        for kind in ("normal", "tangential")
    }


def modes(numbers: NDArray[np.uint8], path: str) -> pa.Array:
    """Return the modes of contacts as texts."""
    if len(numbers) and int(numbers.max()) >= len(MODES):
        raise DamageError(f"/{path} has a contact with an unknown mode")
    return pa.array(MODES).take(pa.array(numbers))


def named_contacts(recording: RecordedData, table: pa.Table) -> pa.Table:
    """Add the names of both bodies or planes, and the unit of each field."""
    names, named = names_of(recording), with_units(table, UNITS)
    for place, number in ((4, "i"), (5, "j")):  # columns after step, time, i and j
        texts = [names.of(each) for each in table[number].to_pylist()]
        named = named.add_column(place, f"name_{number}", pa.array(texts, pa.string()))
    return named


def of_body(table: pa.Table, body: int | None) -> pa.Table:
    """Keep the rows of one body, or all rows for None."""
    if body is None:
        return table
    own = (table["i"].to_numpy() == body) | (table["j"].to_numpy() == body)
    return table.filter(pa.array(own))


def with_angular_impulses(table: pa.Table, recording: RecordedData) -> pa.Table:
    """Fill in the angular impulses on spheres that can spin: radius times tangential impulse."""
    if recording.engine or not recording.info["spins"]:
        return table
    radius = recording.bodies.radius
    for end in "ij":
        body = table[end].to_numpy()
        meets = body < len(radius)
        values = radius[np.where(meets, body, 0)] * table["tangential_impulse"].to_numpy()
        place = table.schema.get_field_index(f"angular_impulse_{end}")
        table = table.set_column(place, table.schema.field(place), pa.array(values, mask=~meets))
    return table


def of_shown(table: pa.Table, recording: RecordedData) -> pa.Table:
    """Keep the rows of bodies that a recording shows, in contact with each other or with planes."""
    if recording.shows_all:
        return table
    pairs = np.stack([table["i"].to_numpy(), table["j"].to_numpy()], axis=1)
    return table.filter(pa.array(join_some(pairs, recording.shown, int(recording.info["bodies"]))))


def join_some(pairs: IntArray, chosen: Sequence[int] | IntArray, bodies: int) -> BoolArray:
    """Return a mask of the pairs (k, 2) that consist of two selected bodies, or of a selected body and a plane."""
    among = np.isin(pairs, chosen)
    return np.asarray(among[:, 0] & (among[:, 1] | (pairs[:, 1] >= bodies)))


def check_pairs(pairs: IntArray, bodies: int, path: str) -> None:
    """Raise DamageError if one of the pairs (k, 2) is impossible."""
    if np.any((pairs[:, 0] >= pairs[:, 1]) | (pairs[:, 0] >= bodies)):
        raise DamageError(f"/{path} has contacts of bodies that do not exist")


_SAME = 1e-5  # relative error of a sum of float32 impulses, or of the length of a float32 line
_TIME_AND_PLACE = ("time", "x", "y", "z", "nx", "ny", "nz")  # columns that state time and place of an impact


def contacts(recording: RecordedData, at: float | None) -> pa.Table:
    """Return the contacts of the step that contains a time (s); see `Recording.contacts`."""
    at = recording.moment(at)
    row = frame_of(recording, at)
    if row is None or not recording.records_contacts:
        when = recording.units.text(at, TIME, ".9g")
        raise NotRecordedError(recording.path, f"the contacts of the step that contains {when}", recording.engine)
    with reading(recording.path):
        return with_angular_impulses(_table(recording, *_row_of_contacts(recording, row)), recording)


def rows_of_engine(recording: RecordedData, row: int) -> tuple[Records, float]:
    """Return the contacts (k,) `CONTACT_ROW` of another engine in a frame, and the time (s) since the last frame."""
    with reading(recording.path):
        chunk, own, step, time = _row_of_contacts(recording, row)
        return _rows_of_engine(recording, chunk, own, step, time), _dt(recording, step)


def rows_by_frame(recording: RecordedData, first: int, last: int) -> Iterator[tuple[int, float, Records]]:
    """Yield step, time (s) and contacts (k,) `CONTACT_ROW` of another engine, from the first step to the last."""
    frames = recording.fingerprints()
    times = dict(zip(frames[STEP].to_pylist(), frames["time"].to_pylist(), strict=True))
    with reading(recording.path):
        for chunk in recording.chunks(recording.store.frames_of(paths.CONTACTS, first, last)):
            for row, step in enumerate(chunk.batch[STEP].to_pylist()):
                if first <= step <= last and step in times:
                    yield step, times[step], _rows_of_engine(recording, chunk, row, step, times[step])


def closing_speeds(rows: Records, state: Checkpoint, moves: BoolArray | None = None) -> FloatArray:
    """Return the closing speeds (m/s) of contacts, (k,) `CONTACT_ROW`; bodies outside of the mask (n,) are at rest."""
    n, relative = len(state.position), np.zeros((len(rows), 3))
    point, normal = (
        np.stack([rows[name] for name in names], axis=1) for names in (("x", "y", "z"), ("nx", "ny", "nz"))
    )
    for end, sign in (("i", -1.0), ("j", 1.0)):
        body = np.minimum(rows[end], n - 1)
        velocity = state.velocity[body]
        if state.angular_velocity is not None:
            velocity = velocity + np.cross(state.angular_velocity[body], point - state.position[body])
        counts = rows[end] < n if moves is None else (rows[end] < n) & moves[body]
        relative += np.where(counts[:, None], sign * velocity, 0.0)
    return np.asarray(np.nan_to_num(-np.einsum("ij,ij->i", relative, normal)))


def _row_of_contacts(recording: RecordedData, row: int) -> tuple[Chunk, int, int, float]:
    """Return the chunk with the contacts of a frame, the row in it, and the step and time (s) of the frame."""
    frames = recording.fingerprints()
    step, time = int(frames[STEP][row].as_py()), float(frames["time"][row].as_py())
    found = recording.row(paths.CONTACTS, step)
    if found is None:
        raise RecordingError(f"{recording.path} has no contacts at step {step}: part of the file is missing")
    return *found, step, time


def _table(recording: RecordedData, chunk: Chunk, row: int, step: int, time: float) -> pa.Table:
    """Read a row of contacts, whose points and normals follow from the lines in the row."""
    if recording.engine:
        rows, unknown = _rows_of_engine(recording, chunk, row, step, time), ("approach_speed", "energy_lost")
        table = table_of_rows(rows, "recorded", _dt(recording, step))
        for name in unknown:
            place = table.schema.get_field_index(name)
            table = table.set_column(place, table.schema.field(place), pa.nulls(len(rows), pa.float64()))
        return table
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
    columns |= forces(columns, mode, _dt(recording, step))
    return table_of(columns, "recorded")


def _dt(recording: RecordedData, step: int) -> float:
    """Return the length of a step in s; 0 if it is not recorded."""
    steps = recording.steps("dt")
    dt = steps["dt"].to_numpy()[steps[STEP].to_numpy() == step]
    return float(dt[0]) if len(dt) else 0.0


def _rows_of_engine(recording: RecordedData, chunk: Chunk, row: int, step: int, time: float) -> Records:
    """Read a row of another engine's contacts, whose points are not on the lines between the centres."""
    pairs = _values(chunk, "bodies", row, pa.uint32()).astype(np.int64).reshape(-1, 2)
    check_pairs(pairs, len(recording.bodies.radius), paths.CONTACTS)
    rows = np.zeros(len(pairs), CONTACT_ROW)
    rows["step"], rows["time"] = step, time
    rows["i"], rows["j"] = pairs.T
    columns = {"mode": _values(chunk, "mode", row, pa.uint8())}
    columns["normal_impulse"] = _values(chunk, "normal_impulse", row, pa.float32())
    for name, prefix in (("point", ""), ("normal", "n"), ("friction", "friction_")):
        vectors = _values(chunk, name, row, pa.float32()).astype(np.float64).reshape(-1, 3)
        vectors = vectors + recording.origin if name == "point" else vectors
        columns |= dict(zip((f"{prefix}{axis}" for axis in "xyz"), vectors.T, strict=True))
    if any(len(values) != len(rows) for values in columns.values()):
        raise DamageError(f"/{paths.CONTACTS} has columns of different lengths at step {step}")
    for name, values in columns.items():
        rows[name] = values
    return rows


def _of_impacts(
    recording: RecordedData, columns: dict[str, Any], struck: BoolArray, apart: BoolArray
) -> dict[str, Any]:
    """Add the approach speeds and energy losses of the step's impacts to contacts that have no other impulses.

    If the bodies have separated by the end of the step, the hardest impact gives time, point and normal.
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
    """Copy one row of a component as a flat array. Raises DamageError for a missing row or another type."""
    if name not in chunk.components:
        raise DamageError(f"/{chunk.entity_path} has no {name}")
    values = chunk.batch[name][row].values
    if values is None:
        raise DamageError(f"/{chunk.entity_path} has a row without its {name}")
    values = plain(values)
    if values.type != kind or values.null_count:
        raise DamageError(f"{name} of /{chunk.entity_path} of type {values.type}")
    return np.array(values.to_numpy())
