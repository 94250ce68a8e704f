"""Tables of a recording: a row per frame, the exact states of bodies, and checkpoints."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from functools import cached_property, reduce
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa

from carom.arrays import FloatArray, IntArray, SingleArray
from carom.errors import DamageError, NotRecordedError, RecordingError
from carom.event import Event
from carom.recording.read.entities import (
    EVENTS,
    FINGERPRINTS,
    MOMENTA,
    SCALARS,
    STATES,
    Values,
    centres_of,
    join_rows,
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
from carom.recording.read.statics import Statics, named
from carom.recording.rrd.messages import release_memory
from carom.recording.schema import paths
from carom.recording.schema.paths import CLOSING, SIM_TIME, STEP
from carom.recording.schema.series import is_recorded, names_below
from carom.scene.start import HalfSpaces
from carom.scene.units.dimension import TIME
from carom.scene.wording import body_called

if TYPE_CHECKING:
    from carom.physics.checkpoint import Checkpoint
    from carom.physics.frame import Frame
    from carom.recording.read.recording import Recording
    from carom.recording.rrd.messages import Chunk


class FrameTables(Statics):
    """Tables of a recording with one row per frame or change."""

    @property
    @named
    def frames(self) -> int:
        """Number of frames."""
        return int(self._fingerprints.num_rows)

    def require_frames(self) -> None:
        """Raise a RecordingError with the outcome of the run if it ended before its first frame."""
        if self.frames == 0:
            raise RecordingError(f"{self.path} holds no frame: {self.outcome}")

    @named
    def fingerprints(self) -> pa.Table:
        """Columns step, sim_time, fingerprint (uint64) and time (s, exact)."""
        return self._fingerprints

    @named
    def energy(self, *names: str) -> pa.Table:
        """Energies (J) of every frame: the terms of the scene, their total, the ledger and the integration error.

        Given names, only these columns are read. Raises RecordingError if a column of the scene is lost.
        """
        return self._series(paths.ENERGY, names)

    @named
    def steps(self, *names: str) -> pa.Table:
        """Return dt (s), contacts, impact rate, colours, sweeps and overlaps of every frame.

        Given names, only these columns are read. Raises RecordingError if a column of the scene is lost.
        """
        return self._series(paths.STEPS, names)

    @named
    def momentum(self) -> pa.Table:
        """Momentum (kg m/s), angular momentum (kg m²/s), and their relative errors."""
        return self._entities.table(paths.MOMENTUM, MOMENTA)

    @named
    def events(self) -> pa.Table:
        """Columns step, sim_time, text, level and kind, in the order of steps."""
        events = self._entities.table(paths.EVENTS, EVENTS)
        events = events.rename_columns([name.removeprefix("TextLog:") for name in events.column_names])
        # events logged at the end are about earlier steps
        return events.take(np.argsort(events[STEP].to_numpy(), kind="stable"))

    def warnings(self, until: int | None = None) -> list[Event]:
        """Return the warnings of a run up to a step, in order of time, without the event that describes its end."""
        table = self.events()
        seconds = table[SIM_TIME].cast(pa.int64()).to_numpy() * 1e-9 * float(self.info["time_scale"])
        columns = (table[name].to_pylist() for name in ("level", "text", "kind"))
        events = [Event(*row) for row in zip(table[STEP].to_pylist(), seconds.tolist(), *columns, strict=True)]
        return [
            event
            for event in events
            if event.level == "WARN" and event.kind not in CLOSING and (until is None or event.step <= until)
        ]

    @named
    def phases(self) -> pa.Table:
        """Columns step, sim_time, state: a row at each change of the phase."""
        return self._states(paths.PHASE)

    @named
    def dt_limits(self) -> pa.Table:
        """Columns step, sim_time, state: a row at each change of the limit of dt."""
        return self._states(paths.DT_LIMIT)

    def states_at(self, step: int) -> dict[str, str]:
        """Return the states of `phases` and `dt_limits` after a step, by entity; empty before the first."""
        found = {}
        for path, table in ((paths.PHASE, self.phases()), (paths.DT_LIMIT, self.dt_limits())):
            rows = np.flatnonzero(table[STEP].to_numpy() <= step)
            found[path] = str(table["state"][int(rows[-1])]) if len(rows) else ""
        return found

    @named
    def drawn_positions(self, step: int) -> SingleArray | None:
        """Return the drawn centres of a frame, (n, 3) m from `origin`; None if there is no such frame."""
        chunk, place = self.row(paths.BODIES, step) or (None, 0)
        centres = None if chunk is None else centres_of(chunk)
        return None if centres is None else np.asarray(plain(centres[place].values).to_numpy()).reshape(-1, 3)

    @named
    def drawn_box(self, path: str) -> FloatArray:
        """Return the size of the walls or of the periodic box as drawn, (3,) m."""
        half = np.asarray(self._entities.static(path)["Boxes3D:half_sizes"], dtype=np.float64)
        if half.shape != (3,) or not np.all((half > 0.0) & np.isfinite(half)):
            raise DamageError(f"/{path} is not one box")
        return 2.0 * half

    @named
    def drawn_planes(self) -> HalfSpaces:
        """Return the planes as drawn, without names and sides; none if they are not drawn as grids."""
        ends = np.asarray(self._entities.static(paths.PLANES).get("LineStrips3D:strips", []), dtype=np.float64)
        if ends.size % (2 * paths.PLANE_LINES * 2 * 3):
            return HalfSpaces([], np.zeros((0, 3)), np.zeros(0))
        lines = ends.reshape(-1, 2, paths.PLANE_LINES, 2, 3)
        with np.errstate(invalid="ignore", over="ignore"):  # of a damaged file
            sides = lines[:, :, 0, 1] - lines[:, :, 0, 0]
            normal = np.cross(sides[:, 0], sides[:, 1])
            size = np.sqrt((normal * normal).sum(axis=1))
        drawn = (size > 0.0) & np.isfinite(size)
        normal = normal[drawn] / size[drawn, None]
        point = lines[drawn].mean(axis=(1, 2, 3)) + self.origin
        return HalfSpaces([""] * len(normal), normal, (normal * point).sum(axis=1))

    @cached_property
    def _fingerprints(self) -> pa.Table:
        return rising(self._entities.table(paths.FINGERPRINT, FINGERPRINTS))

    def _states(self, path: str) -> pa.Table:
        table = self._entities.table(path, STATES)
        return table.rename_columns([name.removeprefix("StateChange:") for name in table.column_names])

    def _series(self, root: str, names: tuple[str, ...]) -> pa.Table:
        """Return some or all scalars below an entity, for the frames that have all of them.

        A scalar without rows is omitted: a killed run may have sent half a batch, and a repaired file may lack parts.
        """
        entities, frames = self._entities.below(root), self._fingerprints
        scalars: dict[str, pa.Table] = {}
        for name in names or entities:
            chunks = self._entities.chunks(entities[name], "Scalars:scalars") if name in entities else iter(())
            rows = join_rows(f"{root}/{name}", chunks, SCALARS)
            if rows.num_rows:
                scalars[name] = rows
        known = names_below(root)
        for name in names:
            if name not in known and name not in scalars:
                raise RecordingError(f"there is no series {root}/{name}; there are {', '.join(known)}")
            if name not in scalars and self.frames and is_recorded(root, name, self.info):
                raise RecordingError(f"{self.path} has no /{root}/{name}: a part of the file is missing")
        columns = {name: frames[name] for name in (STEP, SIM_TIME, "time")}
        columns |= {name: rows["Scalars:scalars"] for name, rows in scalars.items()}
        steps = {name: rows[STEP].to_numpy() for name, rows in scalars.items()}
        own = frames[STEP].to_numpy()
        if all(np.array_equal(column, own) for column in steps.values()):
            return pa.table(columns)
        common = reduce(np.intersect1d, steps.values(), own)
        places = {name: np.searchsorted(steps.get(name, own), common) for name in columns}
        return pa.table({name: column.take(pa.array(places[name])) for name, column in columns.items()})


def rising(fingerprints: pa.Table) -> pa.Table:
    """Return the rows of frames. Raises DamageError if their times do not rise."""
    times = fingerprints["time"].to_numpy()
    if not np.isfinite(times).all() or np.any(np.diff(times) < 0.0):
        raise DamageError("times that do not increase")
    return fingerprints


def bodies_at(recording: Recording, at: float | None) -> pa.Table:
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


def table_of_bodies(recording: Recording, state: Checkpoint | Frame, source: str) -> pa.Table:
    """Return a state as a table of all bodies; see `BodyTable`."""
    numbers = np.flatnonzero(recording.present(state.step))
    vectors = state_vectors(state, numbers, recording.bodies.mass, recording.bodies.inertia)
    states = state_table([state.step], [state.time], [vectors])
    names = recording.bodies.name
    columns = {"body": pa.array(numbers), "name": pa.array([names[number] for number in numbers.tolist()])}
    columns |= {name: states[name] for name in states.column_names if name not in (STEP, "time")}
    told = {"step": str(state.step), "time": repr(state.time), "source": source}
    return with_units(pa.table(columns)).replace_schema_metadata(told)


def trajectory(recording: Recording, body: int | str, start: float, end: float) -> pa.Table:
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
    recording: Recording, bodies: Sequence[int | str] | None, start: float, end: float
) -> BodyTrajectories:
    """Return the paths of several bodies; see `Recording.trajectories`."""
    return _recorded_paths(recording, shown_bodies(recording, bodies), *frames_within(recording, start, end))


def shown_bodies(recording: Recording, bodies: Sequence[int | str] | None) -> list[int]:
    """Return the numbers of bodies, by default of all that the recording shows."""
    return list(recording.shown) if bodies is None else [shown_body(recording, body) for body in bodies]


def frames_within(recording: Recording, start: float, end: float) -> tuple[IntArray, FloatArray]:
    """Return steps and times (s) of the frames of an interval (s); RecordingError without any."""
    frames = recording.fingerprints()
    times = frames["time"].to_numpy()
    inside = np.flatnonzero((times >= start - tolerance(start)) & (times <= end + tolerance(end)))
    if len(inside) == 0:
        raise RecordingError(f"{recording.path} has no frame from {recording.units.span(start, end, TIME, 'g')}")
    return frames[STEP].to_numpy()[inside], times[inside]


def frames_with(recording: Recording, body: int | str, start: float, end: float) -> tuple[int, IntArray, FloatArray]:
    """Return the number of a body, and steps and times (s) of the frames of an interval (s) that have it."""
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


_OF_STATES = ("velocity", "orientation", "angular_velocity")  # unknown without an exact state


def _recorded_paths(
    recording: Recording, numbers: Sequence[int], steps: IntArray, times: FloatArray
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
    vectors = {"position": position}
    for quantity in STATE_QUANTITIES:
        if all(quantity.name in state for state in states) and (states or quantity.name in _OF_STATES):
            values = vectors.setdefault(
                quantity.name, np.full((len(steps), len(numbers), len(quantity.columns)), np.nan)
            )
            for row, state in zip(rows, states, strict=True):
                values[row] = state[quantity.name]
    lost = np.isnan(position).any(axis=2)
    if recording.lives is not None:
        first, last = recording.lives[own_places].T
        lost &= (first >= 0) & (first <= steps[:, None]) & (steps[:, None] <= last)
    if lost.any():
        step = int(steps[np.flatnonzero(lost.any(axis=1))[0]])
        raise RecordingError(f"{recording.path} has no positions at step {step}: part of the file is missing")
    told = "recorded: float64 at checkpoints, float32 elsewhere"
    return BodyTrajectories(own_places, steps, times, exact, vectors, told)


def checkpoints_at(recording: Recording, start: dict[str, Values], steps: Iterable[int]) -> Iterator[Checkpoint]:
    """Yield the exact states at some steps; ``start`` is that before the frames of a clip, empty for a whole run."""
    from carom.recording.schema.checkpoint_columns import decode  # noqa: PLC0415 - loads Numba

    frames = recording.fingerprints()
    known, bits = frames[STEP].to_numpy(), frames["fingerprint"].to_numpy()
    chunk: Chunk | None = None  # read once for consecutive steps
    for step in steps:
        if chunk is None or step not in chunk.batch[STEP].to_numpy():
            chunk = None  # free it before the next one is read: it may have 400 MB
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
