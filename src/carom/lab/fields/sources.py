"""The data of fields: bodies and contacts at exact states, and impacts between these states, read or recomputed.

At its checkpoints, a recording has exact velocities, and the impulses of lasting contacts over the whole step. The
magnitude of friction covers the whole step; its direction comes from the last kick, which the exact state contains. For
the largest impacts, a recording has point, normal and normal impulse, but no direction of friction; for all impacts,
friction included, it has the sum of ℓ ⊗ J.
"""

from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np

from carom.arrays import BoolArray, FloatArray, IntArray, Records
from carom.contact_table import IMPACT_MODE
from carom.errors import RecordingError
from carom.lab.statistics import MOST_STATES, Interval, NothingThereError
from carom.physics.vector import minimum_images
from carom.recording.read.recorded_contacts import rows_of_engine
from carom.recording.timelines import STEP
from carom.runs.window import rerun

if TYPE_CHECKING:
    from carom.state.checkpoint import Checkpoint


class Pushes(NamedTuple):
    """Contacts with the impulses that they transfer."""

    i: IntArray  # (k,) i < j
    j: IntArray  # (k,) numbers ≥ n are planes and walls
    start: FloatArray  # (k, 3) m, the centre of i
    whole: FloatArray  # (k, 3) m, vector from that centre to the centre of j, or to the surface of a plane or wall
    impulse: FloatArray  # (k, 3) N s, impulse on j
    time: FloatArray  # (k,) s


class Collector(Protocol):
    """Receives the data of an interval."""

    def add_bodies(self, position: FloatArray, velocity: FloatArray, there: BoolArray, time: float) -> None:
        """Add bodies at a time (s): positions (m), velocities (m/s), both (n, 3), and a mask of existing ones, (n,)."""

    def add_contacts(self, pushes: Pushes, elapsed: float) -> None:
        """Add the lasting contacts of a step, whose impulses balance constant forces over a time (s).

        The bodies of this moment must have been added before.
        """

    def add_impacts(self, pushes: Pushes) -> None:
        """Add impacts."""

    def add_unplaced(self, virial: FloatArray, of: FloatArray) -> None:
        """Add Σ ℓ ⊗ J (J) of impacts with unknown places, given the sum over impacts with known places, (3, 3) each."""


def collect(interval: Interval, collector: Collector) -> None:
    """Give the data of an interval to a collector; raises RecordingError if it has no exact state."""
    (_replay if interval.replay else _read)(interval, collector)


def _read(interval: Interval, collector: Collector) -> None:
    recording, (first, last) = interval.recording, interval.step[[0, -1]].tolist()
    known = [step for step in recording.checkpoint_times if first <= step <= last]
    known = [step for step in known if step > 0] or known
    if not known:
        raise RecordingError(
            f"{recording.path} has no exact velocities from {interval.text}; choose a longer interval, or compute them "
            "again with --replay"
        )
    places = np.unique(np.linspace(0, len(known) - 1, min(MOST_STATES, len(known))).round().astype(np.int64))
    steps = np.array(known)[places].tolist()
    table = recording.steps("dt")
    lengths = dict(zip(table[STEP].to_pylist(), table["dt"].to_pylist(), strict=True))
    for state in recording.checkpoints(steps):
        there = recording.present_in(state)
        collector.add_bodies(state.position, state.velocity, there, state.time)
        if recording.records_contacts and recording.info["collides"]:
            dt = lengths.get(state.step, 0.0)
            pushes = _of_engine(interval, state) if recording.engine else _lasting(interval, state)
            collector.add_contacts(pushes, float(dt * interval.held_part(np.array([dt]))[0]) if dt > 0.0 else 0.0)
    if recording.engine or not recording.info["collides"] or interval.duration == 0.0:
        return  # contact forces of another engine include impacts
    try:
        rows = interval.impacts
    except NothingThereError:
        return
    whole = interval.arms(rows.i, rows.j)[:, None] * rows.normal
    start = rows.point - recording.bodies.radius[rows.i][:, None] * rows.normal
    impulse = rows.impulse[:, None] * rows.normal
    collector.add_impacts(Pushes(rows.i, rows.j, start, whole, impulse, rows.time))
    known = np.einsum("ka,kb->ab", whole, impulse)
    with suppress(RecordingError):  # raised if the recording lacks these sums
        collector.add_unplaced(interval.sums.virial - known, known)


def _replay(interval: Interval, collector: Collector) -> None:
    first, last = interval.step[[0, -1]].tolist()
    wanted = set(interval.step[interval.chosen(MOST_STATES)].tolist())
    window = rerun(interval.recording, float(interval.time[0]), contacts=True, watch=interval.watch)
    there = np.ones(interval.bodies, dtype=bool)
    for frame in window.frames(np.inf):
        if frame.impacts is not None and first < frame.step <= last:
            rows = frame.impacts
            centre = _vectors(rows, "xyz") - rows["arm_i"][:, None] * _vectors(rows, ("nx", "ny", "nz"))
            collector.add_impacts(_of_rows(rows, centre))
        if frame.step in wanted:
            collector.add_bodies(frame.position, frame.velocity, there, frame.time)
            if frame.contact_rows is not None and frame.dt > 0.0:
                rows = frame.contact_rows
                rows = rows[(rows["mode"] != IMPACT_MODE) & (rows["normal_impulse"] > 0.0)]
                elapsed = frame.dt * interval.held_part(np.array([frame.dt]))[0]
                collector.add_contacts(_of_rows(rows, frame.position[rows["i"]]), float(elapsed))
        if frame.step >= last:
            break


def _of_rows(rows: Records, centre: FloatArray) -> Pushes:
    """Convert rows of the contact table, (k,), given the centres of the bodies i, (k, 3) m."""
    normal = _vectors(rows, ("nx", "ny", "nz"))
    whole = (rows["arm_i"] + rows["arm_j"])[:, None] * normal
    impulse = rows["normal_impulse"][:, None] * normal + _vectors(rows, ("friction_x", "friction_y", "friction_z"))
    return Pushes(rows["i"].astype(np.int64), rows["j"].astype(np.int64), centre.copy(), whole, impulse, rows["time"])


def _lasting(interval: Interval, state: Checkpoint) -> Pushes:
    """Return the lasting contacts of the step that ends in an exact state."""
    table = interval.recording.contacts(state.time)
    force = np.nan_to_num(table["normal_force"].to_numpy())
    rows = np.flatnonzero(force > 0.0)
    i, j, size, friction = (table[name].to_numpy()[rows] for name in ("i", "j", "normal_impulse", "tangential_impulse"))
    normal = np.stack([table[name].to_numpy()[rows] for name in ("nx", "ny", "nz")], axis=1)
    impulse = size[:, None] * normal + friction[:, None] * _directions(state, i, j, interval.bodies)
    return _joined(interval, state, i, j, normal, impulse)


def _of_engine(interval: Interval, state: Checkpoint) -> Pushes:
    """Return the contacts of a frame in another engine's recording."""
    row = int(np.searchsorted(interval.recording.fingerprints()[STEP].to_numpy(), state.step))
    rows, _ = rows_of_engine(interval.recording, row)
    i, j, normal = rows["i"].astype(np.int64), rows["j"].astype(np.int64), _vectors(rows, ("nx", "ny", "nz"))
    impulse = rows["normal_impulse"][:, None] * normal + _vectors(rows, ("friction_x", "friction_y", "friction_z"))
    return _joined(interval, state, i, j, normal, impulse)


def _joined(
    interval: Interval, state: Checkpoint, i: IntArray, j: IntArray, normal: FloatArray, impulse: FloatArray
) -> Pushes:
    """Add to contacts the lines between the centres of their bodies, from the exact positions."""
    position = state.position
    whole, pair = interval.arms(i, j)[:, None] * normal, j < interval.bodies
    cell = interval.recording.cell(state.time)
    apart = position[j[pair]] - position[i[pair]]
    touching = whole[pair]  # vector to the image of j that touches i
    whole[pair] = touching + (apart - touching if cell is None else minimum_images(apart - touching, cell))
    return Pushes(i, j, position[i], whole, impulse, np.full(len(i), state.time))


def _directions(state: Checkpoint, i: IntArray, j: IntArray, bodies: int) -> FloatArray:
    """Return the directions of friction on j in the last kick, (k, 3); 0 where the contact had no friction."""
    found = np.zeros((len(i), 3))
    held = state.contacts
    if held is None:
        return found
    pairs, friction = [held.held_pairs], [held.impulse[:, 1:4]]
    if held.sleep is not None:
        pairs.append(held.sleep.pairs)
        friction.append(held.sleep.force[:, 1:4])
    both, last = np.concatenate(pairs), np.concatenate(friction)
    most = max(bodies, int(j.max(initial=0)), int(both.max(initial=0))) + 1
    keys, wanted = both[:, 0] * most + both[:, 1], i * most + j
    order = np.argsort(keys, kind="stable")
    place = np.minimum(np.searchsorted(keys[order], wanted), max(0, len(keys) - 1))
    if len(keys):
        own = order[place]
        size = np.linalg.norm(last[own], axis=1)
        there = (keys[own] == wanted) & (size > 0.0)
        found[there] = last[own][there] / size[there, None]
    return found


def _vectors(rows: Records, names: str | tuple[str, ...]) -> FloatArray:
    return np.stack([rows[name] for name in names], axis=1).astype(np.float64)
