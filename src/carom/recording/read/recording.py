"""`Recording`: opens a recording of carom and reads from it; data are loaded when they are needed."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from importlib.metadata import version as installed_version
from pathlib import Path
from typing import Any, Self

import numpy as np
import pyarrow as pa

from carom.errors import RecordingError
from carom.recording.read.entities import reading
from carom.recording.read.lookup import check_times, moment
from carom.recording.read.recorded_contacts import contacts
from carom.recording.read.recorded_data import RecordedData
from carom.recording.read.recorded_impacts import impacts
from carom.recording.read.state_columns import BodyTrajectories
from carom.recording.read.statics import named
from carom.recording.read.summary import html_of, summary
from carom.recording.read.tables import bodies_at, checkpoints_at, trajectories, trajectory
from carom.recording.rrd.container import Container
from carom.recording.rrd.messages import RECORDING, Store
from carom.recording.schema import paths
from carom.recording.schema.header import schema_version
from carom.scene.extensions import RELEASE
from carom.scene.wording import counted, in_one_line
from carom.state.checkpoint import Checkpoint


class Recording(RecordedData):
    """A recording on disk. :meth:`open` makes one."""

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
        """Raise RecordingError if carom did not make the file, or if carom made it with another schema."""
        version = schema_version(self.store.application_id)
        if version is None:
            raise RecordingError(f"{self.path} was not made by carom, but by {self.store.application_id!r}")
        if version == paths.SCHEMA_VERSION:
            return
        writer = ""
        with suppress(RecordingError):  # properties of another schema may differ
            writer = self.versions.get("carom", "")
        reader = "the version of carom that recorded it reads it"
        if RELEASE.fullmatch(writer) and writer != installed_version("carom"):
            reader = f"carom {writer}, which recorded it, reads it: `pip install carom=={writer}`"
        own = f"this carom reads version {paths.SCHEMA_VERSION} only"
        raise RecordingError(f"{self.path} has schema version {version}, and {own}; {reader}")

    def trajectory(self, body: int | str, start: float = -np.inf, end: float = np.inf) -> pa.Table:
        """Return the path of one body, with one row per frame.

        Raises RecordingError if there is no such body or no frame in the interval.

        Parameters
        ----------
        body
            Number or name of the body.
        start, end
            First and last time in s, both included.

        Returns
        -------
        path
            Columns step, time (s), x, y, z (m), vx, vy, vz (m/s), with orientations qx, qy, qz, qw, with spins wx, wy,
            wz (rad/s), with the accelerations ax, ay, az (m/s², without contacts and drag), kinetic_energy and
            rotational_energy (J), and ``exact``: whether the row is in float64. Only rows of checkpoints are exact;
            other rows have float32 positions, and nulls elsewhere. `carom.rerun` computes all rows in float64. Fields
            have their unit as metadata; the metadata of the schema state the ``source``.
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
            Numbers or names of bodies; by default all bodies that the recording shows.
        start, end
            First and last time in s, both included.

        Returns
        -------
        paths
            ``step``, ``time`` (s), ``body`` and ``exact`` as in `trajectory`, ``position`` (m), and ``vectors``, the
            arrays of all quantities by name: position, velocity (m/s) and, if they are modelled, orientation
            (xyzw), angular_velocity (rad/s) and energies (J). Between checkpoints, the recording has only positions,
            in float32; the other values are NaN. `carom.rerun` computes all of them in float64, with torques and
            angular accelerations. The values of bodies that do not exist in a frame are NaN.
        """
        check_times(start=start, end=end)
        return trajectories(self, bodies, start, end)

    def impacts(self, start: float | None = None, end: float | None = None, body: int | str | None = None) -> pa.Table:
        """Return the recorded impacts of an interval in order of time; numbers above 3.4e38 are infinite.

        A clip also holds the impacts of the step before its first frame. A clip of selected bodies holds only their
        impacts with each other and with planes. Raises RecordingError if there is no such body or it is not shown, no
        part of the interval is recorded, or no impacts are recorded; `carom.rerun` computes all impacts, in float64.

        Parameters
        ----------
        start, end
            First and last time in s, both included; by default the whole recording.
        body
            Number or name of a body whose impacts are returned; by default all impacts.

        Returns
        -------
        impacts
            Columns step, time (s), i, j (ends; planes and walls from n), x, y, z (m, the contact point), nx, ny, nz
            (from i to j), approach_speed (m/s), normal_impulse, tangential_impulse (N s), mode, energy_lost (J),
            normal_force, tangential_force (null: an impact has no force), angular_impulse_i, angular_impulse_j (N m s,
            |r × J| about the centre of each body; null without spins, and for planes and walls). The metadata of the
            schema state the ``source`` and the number of impacts ``left_out`` of the recording.
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
            Time in s, by default the time that `moment` returns.

        Returns
        -------
        contacts
            The columns of `impacts`; forces are impulses divided by the length of the step. Point and normal are given
            at the end of the step or, for a pair that has separated by then, at its hardest impact. Recorded contacts
            have approach_speed and energy_lost only for impacts (null otherwise). Contacts that were closed after the
            first kick and opened within the step are not recorded. The metadata of the schema state the ``source``.
        """
        check_times(at=at)
        return contacts(self, at)

    def checkpoints(self, steps: Iterable[int] | None = None) -> Iterator[Checkpoint]:
        """Yield the exact states at some of :attr:`checkpoint_steps`, by default at all of them, one by one.

        Chunks of the file contain several states. Steps in ascending order are fastest, because each chunk is then
        decoded only once; calls of `checkpoint` decode it each time.
        """
        with reading(self.path):
            chosen = self.checkpoint_steps if steps is None else steps
            yield from checkpoints_at(self, self._start, chosen)

    @named
    def moment(self, at: float | None = None) -> float:
        """Return the time (s) to show: the given time, or else the hardest impact, the most contacts, or the end.

        If bodies touch from the start and no impact is known, it is the time at which contacts have dissipated half of
        the energy that they dissipate in all. A run that closed its file has recorded the hardest impact; otherwise,
        the frames are searched. In a clip of selected bodies, the hardest impact is the impact with the largest impulse
        on these bodies. Raises RecordingError if there is no frame, or the given time is not in the recording.
        """
        check_times(at=at)
        return moment(self, at)

    @named
    def summary(self) -> dict[str, Any]:
        """Return the summary that `carom inspect` prints, as nested numbers and strings."""
        return summary(self)

    def bodies_at(self, at: float | None) -> pa.Table:
        """Return the state of all bodies at the end of the step that contains a time (s)."""
        return bodies_at(self, at)

    def __repr__(self) -> str:
        """Return the path, the numbers of bodies and frames, and the outcome of the run, or why they cannot be read."""
        try:
            bodies = counted(int(self.info["bodies"]), "body")
            text = f"{self.path}: {bodies}, {counted(self.frames, 'frame')}, {self.outcome}"
        except RecordingError as error:
            text = str(error)
        return f"<Recording {in_one_line(text)}>"

    def _repr_html_(self) -> str:
        """Return the summary as a table, for notebooks."""
        return html_of(self)
