"""What the statistics are computed from: the frames, impacts, contacts and exact velocities of an interval.

The interval begins and ends with a frame, so that the time in which impacts are counted is exact. Impacts, contacts and
drawn positions are read from the recording. Velocities are known at checkpoints only. With ``replay``, impacts,
contacts and velocities are computed again.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import pyarrow as pa

from carom import Recording
from carom.arrays import BoolArray, FloatArray, IntArray
from carom.errors import RecordingError, SceneError
from carom.extend import (
    STEP,
    TIME,
    RecordedPositions,
    StepStatus,
    count_at,
    recorded_scene,
    start_of,
    tolerance,
)

Watcher = Callable[[StepStatus], None]

MOST_STATES = 64  # exact states of which velocities are used, and frames of which contacts are
MOST_VELOCITIES = 2_000_000  # in memory


class ImpactColumns(NamedTuple):
    """The impacts of an interval, in order of time."""

    step: IntArray  # (k,)
    time: FloatArray  # (k,) s
    i: IntArray  # (k,) i < j
    j: IntArray  # (k,) from n on: planes and walls
    point: FloatArray  # (k, 3) m
    normal: FloatArray  # (k, 3) from i to j
    speed: FloatArray  # (k,) m/s, at which they close
    impulse: FloatArray  # (k,) N s, along the normal


@dataclass(frozen=True)
class Interval:
    """An interval of a recording, from a frame to a frame."""

    recording: Recording
    step: IntArray  # (f,) of the frames
    time: FloatArray  # (f,) s
    replay: bool
    watch: Watcher

    @classmethod
    def of(cls, recording: Recording, start: float | None, end: float | None, replay: bool, watch: Watcher) -> Interval:
        """Choose the frames from one time to another (s), both included; by default all.

        Raises
        ------
        RecordingError
            If there is no frame, or the recording shows only some of its bodies.
        """
        recording.refuse_some_bodies()
        recording.require_frames()
        first, last = -np.inf if start is None else start, np.inf if end is None else end
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
        """Its first and last time, in the unit of the scene."""
        return self.recording.units.span(self.time[0], self.time[-1], TIME)

    @cached_property
    def box(self) -> FloatArray | None:
        """Size of the periodic box, (3,) m; None without one."""
        box = self.recording.info.get("box")
        return None if box is None else np.asarray(box, dtype=np.float64)

    @cached_property
    def moving(self) -> BoolArray:
        """Mask (n,) of the bodies that are not fixed."""
        first = next(iter(self.recording.checkpoint_times), None)
        try:
            scene = recorded_scene(self.recording)
        except (RecordingError, SceneError):  # of another engine: fixed bodies are its planes
            scene = None
        if scene is None or first is None:
            return np.ones(self.bodies, dtype=bool)
        return ~start_of(self.recording, scene, self.recording.checkpoint(first)).fixed

    @cached_property
    def positions(self) -> RecordedPositions:
        """Positions of the frames."""
        return RecordedPositions(self.recording)

    def require_contacts(self) -> None:
        """Raise RecordingError if no bodies can touch."""
        if not self.recording.info["collides"]:
            raise RecordingError("no bodies of this run can touch, so there are no contacts to measure")

    @cached_property
    def _impact_table(self) -> pa.Table:
        self.require_contacts()
        if self.duration == 0.0:
            raise RecordingError("impacts are counted between frames, and the interval has only one")
        return self.recording.impacts(self.time[0], self.time[-1], replay=self.replay, watch=self.watch)

    @cached_property
    def impacts(self) -> ImpactColumns:
        """The impacts after the first frame.

        Raises
        ------
        RecordingError
            If there are none.
        """
        table = self._impact_table
        step = table[STEP].to_numpy()
        table = table.filter(pa.array((step > self.step[0]) & (step <= self.step[-1])))
        if table.num_rows == 0:
            raise RecordingError(f"there are no impacts from {self.text}")
        point, normal = (
            np.stack([table[name].to_numpy() for name in names], axis=1)
            for names in (("x", "y", "z"), ("nx", "ny", "nz"))
        )
        step, time, i, j, speed, impulse = (
            table[name].to_numpy() for name in (STEP, "time", "i", "j", "approach_speed", "normal_impulse")
        )
        return ImpactColumns(step, time, i, j, point, normal, speed, impulse)

    @cached_property
    def impacts_left_out(self) -> int:
        """Number of impacts of the interval that are not in `impacts`."""
        if self.replay or not self.recording.records_contacts:
            return int((self._impact_table.schema.metadata or {}).get(b"left_out", b"0"))
        first, last = (count_at(self.recording, int(step)) for step in self.step[[0, -1]])
        return max(0, last - first - len(self.impacts.step))

    def chosen(self, count: int) -> IntArray:
        """Return evenly spaced rows of the frames, the last one among them; frame 0 only if it is the only one."""
        rows = np.flatnonzero(self.step > 0) if self.step[-1] > 0 else np.zeros(1, np.int64)
        places = np.linspace(len(rows) - 1, 0, min(count, len(rows))).round().astype(np.int64)
        return np.asarray(rows[places[::-1]])

    @cached_property
    def velocities(self) -> FloatArray:
        """Exact velocities of some moments of the interval, (k, n, 3) m/s."""
        most = max(1, min(MOST_STATES, MOST_VELOCITIES // self.bodies))
        if self.replay:
            window = self.recording.rerun(float(self.time[0]), watch=self.watch)
            return np.stack([state.velocity for state in window.states(self.step[self.chosen(most)].tolist())])
        known = [step for step in self.recording.checkpoint_times if self.step[0] <= step <= self.step[-1]]
        known = [step for step in known if step > 0] or known
        if not known:
            state = self.recording.bodies(float(self.time[-1]))
            return np.stack([state[name].to_numpy() for name in ("vx", "vy", "vz")], axis=1)[None]
        places = np.unique(np.linspace(0, len(known) - 1, min(most, len(known))).round().astype(np.int64))
        return np.stack([self.recording.checkpoint(known[place]).velocity for place in places.tolist()])
