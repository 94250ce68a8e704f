"""`Recording`: open an .rrd of carom's and read from it. Nothing is loaded before it is asked for."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property, reduce, wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any, Concatenate, ParamSpec, Self, TypeVar

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from carom.physics.event import Event
from carom.recording import paths
from carom.recording.container import BLUEPRINT, RECORDING, Chunk, Container, Entry, Store
from carom.recording.damage import reading
from carom.recording.errors import RecordingError
from carom.recording.layout import schema_version
from carom.recording.summary import summary
from carom.recording.timelines import SIM_TIME, STEP

if TYPE_CHECKING:
    from carom.physics.checkpoint import Checkpoint

UNFINISHED = "unfinished: the run was killed before it could close the file; `carom repair` makes it whole"

_PROPERTIES = "__properties"
_END = "end: "  # how the last event of a recording begins

_Parameters = ParamSpec("_Parameters")
_Result = TypeVar("_Result")


def _named(
    read: Callable[Concatenate[Recording, _Parameters], _Result],
) -> Callable[Concatenate[Recording, _Parameters], _Result]:
    """Let a method say which file it is that has not got in it what it should."""

    @wraps(read)
    def reads(self: Recording, /, *args: _Parameters.args, **kwargs: _Parameters.kwargs) -> _Result:
        with reading(self.path):
            return read(self, *args, **kwargs)

    return reads


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

    def __init__(self, container: Container, store: Store) -> None:
        self.path = container.path
        self.finished = container.finished  # the file has its footer: the run closed it
        self.store = store
        self._container = container

    @classmethod
    def open(cls, path: str | Path) -> Self:
        """Open a file. RecordingError if it is not there, not a recording of carom's, or of a newer schema."""
        path = Path(path)
        if not path.is_file():
            raise RecordingError(f"there is no recording at {path}")
        with reading(path):
            container = Container.open(path)
        store = next((store for store in container.stores if store.kind == RECORDING), None)
        if store is None:
            raise RecordingError(f"{path} holds no recording")
        version = schema_version(store.application_id)
        if version is None:
            raise RecordingError(f"{path} was not made by carom, but by {store.application_id!r}")
        if version > paths.SCHEMA_VERSION:
            raise RecordingError(
                f"{path} has schema version {version}; this carom reads up to {paths.SCHEMA_VERSION}: upgrade carom"
            )
        return cls(container, store)

    @cached_property
    @_named
    def info(self) -> Mapping[str, Any]:
        """The property `carom`: schema version, title, bodies, flags, origin, time scale."""
        return self._property("carom")

    @cached_property
    @_named
    def properties(self) -> Mapping[str, Any]:
        """The property `run`: versions, command, git, cpu and whatever else the run was told to keep."""
        return self._property("run")

    @cached_property
    @_named
    def parameters(self) -> Mapping[str, Any]:
        """The property `sweep`: the run's name in its sweep, and what varies there; empty for a run of its own."""
        return self._property("sweep")

    @cached_property
    @_named
    def closing(self) -> Mapping[str, Any]:
        """The property `outcome`: how it ended; empty if the run was killed."""
        return self._property("outcome")

    @cached_property
    @_named
    def arrow_references(self) -> Mapping[str, Any]:
        """The property `arrows`: what the length of torques and angular accelerations is measured in."""
        return self._property("arrows")

    @property
    def versions(self) -> dict[str, str]:
        """The packages that it was recorded with."""
        stamped = ((key.partition("version."), value) for key, value in self.properties.items())
        return {package: str(value) for (before, dot, package), value in stamped if dot and not before}

    @cached_property
    @_named
    def clip(self) -> Mapping[str, Any]:
        """The property `clip`: where this piece was cut out; empty if it is a whole run."""
        return self._property("clip")

    @cached_property
    @_named
    def shown(self) -> list[int]:
        """Numbers of the bodies that have a sphere in it: all, unless it is a clip of a few."""
        few = self.clip.get("bodies", range(int(self.info["bodies"])))
        return [int(body) for body in np.atleast_1d(few)]

    @property
    @_named
    def is_overlay(self) -> bool:
        """Whether it shows several runs over each other: `carom diff -o` made it, or `carom tradeoff`."""
        return bool(self._property("diff") or self._property("tradeoff"))

    def refuse_overlay(self) -> None:
        """Raise RecordingError if it shows several runs: none of them is whole in it."""
        if self.is_overlay:
            raise RecordingError(f"{self.path} shows several runs over each other, to look at with carom view")

    @property
    @_named
    def title(self) -> str:
        """The scene's title."""
        return str(self.info["title"])

    @property
    @_named
    def outcome(self) -> str:
        """How the run ended."""
        return str(self.closing.get("outcome", UNFINISHED))

    @cached_property
    @_named
    def scene_toml(self) -> str:
        """The scene, exactly as it was written."""
        self.refuse_overlay()
        return str(self._static(paths.SCENE_TOML)["TextDocument:text"][0])

    @cached_property
    @_named
    def bodies(self) -> BodyTable:
        """Names, groups, masses, radii and moments of inertia."""
        stored = self._static(paths.STATIC_STATE)
        return BodyTable(
            name=list(stored["name"]),
            group=np.asarray(stored["group"], dtype=np.int64),
            mass=np.asarray(stored["mass"], dtype=np.float64),
            radius=np.asarray(stored["radius"], dtype=np.float64),
            inertia=np.asarray(stored["inertia"], dtype=np.float64),
        )

    @property
    @_named
    def frames(self) -> int:
        """How many frames there are."""
        return int(self._fingerprints.num_rows)

    @_named
    def fingerprints(self) -> pa.Table:
        """Columns step, sim_time, time (s, exact) and fingerprint (uint64)."""
        return self._fingerprints

    @_named
    def energy(self, *names: str) -> pa.Table:
        """Energies (J) of every frame: the terms the scene has, total, the ledger, the integration error.

        With names, only these are read.
        """
        return self._series(paths.ENERGY, names)

    @_named
    def steps(self, *names: str) -> pa.Table:
        """Return dt (s), contacts, colours, sweeps and overlaps of every frame; with names, only these are read."""
        return self._series(paths.STEP, names)

    @_named
    def momentum(self) -> pa.Table:
        """Momentum (kg m/s), angular momentum (kg m²/s), and their relative errors."""
        return self._table(paths.MOMENTUM)

    @_named
    def events(self) -> pa.Table:
        """Columns step, sim_time, level, text, kind (empty where the recording is older than kinds)."""
        table = self._table(paths.EVENTS, ("TextLog:text", "TextLog:level"))
        table = table.rename_columns([name.removeprefix("TextLog:") for name in table.column_names])
        kinds = [_kinds(chunk.batch) for chunk in self._chunks(paths.EVENTS)]
        return table.append_column("kind", pa.array([kind for each in kinds for kind in each], pa.string()))

    def warnings(self, until: int | None = None) -> list[Event]:
        """Return what the run was warned of, up to a step, in order of time; how it ended is no warning."""
        events, scale = self.events(), float(self.info["time_scale"])
        seconds = events[SIM_TIME].cast(pa.int64()).to_numpy() * 1e-9 * scale
        names = ("level", "text", "kind")
        rows = zip(
            events[STEP].to_pylist(), seconds.tolist(), *(events[name].to_pylist() for name in names), strict=True
        )
        found = [Event(*row) for row in rows]
        return [
            event
            for event in found
            if event.level == "WARN"
            and not (event.kind == "end" or event.text.startswith(_END))
            and (until is None or event.step <= until)
        ]

    @_named
    def phases(self) -> pa.Table:
        """Columns step, sim_time, state: a row where the phase changes."""
        return self._states(paths.PHASE)

    @_named
    def dt_limits(self) -> pa.Table:
        """Columns step, sim_time, state: a row where what limits dt changes."""
        return self._states(paths.DT_LIMIT)

    @cached_property
    @_named
    def checkpoint_times(self) -> dict[int, float]:
        """Simulated time in s by step of the exact checkpoints, rising; a clip's first may lie before its frames."""
        table = self._table(paths.CHECKPOINT, ("time",))
        times = {int(self._start[STEP][0]): float(self._start["time"][0])} if self._start else {}
        rows = zip(table[STEP].to_pylist(), table["time"].to_pylist(), strict=True)
        times |= {int(step): float(time) for step, time in rows}
        return dict(sorted(times.items()))

    @property
    def checkpoint_steps(self) -> list[int]:
        """Steps that carry an exact checkpoint, rising."""
        return list(self.checkpoint_times)

    @_named
    def checkpoint(self, step: int) -> Checkpoint:
        """Decode the exact state at one of :attr:`checkpoint_steps`.

        Raises
        ------
        RecordingError
            If there is none at this step, or it is damaged.
        """
        from carom.recording.checkpoint import decode  # noqa: PLC0415 - loads Numba, which looking at a file does not need

        bodies = len(self.bodies.mass)
        for chunk in self._chunks_at(step, paths.CHECKPOINT):
            batch = chunk.batch
            rows = np.flatnonzero(batch[STEP].to_numpy() == step)
            if len(rows):
                row = int(rows[-1])
                return decode(step, {name: _values(batch[name][row]) for name in chunk.components}, bodies)
        if self._start and int(self._start[STEP][0]) == step:
            return decode(step, self._start, bodies)
        raise RecordingError(f"{self.path} has no checkpoint at step {step}")

    def checkpoints(self) -> Iterator[Checkpoint]:
        """All exact states, in order."""
        return (self.checkpoint(step) for step in self.checkpoint_steps)

    @_named
    def drawn_positions(self, step: int) -> NDArray[np.float32] | None:
        """Return the centres as they are drawn in a frame, (n, 3) m from the origin; None without that frame."""
        for chunk in self._chunks_at(step, paths.BODIES):
            rows = np.flatnonzero(chunk.batch[STEP].to_numpy() == step)
            for name in paths.CENTRES:
                if len(rows) and name in chunk.components:
                    return np.asarray(chunk.batch[name][int(rows[0])].values.flatten().to_numpy()).reshape(-1, 3)
        return None

    @_named
    def moment(self, at: float | None = None) -> float:
        """Find the time (s) to look at: a given one, else the hardest impact, else the most contacts, else the end.

        A run that was closed says when its hardest impact was; otherwise it is searched among the frames.

        Raises
        ------
        RecordingError
            If there is no frame, or the given time is not in the recording.
        """
        if self.frames == 0:
            raise RecordingError(f"{self.path} holds no frame: {self.outcome}")
        times = _column(self._fingerprints, "time")
        if at is not None:
            between = (
                np.inf if len(times) == 1 else (times[-1] - times[0]) / (len(times) - 1)
            )  # a step may have no frame
            if not times[0] - between <= at <= times[-1] + between:
                raise RecordingError(
                    f"{self.path} goes from {times[0]:.9g} to {times[-1]:.9g} s, {at:.9g} s is not in it"
                )
            return at
        impact = float(self.closing.get("moments.impact.time", np.nan))
        if times[0] <= impact <= times[-1]:
            return impact
        energy = self.energy()
        if "restitution" in energy.column_names:
            taken = _column(energy, "restitution")
            taken = taken + (_column(energy, "friction") if "friction" in energy.column_names else 0.0)
            lost = np.diff(taken, prepend=taken[:1])
            if lost.max() > 0:
                return float(_column(energy, "time")[np.argmax(lost)])
        steps = self.steps()
        if "contacts" in steps.column_names and _column(steps, "contacts").max() > 0:
            return float(_column(steps, "time")[np.argmax(_column(steps, "contacts"))])
        return float(times[-1])

    @_named
    def summary(self) -> dict[str, Any]:
        """How the run went, as nested numbers and strings."""
        return summary(self)

    @cached_property
    def _start(self) -> dict[str, list[Any]]:
        return self._static(paths.START, required=False)

    @cached_property
    def _fingerprints(self) -> pa.Table:
        found = self._table(paths.FINGERPRINT)
        if found.num_rows:
            return found
        return found.append_column("fingerprint", pa.array([], pa.uint64())).append_column(
            "time", pa.array([], pa.float64())
        )

    def _states(self, path: str) -> pa.Table:
        table = self._table(path, ("StateChange:state",))
        return table.rename_columns([name.removeprefix("StateChange:") for name in table.column_names])

    def _series(self, root: str, names: tuple[str, ...]) -> pa.Table:
        """All Scalars below an entity, side by side: the frames that have a value in each.

        A run that was killed may have sent half a batch, and of a repaired one any piece may be missing.
        """
        parts: dict[str, list[pa.RecordBatch]] = {}
        for chunk in self._chunks(f"{root}/**", "Scalars:scalars", names):
            parts.setdefault(chunk.entity_path.rsplit("/", 1)[1], []).append(chunk.batch)
        frames = self._fingerprints
        columns = {name: frames[name] for name in (STEP, SIM_TIME, "time")}
        columns |= {name: _flat(batches, "Scalars:scalars") for name, batches in parts.items()}
        steps = {name: np.concatenate([batch[STEP].to_numpy() for batch in parts[name]]) for name in parts}
        own = frames[STEP].to_numpy()
        if all(np.array_equal(column, own) for column in steps.values()):
            return pa.table(columns)
        common = reduce(np.intersect1d, steps.values(), own)
        places = {name: np.searchsorted(steps.get(name, own), common) for name in columns}
        return pa.table({name: column.take(pa.array(places[name])) for name, column in columns.items()})

    def _table(self, path: str, components: tuple[str, ...] | None = None) -> pa.Table:
        chunks = list(self._chunks(path))
        if not chunks:
            empty: dict[str, Any] = {STEP: pa.array([], pa.int64()), SIM_TIME: pa.array([], pa.duration("ns"))}
            return pa.table(empty | {name: pa.array([], pa.string()) for name in components or ()})
        batches, names = [chunk.batch for chunk in chunks], components or chunks[0].components
        columns = {name: pa.chunked_array([batch[name] for batch in batches]) for name in (STEP, SIM_TIME)}
        return pa.table(columns | {name: _flat(batches, name) for name in names})

    def chunks(self, entries: Iterable[Entry]) -> Iterator[Chunk]:
        """Read chunks as they lie in the file, one after the other."""
        with reading(self.path):
            yield from self._container.chunks(entries)

    def temporal_chunks(self) -> Iterator[Chunk]:
        """Read all chunks that are not static, as they lie in the file."""
        return self.chunks([entry for entry in self.store.entries if not entry.is_static])

    def layout(self) -> list[Chunk]:
        """Read the layout that it opens with, the last one sent; empty if there is none."""
        layouts = [store for store in self._container.stores if store.kind == BLUEPRINT and store.entries]
        return list(self.chunks(layouts[-1].entries)) if layouts else []

    def _chunks(self, content: str, component: str | None = None, names: tuple[str, ...] = ()) -> Iterator[Chunk]:
        """Read an entity's chunks in order; with ``/**`` at its end those of all entities below it, or some of them."""
        found = [entry for entry in self.store.entries if not entry.is_static and _within(entry, content)]
        if names:
            found = [entry for entry in found if entry.entity_path.rsplit("/", 1)[1] in names]
        for chunk in self.chunks(sorted(found, key=lambda entry: entry.first_step or 0)):
            if component is None or component in chunk.components:
                yield chunk

    def _chunks_at(self, step: int, path: str) -> Iterator[Chunk]:
        """Read those chunks of an entity that a step may be in."""
        found = [entry for entry in self.store.entries if entry.entity_path == path and entry.holds(step)]
        return self.chunks(found)

    def _static(self, path: str, required: bool = True) -> dict[str, list[Any]]:
        """Read the components of a static entity."""
        found: dict[str, list[Any]] = {}
        for chunk in self.chunks([e for e in self.store.entries if e.is_static and e.entity_path == path]):
            found |= {name: chunk.batch[name][0].as_py() for name in chunk.components}
        if not found and required:
            raise RecordingError(f"{self.path} has no /{path}: it ended before the first frame was written")
        return found

    def _property(self, name: str) -> dict[str, Any]:
        stored = self._static(f"{_PROPERTIES}/{name}", required=False)
        return {key: values[0] if len(values) == 1 else values for key, values in stored.items()}


def _kinds(batch: pa.RecordBatch) -> list[str]:
    """Return the kind of each event of a batch."""
    if "kind" not in batch.schema.names:
        return [""] * batch.num_rows
    return [str(row[0]) if row else "" for row in batch["kind"].to_pylist()]


def _within(entry: Entry, content: str) -> bool:
    if content.endswith("/**"):
        return entry.entity_path.startswith(content.removesuffix("**"))
    return entry.entity_path == content


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
