"""`Recording`: open an .rrd of carom's and read from it. Nothing is loaded before it is asked for."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Self

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray
from rerun.chunk import Chunk, LazyChunkStream, RrdReader, StoreEntry

from carom.physics.checkpoint import Checkpoint
from carom.recording import entities
from carom.recording.checkpoint import decode
from carom.recording.clock import SIM_TIME, STEP
from carom.recording.errors import RecordingError
from carom.recording.layout import schema_version
from carom.recording.summary import summary

UNFINISHED = "unfinished: the run was killed before it could close the file"

_PROPERTIES = "__properties"


@dataclass(frozen=True, slots=True)
class BodyTable:
    """What does not change about the bodies."""

    name: list[str]  # (n,)
    group: NDArray[np.int64]  # (n,)
    mass: NDArray[np.float64]  # (n,) kg
    radius: NDArray[np.float64]  # (n,) m
    inertia: NDArray[np.float64]  # (n,) kg m²


class Recording:
    """A recording on disk. Make one with :meth:`open`."""

    def __init__(self, path: Path, reader: RrdReader, finished: bool) -> None:
        self.path = path
        self.finished = finished  # the file has its footer: the run closed it
        self._reader = reader

    @classmethod
    def open(cls, path: str | Path) -> Self:
        """Open a file. RecordingError if it is not there, not a recording of carom's, or of a newer schema."""
        path = Path(path)
        if not path.is_file():
            raise RecordingError(f"there is no recording at {path}")
        reader, stores = _stores(path)
        if not stores:
            raise RecordingError(f"{path} holds no recording")
        version = schema_version(stores[0].application_id)
        if version is None:
            raise RecordingError(f"{path} was not made by carom, but by {stores[0].application_id!r}")
        if version > entities.SCHEMA_VERSION:
            raise RecordingError(
                f"{path} has schema version {version}; this carom reads up to {entities.SCHEMA_VERSION}: upgrade carom"
            )
        return cls(path, reader, _has_footer(reader))

    @cached_property
    def info(self) -> Mapping[str, Any]:
        """The property `carom`: schema version, title, bodies, flags, origin, time scale."""
        return self._property("carom")

    @cached_property
    def properties(self) -> Mapping[str, Any]:
        """The property `run`: versions, command, git, cpu and whatever else the run was told to keep."""
        return self._property("run")

    @cached_property
    def closing(self) -> Mapping[str, Any]:
        """The property `outcome`: how it ended; empty if the run was killed."""
        return self._property("outcome")

    @cached_property
    def arrow_references(self) -> Mapping[str, Any]:
        """The property `arrows`: what the length of torques and angular accelerations is measured in."""
        return self._property("arrows")

    @property
    def versions(self) -> dict[str, str]:
        """The packages that it was recorded with."""
        stamped = ((key.partition("version."), value) for key, value in self.properties.items())
        return {package: str(value) for (before, dot, package), value in stamped if dot and not before}

    @property
    def title(self) -> str:
        """The scene's title."""
        return str(self.info["title"])

    @property
    def outcome(self) -> str:
        """How the run ended."""
        return str(self.closing.get("outcome", UNFINISHED))

    @cached_property
    def scene_toml(self) -> str:
        """The scene, exactly as it was written."""
        return str(self._static(entities.SCENE_TOML)["TextDocument:text"][0])

    @cached_property
    def bodies(self) -> BodyTable:
        """Names, groups, masses, radii and moments of inertia."""
        stored = self._static(entities.STATIC_STATE)
        return BodyTable(
            name=list(stored["name"]),
            group=np.asarray(stored["group"], dtype=np.int64),
            mass=np.asarray(stored["mass"], dtype=np.float64),
            radius=np.asarray(stored["radius"], dtype=np.float64),
            inertia=np.asarray(stored["inertia"], dtype=np.float64),
        )

    @property
    def frames(self) -> int:
        """How many frames there are."""
        return int(self._fingerprints.num_rows)

    def fingerprints(self) -> pa.Table:
        """Columns step, sim_time, time (s, exact) and fingerprint (uint64)."""
        return self._fingerprints

    def energy(self) -> pa.Table:
        """Energies (J) of every frame: the terms the scene has, total, the ledger, the integration error."""
        return self._series(entities.ENERGY)

    def steps(self) -> pa.Table:
        """Return dt (s), contacts, colours, sweeps and overlaps of every frame."""
        return self._series(entities.STEP)

    def momentum(self) -> pa.Table:
        """Momentum (kg m/s), angular momentum (kg m²/s), and their relative errors."""
        return self._table(entities.MOMENTUM)

    def events(self) -> pa.Table:
        """Columns step, sim_time, level, text."""
        table = self._table(entities.EVENTS, ("TextLog:text", "TextLog:level"))
        return table.rename_columns([name.removeprefix("TextLog:") for name in table.column_names])

    def phases(self) -> pa.Table:
        """Columns step, sim_time, state: a row where the phase changes."""
        table = self._table(entities.PHASE, ("StateChange:state",))
        return table.rename_columns([name.removeprefix("StateChange:") for name in table.column_names])

    def dt_limits(self) -> pa.Table:
        """Columns step, sim_time, state: a row where what limits dt changes."""
        table = self._table(entities.DT_LIMIT, ("StateChange:state",))
        return table.rename_columns([name.removeprefix("StateChange:") for name in table.column_names])

    @cached_property
    def checkpoint_steps(self) -> list[int]:
        """Steps that carry an exact checkpoint, rising; a clip's first one may lie before its first frame."""
        steps = {int(step) for step in self._table(entities.CHECKPOINT, ("time",))[STEP].to_pylist()}
        return sorted(steps | ({int(self._start[STEP][0])} if self._start else set()))

    @cached_property
    def checkpoint_times(self) -> list[float]:
        """Simulated time in s of each of :attr:`checkpoint_steps`."""
        table = self._table(entities.CHECKPOINT, ("time",))
        times = dict(zip(table[STEP].to_pylist(), table["time"].to_pylist(), strict=True))
        if self._start:
            times.setdefault(int(self._start[STEP][0]), float(self._start["time"][0]))
        return [float(times[step]) for step in self.checkpoint_steps]

    def checkpoint(self, step: int) -> Checkpoint:
        """Decode the exact state at one of :attr:`checkpoint_steps`.

        Raises
        ------
        RecordingError
            If there is none at this step, or it is damaged.
        """
        bodies = len(self.bodies.mass)
        for chunk in self._chunks(entities.CHECKPOINT):
            batch = chunk.to_record_batch()
            rows = np.flatnonzero(batch[STEP].to_numpy() == step)
            if len(rows):
                row = int(rows[-1])
                names = [name for name in batch.schema.names if pa.types.is_list(batch.schema.field(name).type)]
                return decode(step, {name: _values(batch[name][row]) for name in names}, bodies)
        if self._start and int(self._start[STEP][0]) == step:
            return decode(step, self._start, bodies)
        raise RecordingError(f"{self.path} has no checkpoint at step {step}")

    def checkpoints(self) -> Iterator[Checkpoint]:
        """All exact states, in order."""
        return (self.checkpoint(step) for step in self.checkpoint_steps)

    def drawn_positions(self, step: int) -> NDArray[np.float32] | None:
        """Return the centres as they are drawn in a frame, (n, 3) m from the origin; None without that frame."""
        names = ("Ellipsoids3D:centers", "Points3D:positions", "InstancePoses3D:translations")
        for chunk in self._chunks(entities.BODIES, names):
            batch = chunk.to_record_batch()
            rows = np.flatnonzero(batch[STEP].to_numpy() == step)
            for name in names:
                if len(rows) and name in batch.schema.names:
                    return np.asarray(batch[name][int(rows[0])].values.flatten().to_numpy()).reshape(-1, 3)
        return None

    def moment(self) -> float:
        """Find the time (s) to look at: the hardest impact, else the most contacts, else the end.

        A run that was closed says when its hardest impact was; otherwise it is searched among the frames.
        """
        if "moments.impact.time" in self.closing:
            return float(self.closing["moments.impact.time"])
        if self.frames == 0:
            raise RecordingError(f"{self.path} holds no frame: {self.outcome}")
        energy = self.energy()
        if "restitution" in energy.column_names:
            taken = _column(energy, "restitution")
            taken = taken + (_column(energy, "friction") if "friction" in energy.column_names else 0.0)
            lost = np.diff(taken, prepend=0.0)
            if lost.max() > 0:
                return float(_column(energy, "time")[np.argmax(lost)])
        steps = self.steps()
        if "contacts" in steps.column_names and _column(steps, "contacts").max() > 0:
            return float(_column(steps, "time")[np.argmax(_column(steps, "contacts"))])
        return float(_column(self._fingerprints, "time")[-1])

    def summary(self) -> dict[str, Any]:
        """How the run went, as nested numbers and strings."""
        return summary(self)

    @cached_property
    def _start(self) -> dict[str, list[Any]]:
        return self._static(entities.START, required=False)

    @cached_property
    def _fingerprints(self) -> pa.Table:
        return self._table(entities.FINGERPRINT)

    def _series(self, root: str) -> pa.Table:
        """All Scalars below an entity, side by side; every frame has a row in each."""
        columns: dict[str, Any] = {STEP: self._fingerprints[STEP], SIM_TIME: self._fingerprints[SIM_TIME]}
        columns["time"] = self._fingerprints["time"]
        parts: dict[str, list[pa.RecordBatch]] = {}
        for chunk in self._chunks(f"{root}/**", "Scalars:scalars"):
            parts.setdefault(chunk.entity_path.rsplit("/", 1)[1], []).append(chunk.to_record_batch())
        for name, batches in parts.items():
            columns[name] = _flat(batches, "Scalars:scalars")
        whole = min(len(column) for column in columns.values())  # a killed run may have sent half a batch
        return pa.table({name: column[:whole] for name, column in columns.items()})

    def _table(self, path: str, components: tuple[str, ...] | None = None) -> pa.Table:
        batches = [chunk.to_record_batch() for chunk in self._chunks(path, components)]
        if not batches:
            empty: dict[str, Any] = {STEP: pa.array([], pa.int64()), SIM_TIME: pa.array([], pa.duration("ns"))}
            return pa.table(empty | {name: pa.array([], pa.string()) for name in components or ()})
        names = components or [n for n in batches[0].schema.names if pa.types.is_list(batches[0].schema.field(n).type)]
        columns = {name: pa.chunked_array([batch[name] for batch in batches]) for name in (STEP, SIM_TIME)}
        return pa.table(columns | {name: _flat(batches, name) for name in names})

    def _chunks(self, content: str, components: str | tuple[str, ...] | None = None) -> Iterator[Chunk]:
        chosen = list(components) if isinstance(components, tuple) else components
        stream = self._stream().filter(content=f"/{content}", is_static=False, components=chosen)
        return iter(sorted(self._read(stream), key=_first_step))

    def temporal_chunks(self) -> Iterator[Chunk]:
        """All chunks that are not static, one after the other."""
        stream = iter(self._stream().filter(is_static=False))
        while True:
            try:
                yield next(stream)
            except StopIteration:
                return
            except RuntimeError as error:
                raise RecordingError(f"cannot read {self.path}: {error}") from error

    def _read(self, stream: LazyChunkStream) -> list[Chunk]:
        try:
            return list(stream)
        except RuntimeError as error:
            raise RecordingError(f"cannot read {self.path}: {error}") from error

    def _stream(self) -> LazyChunkStream:
        return self._reader.store().stream() if self.finished else self._reader.stream()

    def _static(self, path: str, required: bool = True) -> dict[str, list[Any]]:
        """Read the components of a static entity."""
        found: dict[str, list[Any]] = {}
        for chunk in self._read(self._stream().filter(content=f"/{path}", is_static=True)):
            batch = chunk.to_record_batch()
            lists = [n for n in batch.schema.names if pa.types.is_list(batch.schema.field(n).type)]
            found |= {name: batch[name][0].as_py() for name in lists}
        if not found and required:
            raise RecordingError(f"{self.path} has no /{path}: it ended before the first frame was written")
        return found

    def _property(self, name: str) -> dict[str, Any]:
        stored = self._static(f"{_PROPERTIES}/{name}", required=False)
        return {key: values[0] if len(values) == 1 else values for key, values in stored.items()}


def _stores(path: Path) -> tuple[RrdReader, list[StoreEntry]]:
    """Open a file and list what is in it."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # "no footer": a killed run, which is said in the outcome
        try:
            reader = RrdReader(path)
            return reader, reader.recordings()
        except RuntimeError as error:
            reason = str(error).rsplit(": ", 1)[-1]
            raise RecordingError(
                f"{path} is not a recording, or is damaged ({reason}); "
                f"`rerun rrd optimize {path} -o repaired.rrd` saves what can be read"
            ) from error


def _has_footer(reader: RrdReader) -> bool:
    try:
        reader.store()
    except RuntimeError:
        return False
    return True


def _first_step(chunk: Chunk) -> int:
    return int(chunk.to_record_batch()[STEP][0].as_py()) if chunk.num_rows else 0


def _flat(batches: list[pa.RecordBatch], name: str) -> pa.ChunkedArray:
    """Join a component's column; one value a row comes without its list."""
    column = pa.chunked_array([batch[name] for batch in batches])
    lengths = pc.list_value_length(column)
    if len(column) and pc.all(pc.equal(lengths, 1)).as_py():
        return pc.list_flatten(column)
    return column


def _values(row: pa.ListScalar) -> NDArray[np.generic] | list[Any]:
    """Return one row of a component: an array, or a list of texts."""
    return list(row.as_py()) if pa.types.is_string(row.values.type) else row.values.to_numpy()


def _column(table: pa.Table, name: str) -> NDArray[np.float64]:
    return np.asarray(table[name].to_numpy(), dtype=np.float64)
