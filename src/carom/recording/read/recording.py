"""`Recording`: opens a recording of carom and reads from it; data are loaded when they are needed."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from functools import cached_property
from importlib.metadata import version as installed_version
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np
import pyarrow as pa

from carom.arrays import BoolArray, FloatArray, IntArray
from carom.errors import DamageError, RecordingError
from carom.recording.read.entities import CHECKPOINT_TIMES, Values, reading
from carom.recording.read.lookup import check_times, moment
from carom.recording.read.recorded_contacts import contacts
from carom.recording.read.recorded_impacts import impacts
from carom.recording.read.state_columns import BodyTrajectories
from carom.recording.read.statics import BodyTable, decode_bodies, decode_names, named
from carom.recording.read.summary import html_of, summary
from carom.recording.read.tables import FrameTables, bodies_at, checkpoints_at, trajectories, trajectory
from carom.recording.rrd.container import Container
from carom.recording.rrd.messages import RECORDING, Chunk, Store
from carom.recording.schema import paths
from carom.recording.schema.header import schema_version
from carom.recording.schema.paths import STEP
from carom.scene.data.body_columns import BodyColumns
from carom.scene.extensions import RELEASE
from carom.scene.schema.shear import Shear
from carom.scene.wording import counted

if TYPE_CHECKING:
    from carom.physics.checkpoint import Checkpoint


class Recording(FrameTables):
    """A recording on disk. Make one with :meth:`open`."""

    def __init__(self, container: Container, store: Store | None = None) -> None:
        if store is None:
            raise TypeError("Recording: open a file with Recording.open(path)")
        super().__init__(container, store)

    @classmethod
    def open(cls, path: str | Path) -> Self:
        """Open a file. RecordingError if it does not exist, is not a recording of carom, or has another schema."""
        path = Path(path)
        with reading(path):
            if not path.is_file():
                raise RecordingError(f"there is no recording at {path}")
            container = Container.open(path)
        store = next((store for store in container.stores if store.kind == RECORDING), None)
        if store is None:
            raise RecordingError(f"{path} holds no recording")
        recording = cls(container, store)
        recording.refuse_other_schema()
        return recording

    def refuse_other_schema(self) -> None:
        """Raise RecordingError if carom did not make it, or a version of carom that writes another schema did."""
        version = schema_version(self.store.application_id)
        if version is None:
            raise RecordingError(f"{self.path} was not made by carom, but by {self.store.application_id!r}")
        if version == paths.SCHEMA_VERSION:
            return
        writer = ""
        with suppress(RecordingError):  # the properties of another schema may differ
            writer = self.versions.get("carom", "")
        reader = "the version of carom that recorded it reads it"
        if RELEASE.fullmatch(writer) and writer != installed_version("carom"):
            reader = f"carom {writer}, which recorded it, reads it: `pip install carom=={writer}`"
        own = f"this carom reads version {paths.SCHEMA_VERSION} only"
        raise RecordingError(f"{self.path} has schema version {version}, and {own}; {reader}")

    @cached_property
    @named
    def bodies(self) -> BodyTable:
        """Names, groups, masses, radii and moments of inertia; ``bodies(at)`` returns their state at a time.

        In a clip of some bodies, the values of all others are NaN.
        """
        self.refuse_overlay()
        stored, n = self._entities.static(paths.STATIC_STATE), int(self.info["bodies"])
        n = len(self.shown) if self.is_partial else n
        names, groups = decode_names(stored), np.asarray(stored["group"])
        if len(names) != n or groups.shape != (n,) or groups.dtype != np.int64:
            raise DamageError(f"names or groups of its bodies are not those of {n} bodies")
        sizes = {name: np.asarray(stored[name]) for name in ("mass", "radius", "inertia")}
        for name, array in sizes.items():
            if array.shape != (n,) or array.dtype != np.float64 or not np.all((array >= 0.0) & np.isfinite(array)):
                raise DamageError(f"{name} of its bodies is not {n} numbers of at least 0")
        mass, radius, inertia = sizes.values()
        if not (radius.all() and (mass.any() or self.is_partial) and np.array_equal(mass > 0.0, inertia > 0.0)):
            raise DamageError("a radius, a moment of inertia or all masses of its bodies are 0")
        table = BodyTable(names, groups, mass, radius, inertia, lambda at: bodies_at(self, at))
        return table.among(self.shown, int(self.info["bodies"])) if self.is_partial else table

    @cached_property
    @named
    def lives(self) -> IntArray | None:
        """Steps (n, 2) of the first and the last frame with each body, where bodies came or went; otherwise None.

        Both numbers are -1 for a body without a frame.
        """
        stored = self._entities.static(paths.LIVES, required=False)
        if not stored:
            return None
        first, last = (np.asarray(stored[name]) for name in ("first_step", "last_step"))
        n = int(self.info["bodies"])
        if any(each.shape != (n,) or each.dtype != np.int64 for each in (first, last)):
            raise DamageError("it does not state for each body when it came and went")
        end = int(self.fingerprints()[STEP][-1].as_py()) if self.frames else -1
        return np.stack([first, np.where((first >= 0) & (last < 0), end, last)], axis=1)

    @cached_property
    @named
    def fixed(self) -> BoolArray:
        """Mask (n,) of the bodies that another engine never moves; a recording without it has none."""
        n = int(self.info["bodies"])
        stored = self._entities.static(paths.STATIC_STATE).get("fixed", np.zeros(n, np.bool_))
        mask = np.asarray(stored)
        if mask.shape != (n,) or mask.dtype != np.bool_:
            raise DamageError("it does not state for each body whether it is fixed")
        return mask

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
        """Return the size of the periodic box, (3,) m; of a sheared one, the vectors to its images, (3, 3); or None."""
        if "box" not in self.info:
            return None
        size = np.asarray(self.info["box"], dtype=np.float64)
        return self.shear.cell(size, time) if self.shear else size

    def present(self, step: int) -> BoolArray:
        """Return a mask (n,) of the bodies that exist in the frame of a step."""
        if self.lives is None:
            return np.ones(int(self.info["bodies"]), dtype=bool)
        first, last = self.lives.T
        return np.asarray((first >= 0) & (first <= step) & (step <= last))

    def trajectory(self, body: int | str, start: float = -np.inf, end: float = np.inf) -> pa.Table:
        """Return the path of one body, with one row per frame.

        Raises RecordingError if there is no such body or no frame in the interval.

        Parameters
        ----------
        body
            Its number or its name.
        start, end
            s, both included.

        Returns
        -------
        path
            Columns step, time (s), x, y, z (m), vx, vy, vz (m/s), with orientations qx, qy, qz, qw, with spins wx, wy,
            wz (rad/s), with the accelerations ax, ay, az (m/s², without contacts and drag), kinetic_energy and
            rotational_energy (J), and ``exact``: whether the row is in float64. Only rows of checkpoints are; the
            others have float32 positions and nulls elsewhere. `carom.rerun` computes all in float64. Fields have their
            unit as metadata; the metadata of the schema state the ``source``.
        """
        check_times(start=start, end=end)
        return trajectory(self, body, start, end)

    def trajectories(
        self, bodies: Sequence[int | str] | None = None, start: float = -np.inf, end: float = np.inf
    ) -> BodyTrajectories:
        """Return the paths of several bodies as arrays, such as ``position`` (frames, bodies, 3).

        Raises RecordingError if there is no such body or no frame in the interval.

        Parameters
        ----------
        bodies
            Their numbers or names; by default all bodies that the recording shows.
        start, end
            s, both included.

        Returns
        -------
        paths
            ``step``, ``time`` (s), ``body`` and ``exact`` as in `trajectory`, ``position`` (m), and ``vectors``, the
            arrays of all quantities by name: position, velocity (m/s) and, where they are modelled, orientation
            (xyzw), angular_velocity (rad/s) and energies (J). Between checkpoints, the recording has only positions,
            in float32; the other values are NaN. `carom.rerun` computes all of them in float64, with torques and
            angular accelerations. Bodies that do not exist in a frame are NaN.
        """
        check_times(start=start, end=end)
        return trajectories(self, bodies, start, end)

    def impacts(self, start: float | None = None, end: float | None = None, body: int | str | None = None) -> pa.Table:
        """Return the recorded impacts of an interval in order of time; numbers above 3.4e38 are infinite.

        A clip also holds the impacts of the step before its first frame. A clip of selected bodies holds only impacts
        among them or with planes. Raises RecordingError if there is no such body or it is not shown, no part of the
        interval is recorded, or no impacts are recorded; `carom.rerun` computes them all, in float64.

        Parameters
        ----------
        start, end
            s, both included; by default the whole recording.
        body
            Number or name of a body whose impacts are returned; by default all impacts.

        Returns
        -------
        impacts
            Columns step, time (s), i, j (ends; planes and walls from n on), x, y, z (m, the contact point), nx, ny, nz
            (from i to j), approach_speed (m/s), normal_impulse, tangential_impulse (N s), mode, energy_lost (J),
            normal_force, tangential_force (null: an impact has no force), angular_impulse_i, angular_impulse_j (N m s,
            |r × J| about the centre of each body; null without spins, and for planes and walls). The metadata of the
            schema state the ``source`` and how many impacts were ``left_out`` of the recording.
        """
        check_times(start=start, end=end)
        return impacts(self, start, end, body)

    def contacts(self, at: float | None = None) -> pa.Table:
        """Return the recorded contacts of the step that contains a time, by pair.

        Raises RecordingError if the time is not in the recording, or the step has no frame or no recorded contacts;
        `carom.rerun` computes them, in float64.

        Parameters
        ----------
        at
            s, by default the moment of `moment`.

        Returns
        -------
        contacts
            The columns of `impacts`; forces are impulses over the step. Point and normal are those at the end of the
            step or, for a pair that has separated by then, at its hardest impact. Recorded contacts have approach_speed
            and energy_lost only for impacts (null otherwise). They do not include contacts that held after the first
            kick but opened within the step. The metadata of the schema state the ``source``.
        """
        check_times(at=at)
        return contacts(self, at)

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

    @named
    def checkpoint(self, step: int) -> Checkpoint:
        """Decode the exact state at one of :attr:`checkpoint_steps`.

        Raises RecordingError if there is none at this step, or it is damaged: not finite, or different from its digest
        or from the fingerprint of its frame.
        """
        if isinstance(step, bool) or not isinstance(step, (int, np.integer)):
            known = f"give one of checkpoint_steps, such as {self.checkpoint_steps[:1]}"
            raise RecordingError(f"checkpoint {step!r}: {known}")
        return next(self.checkpoints([int(step)]))

    def checkpoints(self, steps: Iterable[int] | None = None) -> Iterator[Checkpoint]:
        """Yield the exact states at some of :attr:`checkpoint_steps`, by default at all, one by one.

        Chunks of the file contain several states. In ascending order of steps, each chunk is decoded once, which takes
        a fraction of the time of as many calls of `checkpoint`.
        """
        with reading(self.path):
            chosen = self.checkpoint_steps if steps is None else steps
            yield from checkpoints_at(self, self._start, chosen)

    @named
    def moment(self, at: float | None = None) -> float:
        """Return the time (s) to show: the given one, or that of the hardest impact, the most contacts, or the end.

        A closed run has recorded its hardest impact; otherwise the frames are searched. In a clip of some bodies, the
        impact of these bodies with the largest impulse counts. Raises RecordingError if there is no frame, or the given
        time is not in the recording.
        """
        check_times(at=at)
        return moment(self, at)

    @named
    def summary(self) -> dict[str, Any]:
        """Return the summary that `carom inspect` prints, as nested numbers and strings."""
        return summary(self)

    def __repr__(self) -> str:
        """Return the path, the numbers of bodies and frames, and the outcome of the run."""
        bodies = counted(int(self.info["bodies"]), "body")
        return f"<Recording {self.path}: {bodies}, {counted(self.frames, 'frame')}, {self.outcome}>"

    def _repr_html_(self) -> str:
        """Return the summary as a table, for notebooks."""
        return html_of(self)

    @cached_property
    def _given_state(self) -> dict[str, Values]:
        return self._entities.static(paths.GIVEN_STATE)

    @cached_property
    def _start(self) -> dict[str, Values]:
        return self._entities.static(paths.START, required=False)

    def temporal_chunks(self) -> Iterator[Chunk]:
        """Read all chunks that are not static, unchanged."""
        return self.chunks([entry for entry in self.store.entries if not entry.is_static])

    def layout(self) -> list[Chunk]:
        """Read the chunks of the layout with which the file opens; empty if there is none."""
        return self._entities.layout()
