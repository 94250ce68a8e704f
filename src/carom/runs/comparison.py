"""Compares recorded values with replayed ones: single values, and the static data of a recording."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from carom.errors import DamageError
from carom.physics.space import Space
from carom.plan.auto import auto_interval
from carom.recording.edit.clip import Selection
from carom.recording.read.entities import reading
from carom.recording.read.recording import Recording
from carom.recording.rrd.messages import Chunk
from carom.recording.schema import paths
from carom.recording.schema.header import TimeScale
from carom.recording.schema.paths import IMPACT, SIM_TIME, STEP
from carom.recording.schema.series import SERIES
from carom.recording.write.rows import Rows, any_values
from carom.recording.write.static_entities import identity, recording_name, statics
from carom.runs.run import header_of

Value = float | str

_COMPONENTS = {  # of checkpoints and of impacts, by their units
    "m": "position integrator_position_rest orbit_near orbit_position",
    "m/s": "velocity approach_speed contact_rest_speed contact_load_speed integrator_velocity_rest orbit_velocity",
    "m/s²": "acceleration integrator_accepted integrator_correction sleep_reference",
    "rad/s": "angular_velocity",
    "s": "time previous_dt contact_dt held_kick integrator_last_dt",
    "J": "energy_lost",
    "N s": "normal_impulse tangential_impulse held_impulse",
    "N m s": "held_angular",
}
_UNITS = {name: unit for unit, names in _COMPONENTS.items() for name in names.split()}
_ENERGIES = ("energy_", "ledger_")  # prefixes of names of energies in a checkpoint


@dataclass(frozen=True, slots=True)
class Mismatch:
    """A recorded value that differs in the replayed frame."""

    step: int
    quantity: str
    recorded: Value
    replayed: Value
    body: int | None = None
    unit: str = ""  # SI unit of both values; empty: unknown


def same(recorded: pa.Array, replayed: pa.Array) -> bool:
    """Return whether two columns have the same bits in rows of the same lengths."""
    if pa.types.is_list(recorded.type):
        lengths = [pc.list_value_length(column) for column in (recorded, replayed)]
        if not lengths[0].equals(lengths[1]):
            return False
    one, other = _flat(recorded), _flat(replayed)
    return one.dtype == other.dtype and one.tobytes() == other.tobytes()


def different(step: int, path: str, name: str, recorded: pa.Array, replayed: pa.Array) -> Mismatch | None:
    """Compare the values of a row; return the first that differs."""
    one, other = _flat(recorded), _flat(replayed)
    quantity = f"/{path}" if name == "Scalars:scalars" else f"{name} of /{path}"
    if len(one) != len(other):
        return Mismatch(step, f"how many values {quantity} has", len(one), len(other))
    if one.dtype.kind != other.dtype.kind or (one.dtype.kind != "S" and one.dtype != other.dtype):
        return Mismatch(step, f"type of {quantity}", str(one.dtype), str(other.dtype))
    if one.tobytes() == other.tobytes():
        return None
    if one.dtype.kind == "S":
        return Mismatch(step, quantity, bytes(one[0]).decode(), bytes(other[0]).decode())
    k = int(np.flatnonzero(one.view(np.uint8) != other.view(np.uint8))[0]) // one.itemsize
    body, unit = (k // 3, "m") if name in paths.CENTRES else (None, _UNITS.get(name, ""))
    if path == paths.CHECKPOINT and name.startswith(_ENERGIES):
        unit = "J"
    unit = unit or next((series.unit for series in SERIES if series.path == path), "")
    return Mismatch(step, quantity, one[k].item(), other[k].item(), body, unit)


def _flat(row: pa.Array) -> NDArray[np.generic]:
    """Return the numbers of a row, or its text as one value of bytes."""
    values = row
    while pa.types.is_nested(values.type):
        values = values.flatten()
    if pa.types.is_string(values.type):
        return np.array(["\0".join(values.to_pylist()).encode()])
    return np.ascontiguousarray(values.to_numpy(zero_copy_only=False))


StaticRows = dict[str, dict[str, pa.Array]]  # the one row of each component, by entity

_START_TIME = "RecordingInfo:start_time"  # wall-clock time
_STATES = (paths.STATIC_STATE, paths.GIVEN_STATE, paths.SCENE_TOML)  # the initial data of a run
_SHAPES = frozenset(  # positions and sizes of drawn bodies, planes and walls; the remaining components are style
    {
        "Ellipsoids3D:half_sizes",
        "Points3D:radii",
        "Mesh3D:vertex_positions",
        "LineStrips3D:strips",
        "Boxes3D:centers",
        "Boxes3D:half_sizes",
    }
)
_DRAWING = ("schema_version", "title", "colour_by", "body_colouring", "arrow_length.")  # keys that change no number
_OTHERS = ("__properties/", paths.MAGNIFIED, paths.START)  # the circumstances of the run, the layout, a clip's start


class StaticCheck:
    """Compares the properties and the static data of a recording with those that the replayed space would write.

    Different styles and missing data are listed in ``skipped``, since another version may have written them. Different
    numbers are a difference.
    """

    def __init__(self, recording: Recording, space: Space) -> None:
        self.skipped: dict[str, None] = {}  # descriptions of data that could not be compared
        self._recording = recording
        scene = space.scene
        header = header_of(space)
        # groups in the order of placement: explicit bodies, data, groups
        given = [(-1, len(scene.body)), *((-2 - k, len(columns.mass)) for k, columns in enumerate(scene.data))]
        numbers, counts = zip(*given, *((k, group.count) for k, group in enumerate(scene.group)), strict=True)
        # /scene states the circumstances of the run, such as its command, which differ from those of the replay
        circumstances = {name: recording.properties.get(name, value) for name, value in header.properties.items()}
        self._header = replace(
            header,
            record_impacts=scene.record.impacts,
            group=np.repeat(np.array(numbers, np.int64), counts),
            properties=circumstances,
        )
        usual = auto_interval(scene, scene.time.duration)
        if recording.check_interval not in (None, usual) and "resumed.step" not in recording.properties:
            # the program that ran the scene chose this interval, and the replay uses the same one
            self._skip(IDENTITY, "check_interval", "is not the scene's")
        self._first = int(recording.fingerprints()["step"][0].as_py())

    def difference(self) -> Mismatch | None:
        """Return the first number that differs."""
        recorded, found = self._recorded(), list[Mismatch]()
        reach = None  # m, largest distance of a body from the origin at the start of the recording; None if unknown
        if not self._recording.clip and self._first in self._recording.checkpoint_steps:
            position = self._recording.checkpoint(self._first).position - self._recording.origin
            reach = float(np.max(np.abs(position).max(axis=1) + self._header.radius))
        expected = self._expected(reach or 1.0)
        for path, components in expected.items():
            others = dict(recorded.get(path, {}))
            for name, value in components.items():
                if reach is None and name in _SHAPES and path.startswith((paths.PLANES, paths.SHAPES, paths.MOVING)):
                    others.pop(name, None)
                    self._skip(path, name, "depends on the initial positions of all bodies of the run")
                elif name not in others:
                    self._skip(path, name, "is missing")
                elif mismatch := different(self._first, path, name, others.pop(name), value):
                    is_property = path == IDENTITY and not name.startswith(_DRAWING)  # of the run, not of its display
                    if is_property or path in _STATES or name in _SHAPES:
                        found.append(mismatch)
                    else:
                        self._skip(path, name, "has another type")
            for name in others.keys() - {_START_TIME}:
                self._skip(path, name, "this version does not write")
        for path in recorded.keys() - expected.keys():
            if not path.startswith(_OTHERS):
                self._skip(path, "all of it", "this version does not write")
        return found[0] if found else None

    def _skip(self, path: str, name: str, why: str) -> None:
        what = f"{name} of the property carom" if path == IDENTITY else f"{name} of /{path} (once)"
        self.skipped[f"{what}, which {why}"] = None

    def _recorded(self) -> StaticRows:
        """Read all static data."""
        found: StaticRows = {}
        with reading(self._recording.path):
            for chunk in self._recording.chunks(e for e in self._recording.store.entries if e.is_static):
                if (rows := chunk.batch.num_rows) > 1:
                    raise DamageError(f"{rows} rows of /{chunk.entity_path}, which is recorded once for all times")
                if rows:
                    row = {name: chunk.batch[name] for name in chunk.components}
                    found[chunk.entity_path] = found.get(chunk.entity_path, {}) | row
        return found

    def _expected(self, reach: float) -> StaticRows:
        """Return the static data that the recorder would write, for the bodies that the recording shows."""
        recording, header = self._recording, self._header
        clock = TimeScale(float(recording.info["time_scale"]))
        title = str(recording.parameters.get("name", header.title))
        found: StaticRows = {}
        every = range(header.bodies)
        few = None if recording.shows_all else Selection(recording.shown, every, header.box, header.bodies)
        properties = [(IDENTITY, any_values(identity(header, clock, recording.origin))), recording_name(title)]
        for path, archetype in (*properties, *statics(header, clock, recording.origin, reach)):
            rows = {}
            for batch in archetype.as_component_batches():
                values = batch.as_arrow_array()
                rows[batch.component_descriptor().component] = pa.ListArray.from_arrays([0, len(values)], values)
            fields = [pa.field(name, row.type, metadata=_DATA) for name, row in rows.items()]
            chunk = Chunk(path, pa.record_batch(list(rows.values()), schema=pa.schema(fields)))
            kept = chunk if few is None else few.of(chunk)
            found[path] = found.get(path, {}) | {name: kept.batch[name] for name in kept.components}
        return found


IDENTITY = "__properties/carom"
_INDEX, _DATA = {b"rerun:kind": b"index"}, {b"rerun:kind": b"data"}


def chunk_of(rows: Rows, clock: TimeScale) -> Chunk:
    """Return rows as a chunk, as if they had been recorded."""
    columns: dict[str, tuple[pa.Array, dict[bytes, bytes]]] = {}
    index = rows.index
    if len(index.impacts):
        columns[IMPACT] = pa.array(index.impacts, pa.int64()), _INDEX
    if len(index.steps):
        columns[STEP] = pa.array(index.steps, pa.int64()), _INDEX
    if len(index.times):
        columns[SIM_TIME] = pa.array(clock.within(index.times, index.ends)).cast(pa.duration("ns")), _INDEX
    for column in rows.columns:
        columns[column.component_descriptor().component] = (column.as_arrow_array(), _DATA)
    fields = [pa.field(name, array.type, metadata=kind) for name, (array, kind) in columns.items()]
    return Chunk(rows.path, pa.record_batch([array for array, _ in columns.values()], schema=pa.schema(fields)))
