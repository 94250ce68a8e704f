"""The data of the statistics, from the frames of an interval.

The interval begins and ends with a frame, so that the length of time in which impacts are counted is exact. The
recording has impacts, contacts and drawn positions at frames, but exact velocities only at checkpoints. With
``replay``, impacts, contacts and velocities are computed again.

In a busy run, only the largest impacts have rows of their own. Each frame has sums over all impacts. Means and totals
come from these sums; only histograms need the rows.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from carom.arrays import BoolArray, FloatArray, IntArray, Records
from carom.contact_table import CONTACT_ROW, ImpactSums, PairSums
from carom.errors import RecordingError, SceneError
from carom.physics.simulation import StepStatus
from carom.recording.read.frame_rows import RecordedPositions
from carom.recording.read.lookup import tolerance
from carom.recording.read.recorded_contacts import closing_speeds, rows_by_frame
from carom.recording.read.recorded_impacts import count_at, sums_between
from carom.recording.read.recorded_scene import recorded_scene, start_of
from carom.recording.read.recording import Recording
from carom.recording.timelines import STEP
from carom.runs.window import rerun
from carom.scene.load import Scene
from carom.scene.units.dimension import TIME
from carom.scene.wording import command

Watcher = Callable[[StepStatus], None]

_POINT, _NORMAL, _VELOCITY = ("x", "y", "z"), ("nx", "ny", "nz"), ("vx", "vy", "vz")  # names of columns
MOST_STATES = 64  # largest number of exact states whose velocities are used
MOST_CONTACT_FRAMES = 32
MOST_VELOCITIES = 2_000_000  # largest number of velocities in memory, summed over these states
MOST_CONTACTS = 2_000_000  # largest number of bodies, summed over the frames whose contacts are used


class NothingThereError(RecordingError):
    """The interval has no impacts, or no lasting contacts."""


class ContactColumns(NamedTuple):
    """The lasting contacts that carry an impulse in the steps of selected frames."""

    moving: BoolArray  # (f, n) mask of the bodies that exist in each frame and are not fixed
    elapsed: float  # s, total length of the steps
    frame: IntArray  # (k,) index of each contact's frame, from 0
    i: IntArray  # (k,) i < j
    j: IntArray  # (k,) second body; numbers ≥ n are planes and walls
    normal: FloatArray  # (k, 3) unit vector from i to j
    impulse: FloatArray  # (k,) N s, impulse along the normal
    force: FloatArray  # (k,) N, force along the normal
    friction: FloatArray  # (k,) N, magnitude of friction


class ImpactColumns(NamedTuple):
    """The impacts of an interval, in order of time."""

    step: IntArray  # (k,)
    time: FloatArray  # (k,) s
    i: IntArray  # (k,) i < j
    j: IntArray  # (k,) second body; numbers ≥ n are planes and walls
    point: FloatArray  # (k, 3) m
    normal: FloatArray  # (k, 3) unit vector from i to j
    speed: FloatArray  # (k,) m/s, speed of approach
    impulse: FloatArray  # (k,) N s, impulse along the normal


@dataclass(frozen=True)
class Interval:
    """An interval of a recording, which begins and ends with a frame."""

    recording: Recording
    step: IntArray  # (f,) steps of the frames
    time: FloatArray  # (f,) s
    replay: bool
    watch: Watcher

    @classmethod
    def of(cls, recording: Recording, start: float | None, end: float | None, replay: bool, watch: Watcher) -> Interval:
        """Choose the frames between two times (s), both included; by default all frames."""
        recording.refuse_some_bodies()
        recording.require_frames()
        first, last = -np.inf if start is None else start, np.inf if end is None else end
        if first > last:
            asked = recording.units.span(first, last, TIME, "g")
            raise RecordingError(f"from {asked}: the end is before the start")
        frames = recording.fingerprints()
        time = frames["time"].to_numpy()
        inside = (time >= first - tolerance(first)) & (time <= last + tolerance(last))
        if not inside.any():
            raise RecordingError(f"{recording.path} has no frame from {recording.units.span(first, last, TIME, 'g')}")
        return cls(recording, frames[STEP].to_numpy()[inside], time[inside], replay, watch)

    @property
    def bodies(self) -> int:
        """Number of bodies."""
        return len(self.recording.bodies.mass)

    @property
    def duration(self) -> float:
        """Length of the interval, s."""
        return float(self.time[-1] - self.time[0])

    @property
    def text(self) -> str:
        """The first and the last time of the interval, in the unit of the scene."""
        return self.recording.units.span(self.time[0], self.time[-1], TIME)

    @cached_property
    def box(self) -> FloatArray | None:
        """Size of the periodic box, (3,) m; None if there is none."""
        box = self.recording.info.get("box")
        return None if box is None else np.asarray(box, dtype=np.float64)

    def refuse_shear(self, what: str) -> None:
        """Raise RecordingError in a sheared box."""
        if self.recording.shear is not None:
            raise RecordingError(f"{what} in a sheared box cannot be measured yet, since its images move")

    def _relative_to_flow(self, velocity: FloatArray, position: FloatArray) -> FloatArray:
        """Return velocities relative to the flow of a sheared box, (n, 3) m/s; unchanged without shear."""
        shear = self.recording.shear
        if shear is None:
            return velocity
        (flow, gradient), relative = shear.axes, velocity.copy()
        relative[:, flow] -= shear.rate * position[:, gradient]
        return relative

    @cached_property
    def moving(self) -> BoolArray:
        """Mask (n,) of the bodies that are not fixed."""
        first = next(iter(self.recording.checkpoint_times), None)
        if self.scene is None or first is None:
            return np.asarray(~self.recording.fixed)
        return ~start_of(self.recording, self.scene, self.recording.checkpoint(first)).fixed

    @cached_property
    def scene(self) -> Scene | None:
        """The scene; None if another engine made the run, or this version cannot read it."""
        try:
            return recorded_scene(self.recording)
        except (RecordingError, SceneError):
            return None

    @cached_property
    def positions(self) -> RecordedPositions:
        """Positions of the frames."""
        return RecordedPositions(self.recording)

    def _require_contacts(self) -> None:
        if not self.recording.info["collides"]:
            raise RecordingError("no bodies of this run can touch, so there are no contacts to measure")

    @cached_property
    def _impact_table(self) -> tuple[pa.Table, ImpactSums | None]:
        """The impacts that have rows, and the sums over all impacts (None if unknown)."""
        first, last = self.step[[0, -1]].tolist()
        if self.recording.records_contacts and not self.replay:
            table = self.recording.impacts(self.time[0], self.time[-1])
            return table, sums_between(self.recording, first, last)
        begin, end = self.time[0] - tolerance(self.time[0]), self.time[-1] + tolerance(self.time[-1])
        window = rerun(self.recording, begin, contacts=True, watch=self.watch)
        table = window.impacts(begin, end)
        parts = [window.impact_sums.get(step) for step in self.step[1:].tolist()]
        return table, None if None in parts else ImpactSums.over(part for part in parts if part is not None)

    @cached_property
    def sums(self) -> ImpactSums:
        """Sums over all impacts after the first frame; `NothingThereError` if there are none.

        If the recording lacks sums, rows are summed; RecordingError if some impacts have no rows. Path lengths, the
        kinetic stress and the losses of pairs cannot be computed from rows, and are NaN. The virial lacks the
        contribution of friction.
        """
        known = self._sums
        if known is None:
            rows = self.impacts
            if left_out := self.impacts_left_out:
                raise RecordingError(
                    f"{left_out} of the {left_out + len(rows.step)} impacts were not recorded, and the recording has "
                    f"no sums over all of them; type `{self.command_again}`"
                )
            return self._sums_of(rows)
        if not known.impacts:
            raise NothingThereError(f"there are no impacts from {self.text}")
        return known

    @property
    def _sums(self) -> ImpactSums | None:
        """The sums in the recording or the replay; None if there are none."""
        if self.recording.engine or self.duration == 0.0:
            return None
        self._require_contacts()
        return self._impact_table[1]

    @property
    def kinetic(self) -> FloatArray | None:
        """Mean of Σ m c ⊗ c in the frames after the first, (3, 3) J; None if only exact states have velocities."""
        try:
            known = self._sums
        except RecordingError:
            return None
        return None if known is None else known.kinetic / (len(self.step) - 1)

    @property
    def command_again(self) -> str:
        """The command that computes all impacts again."""
        return command("contacts", self.recording.path, "--statistics", "--replay")

    def _sums_of(self, rows: ImpactColumns) -> ImpactSums:
        """Add up all impacts."""
        groups, group = np.unique(self.recording.bodies.group, return_inverse=True)
        group = np.append(group, len(groups))  # group of planes and walls
        ends = np.minimum(np.stack([rows.i, rows.j]), self.bodies)
        moves = np.append(self.moving, False)
        pairs, which, counts = np.unique(np.sort(group[ends], axis=0), axis=1, return_inverse=True, return_counts=True)
        unknown = np.full(len(counts), np.nan)
        speeds = np.bincount(which.ravel(), rows.speed, len(counts)).astype(np.float64)
        virial = self.arms(rows.i, rows.j) * rows.impulse
        return ImpactSums(
            impacts=float(len(rows.step)),
            collisions=float(np.count_nonzero(moves[ends])),
            speed=float(rows.speed.sum()),
            speed_square=float((rows.speed * rows.speed).sum()),
            largest_speed=float(rows.speed.max()),
            path=np.nan,
            virial_square=float((virial * virial).sum()),
            virial=np.einsum("k,ka,kb->ab", virial, rows.normal, rows.normal),
            kinetic=np.full((3, 3), np.nan),
            pairs=PairSums(pairs[0], pairs[1], counts.astype(np.float64), speeds, unknown, unknown),
        )

    def arms(self, i: IntArray, j: IntArray) -> FloatArray:
        """Return the distances between the centres of touching bodies, or of a body and a plane, (k,) m."""
        radius, pair = self.recording.bodies.radius, j < self.bodies
        return np.asarray(radius[i] + np.where(pair, radius[np.where(pair, j, 0)], 0.0))

    @cached_property
    def impacts(self) -> ImpactColumns:
        """The impacts after the first frame that have rows; `NothingThereError` if there are none."""
        self._require_contacts()
        if self.duration == 0.0:
            raise RecordingError("impacts are counted between frames, and the interval has only one")
        if self.recording.engine:
            return self._impacts_of_engine()
        table, _ = self._impact_table
        step = table[STEP].to_numpy()
        table = table.filter(pa.array((step > self.step[0]) & (step <= self.step[-1])))
        if table.num_rows == 0:
            raise NothingThereError(f"there are no impacts from {self.text}")
        names = (STEP, "time", "i", "j", "approach_speed", "normal_impulse")
        step, time, i, j, speed, impulse = (table[name].to_numpy() for name in names)
        return ImpactColumns(step, time, i, j, _vectors(table, _POINT), _vectors(table, _NORMAL), speed, impulse)

    def _impacts_of_engine(self) -> ImpactColumns:
        """Return the impacts of another engine's run: contacts that begin between bodies that approach each other.

        A contact begins in a frame if its pair has no contact in the frame before. Its approach speed follows
        from the exact states of the previous frame, since an engine may resolve an impact over several steps.
        """
        recording, steps = self.recording, self.step.tolist()
        if not recording.records_contacts:
            raise RecordingError(
                f"forces of contacts, which show impacts, are not in this recording of {recording.engine}"
            )
        if not set(steps) <= set(recording.checkpoint_times):
            raise RecordingError(
                "impacts in another engine need the exact state of every frame; record with exact=True"
            )
        none = np.empty(0, CONTACT_ROW)
        rows = {step: rows for step, _, rows in rows_by_frame(recording, steps[0], steps[-1])}
        found, speeds, touching = [none], [np.empty(0)], _pairs(rows.get(steps[0], none))
        states = recording.checkpoints(steps)
        before = next(states)
        for after in states:
            contacts = rows.get(after.step, none)
            speed = closing_speeds(contacts, before)
            pairs = _pairs(contacts)
            begins = ~np.isin(pairs, touching) & (contacts["normal_impulse"] > 0.0) & (speed > 0.0)
            # one row per pair, since a pair may have several points of contact
            _, first = np.unique(pairs[begins], return_index=True)
            kept = np.flatnonzero(begins)[np.sort(first)]
            found.append(contacts[kept])
            speeds.append(speed[kept])
            touching, before = pairs, after
        table, step = np.concatenate(found), np.repeat(steps, [len(each) for each in found])
        if len(table) == 0:
            raise NothingThereError(f"there are no impacts from {self.text}")
        i, j = table["i"].astype(np.int64), table["j"].astype(np.int64)
        point, normal, speed = _vectors(table, _POINT), _vectors(table, _NORMAL), np.concatenate(speeds)
        return ImpactColumns(
            step, table["time"], i, j, point, normal, speed, table["normal_impulse"].astype(np.float64)
        )

    @cached_property
    def impacts_left_out(self) -> int:
        """Number of impacts of the interval that have no rows in `impacts`."""
        if self.recording.engine:
            return 0
        table, sums = self._impact_table
        if sums is not None:
            return int(sums.impacts) - len(self.impacts.step)
        if self.replay or not self.recording.records_contacts:
            return int((table.schema.metadata or {}).get(b"left_out", b"0"))
        first, last = (count_at(self.recording, int(step)) for step in self.step[[0, -1]])
        return max(0, last - first - len(self.impacts.step))

    @property
    def contacts(self) -> ContactColumns:
        """The lasting contacts of some frames, without impacts; raises `NothingThereError` if there are none."""
        self._require_contacts()
        if self.recording.engine and not self.recording.records_contacts:
            raise RecordingError(f"forces of contacts are not in this recording of {self.recording.engine}")
        if not len(self._contacts.i):
            raise NothingThereError(f"there are no lasting contacts from {self.text}")
        return self._contacts

    @cached_property
    def _contacts(self) -> ContactColumns:
        rows = self.chosen(max(1, min(MOST_CONTACT_FRAMES, MOST_CONTACTS // self.bodies)))
        times = self.time[rows].tolist()
        if self.replay or not self.recording.records_contacts:
            window = rerun(self.recording, times[0], contacts=True, watch=self.watch)
            tables = [window.contacts(time) for time in times]
        else:
            tables = [self.recording.contacts(time) for time in times]
        table = pa.concat_tables(
            [each.append_column("frame", pa.array(np.full(each.num_rows, k))) for k, each in enumerate(tables)]
        )
        table = table.filter(pc.and_(pc.is_valid(table["normal_force"]), pc.greater(table["normal_impulse"], 0.0)))
        normal = _vectors(table, _NORMAL)
        names = ("normal_impulse", "normal_force", "tangential_force")
        impulse, force, friction = (table[name].to_numpy() for name in names)
        frame, i, j = (table[name].to_numpy() for name in ("frame", "i", "j"))
        steps = self.recording.steps("dt")
        dt = steps["dt"].to_numpy()[np.isin(steps[STEP].to_numpy(), self.step[rows])]
        held = self.held_part(dt)
        force, friction = force / held[frame], friction / held[frame]
        moving = np.stack([self.moving & self.recording.present(int(step)) for step in self.step[rows]])
        return ContactColumns(moving, float((dt * held).sum()), frame, i, j, normal, impulse, force, friction)

    def held_part(self, dt: FloatArray) -> FloatArray:
        """Return the impulse that balances a constant force in steps dt (s), divided by force times dt, (k,).

        Without drag, this ratio is 1. Drag removes a part of the momentum of the first kick, and the ratio is (h φ₂ +
        k₂)/h (docs/physics.md, section 6).
        """
        if self.scene is None or self.scene.drag is None:
            return np.ones(len(dt))
        z = dt / self.scene.drag.relaxation_time
        phi1 = -np.expm1(-z) / z
        phi2 = (1 - phi1) / z
        return np.asarray(phi2 + phi1 - np.exp(-z) * phi2 / phi1)

    def groups(self, among: BoolArray | None = None) -> list[tuple[str, BoolArray]]:
        """Return the name of each group of bodies, and a mask of its members among the given bodies (default: all).

        A group is named by the common beginning of its bodies' names, such as "molecule" for "molecule 17".
        """
        among = np.ones(self.bodies, dtype=bool) if among is None else among
        group, names = self.recording.bodies.group, self.recording.bodies.name
        found = []
        for number in np.unique(group[among]).tolist():
            own = np.flatnonzero(group == number)
            first, last = names[int(own[0])], names[int(own[-1])]
            name = first if len(own) == 1 else first.rstrip(" 0123456789")
            if not name or not last.startswith(name):
                name = "other bodies" if number < 0 else f"group {number}"
            found.append((name, (group == number)[among]))
        return found

    @cached_property
    def volume(self) -> float | None:
        """Volume of the periodic box or of the walls, m³; None if space is open along an axis."""
        if self.scene is None:
            return None if self.box is None else float(np.prod(self.box))
        size = None if "open" in self.scene.domain.axes else self.scene.domain.size
        return None if size is None else float(np.prod(size))

    @property
    def is_partly_empty(self) -> bool:
        """Whether bodies may be confined to a part of the volume, by planes, walls, or a field between walls."""
        scene = self.scene
        if scene is None:
            return False
        return bool(scene.plane or scene.wall or ("walls" in scene.domain.axes and any(scene.gravity.uniform)))

    def chosen(self, count: int) -> IntArray:
        """Return evenly spaced rows of the frames, including the last frame, and frame 0 only if there is no other."""
        rows = np.flatnonzero(self.step > 0) if self.step[-1] > 0 else np.zeros(1, np.int64)
        places = np.linspace(len(rows) - 1, 0, min(count, len(rows))).round().astype(np.int64)
        return np.asarray(rows[places[::-1]])

    @cached_property
    def velocities(self) -> FloatArray:
        """Exact velocities at k times, (k, n, 3) m/s, relative to the flow of a sheared box; NaN for absent bodies."""
        most = max(1, min(MOST_STATES, MOST_VELOCITIES // self.bodies))
        if self.replay:
            window = rerun(self.recording, float(self.time[0]), watch=self.watch)
            found = window.states(self.step[self.chosen(most)].tolist(), range(self.bodies))
            return np.stack([self._relative_to_flow(state["velocity"], state["position"]) for state in found])
        known = [step for step in self.recording.checkpoint_times if self.step[0] <= step <= self.step[-1]]
        known = [step for step in known if step > 0] or known
        if not known:
            last = float(self.time[-1])
            state = rerun(self.recording, last, watch=self.watch).bodies(last)
            return self._relative_to_flow(_vectors(state, _VELOCITY), _vectors(state, _POINT))[None]
        places = np.unique(np.linspace(0, len(known) - 1, min(most, len(known))).round().astype(np.int64))
        kept = self.recording.checkpoints(np.array(known)[places].tolist())
        return np.stack([self._relative_to_flow(state.velocity, state.position) for state in kept])


def _vectors(table: pa.Table | Records, names: tuple[str, str, str]) -> FloatArray:
    """Return three columns of a table as vectors, (k, 3)."""
    return np.stack([np.asarray(table[name], dtype=np.float64) for name in names], axis=1)


def _pairs(rows: Records) -> IntArray:
    """Return a number that identifies the pair of each contact, (k,)."""
    return np.asarray(rows["i"].astype(np.int64) << 32 | rows["j"].astype(np.int64))
