"""Tables with one row per frame of a recording, and the drawn bodies, boxes and planes."""

from __future__ import annotations

from functools import cached_property, reduce

import numpy as np
import pyarrow as pa

from carom.arrays import FloatArray, SingleArray
from carom.errors import DamageError, RecordingError
from carom.event import Event
from carom.recording.read.entities import EVENTS, FINGERPRINTS, MOMENTA, SCALARS, STATES, join_rows
from carom.recording.read.statics import Statics, named
from carom.recording.schema import paths
from carom.recording.schema.paths import CLOSING, SIM_TIME, STEP, kind_of
from carom.recording.schema.series import is_recorded, names_below
from carom.scene.start import HalfSpaces


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
        """Columns step, sim_time, text, level and kind, in the order of steps.

        In older recordings without kinds, the kinds of some events follow from their texts.
        """
        events = self._entities.table(paths.EVENTS, EVENTS, optional=("kind",))
        events = events.rename_columns([name.removeprefix("TextLog:") for name in events.column_names])
        texts = zip(events["kind"].to_pylist(), events["text"].to_pylist(), strict=True)
        kinds = pa.array([kind_of(kind, text) for kind, text in texts], pa.string())
        events = events.set_column(events.column_names.index("kind"), "kind", kinds)
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
        for chunk in self._entities.chunks_at(step, paths.BODIES):
            rows = np.flatnonzero(chunk.batch[STEP].to_numpy() == step)
            for name in paths.CENTRES:
                if len(rows) and name in chunk.components:
                    return np.asarray(chunk.batch[name][int(rows[0])].values.flatten().to_numpy()).reshape(-1, 3)
        return None

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

        A scalar without rows is omitted: a killed run may have sent half a batch, and a repaired file may lack any
        part.
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
                raise RecordingError(
                    f"{self.path} has no /{root}/{name}: a part of the file is missing, or an older carom made it"
                )
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
