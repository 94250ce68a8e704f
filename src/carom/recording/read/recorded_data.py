"""`RecordedData`: tables with a row for each frame or change, and the data of bodies that are recorded once."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from functools import cached_property, reduce
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa

from carom.arrays import BoolArray, FloatArray, IntArray, SingleArray
from carom.errors import DamageError, RecordingError
from carom.event import Event
from carom.recording.read.entities import (
    CHECKPOINT_TIMES,
    EVENTS,
    FINGERPRINTS,
    MOMENTA,
    SCALARS,
    STATES,
    Values,
    centres_of,
    join_rows,
    plain,
)
from carom.recording.read.statics import BodyTable, Statics, decode_bodies, decode_names, named
from carom.recording.schema import paths
from carom.recording.schema.header import LARGEST
from carom.recording.schema.paths import CLOSING
from carom.recording.schema.series import is_recorded, names_below
from carom.recording.timelines import SIM_TIME, STEP
from carom.scene.data.body_columns import BodyColumns
from carom.scene.schema.shear import Shear
from carom.scene.start import EntryStates, HalfSpaces
from carom.state.checkpoint import Checkpoint
from carom.state.frame import Frame

if TYPE_CHECKING:
    from carom.recording.rrd.messages import Chunk


class RecordedData(Statics):
    """The data of a recording, from which the other modules of this package read; `Recording` adds their functions."""

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
        # events that are logged at the end belong to earlier steps
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
        """Return the states of `phases` and `dt_limits` after a step, by entity; empty before the first change."""
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
        """Return the planes as drawn, without names and sides; empty if they are not drawn as grids."""
        ends = np.asarray(self._entities.static(paths.PLANES).get("LineStrips3D:strips", []), dtype=np.float64)
        if ends.size % (2 * paths.PLANE_LINES * 2 * 3):
            return HalfSpaces([], np.zeros((0, 3)), np.zeros(0))
        lines = ends.reshape(-1, 2, paths.PLANE_LINES, 2, 3)
        with np.errstate(invalid="ignore", over="ignore"):  # values of a damaged file may be too large
            sides = lines[:, :, 0, 1] - lines[:, :, 0, 0]
            normal = np.cross(sides[:, 0], sides[:, 1])
            size = np.sqrt((normal * normal).sum(axis=1))
        drawn = (size > 0.0) & np.isfinite(size)
        normal = normal[drawn] / size[drawn, None]
        point = lines[drawn].mean(axis=(1, 2, 3)) + self.origin
        return HalfSpaces([""] * len(normal), normal, (normal * point).sum(axis=1))

    @cached_property
    @named
    def bodies(self) -> BodyTable:
        """Names, groups, masses, radii and moments of inertia; ``bodies(at)`` returns their state at a time.

        In a clip of selected bodies, the values of all other bodies are NaN.
        """
        self.refuse_overlay()
        stored, n = self._entities.static(paths.STATIC_STATE), int(self.info["bodies"])
        n = len(self.shown) if self.is_partial else n
        names, groups = decode_names(stored), np.asarray(stored["group"])
        if len(names) != n or groups.shape != (n,) or groups.dtype != np.int64:
            raise DamageError(f"names or groups of its bodies do not fit {n} bodies")
        sizes = {name: np.asarray(stored[name]) for name in ("mass", "radius", "inertia")}
        for name, array in sizes.items():
            if array.shape != (n,) or array.dtype != np.float64 or not np.all((array >= 0.0) & np.isfinite(array)):
                raise DamageError(f"{name} of its bodies is not {n} numbers of at least 0")
        mass, radius, inertia = sizes.values()
        if not (radius.all() and (mass.any() or self.is_partial) and np.array_equal(mass > 0.0, inertia > 0.0)):
            raise DamageError("a radius, a moment of inertia or all masses of its bodies are 0")
        table = BodyTable(names, groups, mass, radius, inertia, self.bodies_at)
        return table.among(self.shown, int(self.info["bodies"])) if self.is_partial else table

    @cached_property
    @named
    def lives(self) -> IntArray | None:
        """Steps (n, 2) of the first and the last frame with each body, if bodies came or went; otherwise None.

        Both numbers are -1 for a body without a frame.
        """
        stored = self._entities.static(paths.LIVES, required=False)
        if not stored:
            return None
        first, last = (np.asarray(stored[name]) for name in ("first_step", "last_step"))
        n = int(self.info["bodies"])
        if any(each.shape != (n,) or each.dtype != np.int64 for each in (first, last)):
            raise DamageError("it lacks the times when some bodies came and went")
        end = int(self.fingerprints()[STEP][-1].as_py()) if self.frames else -1
        return np.stack([first, np.where((first >= 0) & (last < 0), end, last)], axis=1)

    @cached_property
    @named
    def fixed(self) -> BoolArray:
        """Mask (n,) of the bodies that another engine never moves; if the recording has no mask, no body is fixed."""
        return self._mask("fixed", False)

    @cached_property
    @named
    def judged(self) -> BoolArray:
        """Mask (n,) of another engine's bodies whose laws are known; without a mask, they are known for all bodies."""
        return self._mask("judged", True)

    @cached_property
    @named
    def entries(self) -> EntryStates | None:
        """How bodies enter; None if all exist from the start."""
        if not self.info.get("admits") or self.is_partial:
            return None
        stored, n = self._entities.static(paths.STATIC_STATE), int(self.info["bodies"])
        found = [np.asarray(stored.get(f"{paths.ENTRY}{name}", ())) for name in EntryStates._fields]
        if any(each.shape != (3 * n,) or not np.all(np.abs(each) <= LARGEST) for each in found):
            raise DamageError("it does not state how its bodies enter")
        return EntryStates(*(each.reshape(n, 3) for each in found))

    def _mask(self, name: str, default: bool) -> BoolArray:
        n = int(self.info["bodies"])
        mask = np.asarray(self._entities.static(paths.STATIC_STATE).get(name, np.full(n, default)))
        if mask.shape != (n,) or mask.dtype != np.bool_:
            raise DamageError(f"it does not state of each body whether the body is {name}")
        return mask

    @cached_property
    @named
    def planes(self) -> HalfSpaces:
        """The planes of another engine."""
        names = str(self.info.get("plane_names", "")).splitlines()
        normal = [self.info.get(f"plane_normal.{k}") for k in range(len(names))]
        offset = [self.info.get(f"plane_offset.{k}") for k in range(len(names))]
        if None in offset or any(each is None for each in normal):
            raise DamageError("it does not state where its planes are")
        return HalfSpaces(names, np.array(normal, dtype=np.float64).reshape(-1, 3), np.array(offset, np.float64))

    @property
    def shear(self) -> Shear | None:
        """The shear of the periodic box; None without one."""
        info = self.info
        if "shear.rate" not in info:
            return None
        try:
            return Shear(rate=float(info["shear.rate"]), flow=info["shear.flow"], gradient=info["shear.gradient"])
        except (KeyError, ValueError) as error:
            raise DamageError("it does not state how its box is sheared") from error

    def cell(self, time: float) -> FloatArray | None:
        """Return the size of the periodic box, (3,) m; if sheared, the vectors to its images, (3, 3) m; or None."""
        if "box" not in self.info:
            return None
        size = np.asarray(self.info["box"], dtype=np.float64)
        return self.shear.cell(size, time) if self.shear else size

    def present(self, step: int) -> BoolArray:
        """Return a mask (n,) of the bodies that exist in the frame of a step, and do not wait to enter."""
        if self.info.get("admits"):
            return self._drawn_at(step)
        if self.lives is None:
            return np.ones(int(self.info["bodies"]), dtype=bool)
        first, last = self.lives.T
        return np.asarray((first >= 0) & (first <= step) & (step <= last))

    def present_in(self, state: Checkpoint | Frame) -> BoolArray:
        """Return a mask (n,) of the bodies that exist in an exact state, and do not wait to enter."""
        return self.present(state.step) if (waits := state.waits) is None else ~waits

    def _drawn_at(self, step: int) -> BoolArray:
        """Return a mask (n,) of the bodies that are drawn in the frame of a step; without such a frame, all bodies."""
        n = int(self.info["bodies"])
        drawn = np.ones(n, dtype=bool)
        for chunk in self.chunks(self.store.frames_of(paths.BODIES, step, step)):
            rows = np.flatnonzero(chunk.batch[STEP].to_numpy() == step)
            centres = centres_of(chunk)
            if len(rows) and centres is not None:
                places = plain(centres).to_numpy().reshape(chunk.batch.num_rows, -1, 3)[rows[0]]
                drawn[:] = False
                drawn[self.shown] = np.isfinite(places).all(axis=1)
        return drawn

    @cached_property
    @named
    def impact_steps(self) -> IntArray:
        """Steps of all recorded impacts, in order of their numbers."""
        chunks = self.chunks(self.store.frames_of(paths.IMPACTS))
        return np.concatenate([np.empty(0, np.int64), *(chunk.batch[STEP].to_numpy() for chunk in chunks)])

    @named
    def given_bodies(self, index: int, row: int, place: range) -> BodyColumns:
        """Return the initial bodies of one [[bodies]] table; see `carom.recording.read.statics`."""
        return decode_bodies(self._given_state, index, row, place, self.bodies)

    @cached_property
    @named
    def checkpoint_times(self) -> dict[int, float]:
        """Simulated times (s) of the checkpoints by step, ascending; the first one of a clip may precede its frames."""
        table = self._entities.table(paths.CHECKPOINT, CHECKPOINT_TIMES)
        times = {int(self._start[STEP][0]): float(self._start["time"][0])} if self._start else {}
        rows = zip(table[STEP].to_pylist(), table["time"].to_pylist(), strict=True)
        times |= {int(step): float(time) for step, time in rows}
        return dict(sorted(times.items()))

    @property
    def checkpoint_steps(self) -> list[int]:
        """Steps that carry an exact checkpoint, ascending."""
        return list(self.checkpoint_times)

    def temporal_chunks(self) -> Iterator[Chunk]:
        """Read all chunks that are not static, unchanged."""
        return self.chunks([entry for entry in self.store.entries if not entry.is_static])

    def layout(self) -> list[Chunk]:
        """Read the chunks of the layout with which the file opens; empty if there is none."""
        return self._entities.layout()

    @named
    def checkpoint(self, step: int) -> Checkpoint:
        """Decode the exact state at one of :attr:`checkpoint_steps`.

        Raises RecordingError if there is no checkpoint at this step, or if it is damaged: not finite, or different from
        its digest or from the fingerprint of its frame.
        """
        if isinstance(step, bool) or not isinstance(step, (int, np.integer)):
            known = f"give one of checkpoint_steps, such as {self.checkpoint_steps[:1]}"
            raise RecordingError(f"checkpoint {step!r}: {known}")
        return next(self.checkpoints([int(step)]))

    def moment(self, at: float | None = None) -> float:
        """Return the time (s) to show; see `Recording.moment`."""
        raise NotImplementedError

    def impacts(self, start: float | None = None, end: float | None = None, body: int | str | None = None) -> pa.Table:
        """Return the recorded impacts of an interval; see `Recording.impacts`."""
        raise NotImplementedError

    def checkpoints(self, steps: Iterable[int] | None = None) -> Iterator[Checkpoint]:
        """Yield exact states; see `Recording.checkpoints`."""
        raise NotImplementedError

    def summary(self) -> dict[str, Any]:
        """Return the summary; see `Recording.summary`."""
        raise NotImplementedError

    def bodies_at(self, at: float | None) -> pa.Table:
        """Return the state of all bodies at a time (s); see `BodyTable`."""
        raise NotImplementedError

    @cached_property
    def _given_state(self) -> dict[str, Values]:
        return self._entities.static(paths.GIVEN_STATE)

    @cached_property
    def _start(self) -> dict[str, Values]:
        return self._entities.static(paths.START, required=False)

    @cached_property
    def _fingerprints(self) -> pa.Table:
        return rising(self._entities.table(paths.FINGERPRINT, FINGERPRINTS))

    def _states(self, path: str) -> pa.Table:
        table = self._entities.table(path, STATES)
        return table.rename_columns([name.removeprefix("StateChange:") for name in table.column_names])

    def _series(self, root: str, names: tuple[str, ...]) -> pa.Table:
        """Return some or all scalars below an entity, for the frames that have all of these scalars.

        Scalars without rows are omitted: a killed run may have sent half a batch, and a repaired file may lack parts.
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
    """Return the rows of frames. Raises DamageError if the times of the frames do not rise."""
    times = fingerprints["time"].to_numpy()
    if not np.isfinite(times).all() or np.any(np.diff(times) < 0.0):
        raise DamageError("times that do not increase")
    return fingerprints
