"""Contacts and impacts of another engine's recording, measured from the states of successive frames.

If the bodies that may have touched between two frames form a tree of at most three contacts, impulses follow from the
momenta (`single_contacts`). Each quantity has a value for each order of these contacts and each possible normal. The
table has the median of these values, and the largest deviation from it as the uncertainty. If isolated impacts of the
same materials agree best for one choice of normal and field, the table has the value of this choice. An impact of a
soft contact lasts for several frames: the first frame gives its approach, and the last frame its rebound.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any

import numpy as np
import pyarrow as pa

from carom.arrays import BoolArray, FloatArray, IntArray
from carom.contact_table import IMPACT_MODE, MODES, OPEN, SLIDING, STICKING
from carom.engines.engine_contacts import TOUCH, EngineMoment, Near, Proximity
from carom.engines.known_forces import KnownForces
from carom.engines.law_audit import still_speed
from carom.engines.missed_impacts import TUNNELLED
from carom.engines.rebounds import FEWEST
from carom.engines.single_contacts import WAYS, ContactTree, Measurement, trees_of
from carom.engines.source import Setup
from carom.errors import RecordingError
from carom.recording.read.lookup import interval, tolerance
from carom.recording.read.recorded_contacts import SCHEMA, SOURCE, table_of
from carom.recording.read.recording import Recording
from carom.state.checkpoint import Checkpoint

LEAD = 60  # number of frames before an interval that serve to measure the damping and the typical speed
# columns added to the columns of carom's contact table
COEFFICIENTS = ("restitution", "restitution_error", "friction", "friction_error")
MEASURED = "measured from the states of successive frames"
UNSOLVED = "unsolved"  # key in a table's metadata for impacts with unknown impulses


def setup_of(recording: Recording) -> Setup:
    """Return the constants of an engine's recording. RecordingError if the recording is a clip of selected bodies."""
    recording.refuse_some_bodies()
    bodies, info, planes = recording.bodies, recording.info, recording.planes
    box, field_ = info.get("box"), recording.uniform_field
    collides = bool(info["collides"])
    return Setup(
        engine=recording.engine,
        mass=bodies.mass,
        radius=bodies.radius,
        inertia=bodies.inertia,
        names=list(bodies.name),
        fixed=recording.fixed,
        judged=recording.judged,
        gravity=np.zeros(3) if field_ is None else field_,
        constant=float(info.get("gravity_constant", 0.0)),
        softening=float(info.get("gravity_softening", 0.0)),
        planes=planes,
        box=np.zeros(3) if box is None else np.asarray(box, dtype=np.float64),
        collides=collides,
        restitution=None,
        friction=None,
        touches=np.full(len(bodies.mass), collides),
        time_step=0.0,
        damping=None,
        angular_damping=None,
        spins=bool(info["spins"]),
        turns=bool(info["has_orientation"]),
        forces=recording.records_contacts,
    )


def smallest_gap(recording: Recording, state: Checkpoint) -> float:
    """Return the smallest gap (m) between neighbouring bodies or planes; inf if there are no neighbours."""
    there = np.asarray(np.isfinite(state.position).all(axis=1))
    bodies = _Bodies.of(recording, setup_of(recording), there)
    moment = bodies.moment(state)
    return float(bodies.proximity.between(moment, moment).gap_now.min(initial=np.inf))


@dataclass(slots=True)
class MeasuredFrame:
    """The contacts between two successive frames."""

    step: int
    time: float  # s
    dt: float
    ends: IntArray  # (n + p,) numbers, in the recording, of the existing bodies and of the planes
    near: Near
    closing: FloatArray  # (k,) m/s, closing speeds of near pairs before the frame
    slow: float  # m/s, largest speed of contacts at rest
    measured: dict[tuple[int, int], Measurement]  # measurements by the numbers of both ends in the recording

    def pair(self, row: int) -> tuple[int, int]:
        """Return the numbers in the recording of both ends of a near pair."""
        i, j = self.near.pairs[row]
        return int(self.ends[i]), int(self.ends[j])


def frames_of(recording: Recording, start: float, end: float) -> Iterator[MeasuredFrame]:
    """Yield the contacts between successive frames, from a few frames before ``start`` (s) up to ``end`` (s).

    Raises
    ------
    RecordingError
        If some of these frames have no exact state.
    """
    frames = recording.fingerprints()
    steps, times = frames["step"].to_numpy(), frames["time"].to_numpy()
    rows = np.flatnonzero((times >= start - tolerance(start)) & (times <= end + tolerance(end)))
    if not len(rows):
        return
    steps = steps[max(int(rows[0]) - 1 - LEAD, 0) : int(rows[-1]) + 1]
    if not set(steps.tolist()) <= recording.checkpoint_times.keys():
        raise RecordingError(
            f"{recording.path}: not all frames have exact states, so that impulses of contacts are unknown; record "
            "with exact=True"
        )
    whole, typical = setup_of(recording), 0.0
    bodies: _Bodies | None = None
    for before, after in pairwise(recording.checkpoints(steps.tolist())):
        there = np.asarray(np.isfinite(before.position + after.position).all(axis=1))
        if bodies is None or not np.array_equal(bodies.there, there):
            bodies = _Bodies.of(recording, whole, there)
        moving = after.velocity[there & ~whole.fixed]
        if len(moving):
            typical = max(typical, float(np.sqrt(np.mean(np.einsum("ij,ij->i", moving, moving)))))
        yield bodies.between(before, after, typical)


@dataclass(slots=True)
class _Bodies:
    """The bodies that exist in two successive frames."""

    there: BoolArray  # (n,)
    setup: Setup
    ends: IntArray  # (k + p,)
    proximity: Proximity
    forces: KnownForces

    @classmethod
    def of(cls, recording: Recording, whole: Setup, there: BoolArray) -> _Bodies:
        names = ("mass", "radius", "inertia", "fixed", "judged", "touches")
        setup = replace(whole, **{name: getattr(whole, name)[there] for name in names})
        planes = len(there) + np.arange(len(whole.planes))
        forces = KnownForces(setup)
        for damping, name in zip(forces.measured, ("damping", "angular_damping"), strict=True):
            for term in ("rate", "by_speed"):
                setattr(damping, term, float(recording.closing.get(f"audit.{name}.{term}", 0.0)))
        return cls(there, setup, np.concatenate((np.flatnonzero(there), planes)), Proximity(setup), forces)

    def between(self, before: Checkpoint, after: Checkpoint, typical: float) -> MeasuredFrame:
        moments = self.moment(before), self.moment(after)
        near, dt = self.proximity.between(*moments), after.time - before.time
        first = self.forces.applied(*moments, near)
        slow = still_speed(self.setup, typical, dt) + 2.0 * self.setup.field_strength * dt
        normal = near.normals_of_touch(len(self.setup))
        closing = -np.einsum("ij,ij->i", near.relative_before, normal)
        found: dict[tuple[int, int], Measurement] = {}
        seen = MeasuredFrame(after.step, after.time, dt, self.ends, near, closing, slow, found)
        for rows in trees_of(self.setup, near, closing, dt):
            tree = ContactTree(self.setup, first, moments[1], near, rows)
            for k, row in enumerate(rows.tolist()):
                found[seen.pair(row)] = tree.measured(k)
        return seen

    def moment(self, state: Checkpoint) -> EngineMoment:
        """Return a recorded state of these bodies."""
        given = state.angular_velocity, state.orientation
        spin, orientation = (np.empty((0, 3)) if each is None else each[self.there] for each in given)
        none = np.empty((0, 3))
        return EngineMoment(
            state.time, state.position[self.there], state.velocity[self.there], spin, orientation, none, none
        )


@dataclass(slots=True)
class _Impact:
    """An impact from its first frame on."""

    first: MeasuredFrame
    pair: tuple[int, int]
    parts: list[Measurement] = field(default_factory=list)

    @property
    def parting(self) -> float:
        """Speed of separation after the last frame so far, in m/s."""
        return float(np.median(self.parts[-1].parting))

    @property
    def ways(self) -> FloatArray:
        """The possible restitution coefficients, (`WAYS`,), of an isolated impact in one frame; otherwise empty."""
        one = self.parts[0]
        isolated = len(self.parts) == 1 and len(one.closing) == WAYS and bool((one.closing > self.first.slow).all())
        return np.asarray(one.parting / one.closing if isolated else np.empty(0))

    def row(self, way: int | None) -> dict[str, Any]:
        """Return the impact's row of the table, computed with the engine's usual normal and field if they are known."""
        one, last = self.parts[0], self.parts[-1]
        normal, tangential = (
            sum((np.median(getattr(part, name)) for part in self.parts), 0.0) for name in ("normal", "tangential")
        )
        closes = one.closing > self.first.slow
        first, parting = one.closing[closes], last.parting
        # the values of one frame are in the order of its contacts
        e, e_error = _spread(parting[closes] / first if len(self.parts) == 1 else np.divide.outer(parting, first))
        mu, mu_error = _spread(
            np.concatenate([part.tangential / np.maximum(part.normal, part.least) for part in self.parts])
        )
        if way is not None and len(known := self.ways):
            e, mu = float(known[way]), float(one.tangential[way] / max(one.normal[way], one.least))
        if len(self.parts) > 1:
            mu = float(tangential / normal) if normal > 0.0 else np.nan
        noise = sum(part.least for part in self.parts)
        approach = float(np.median(first))
        e_error += noise * one.ease / approach
        slides = float(np.median(last.slip)) > self.first.slow
        return {
            "step": self.first.step,
            "time": self.first.time,
            "i": self.pair[0],
            "j": self.pair[1],
            **dict(zip("xyz", one.point.tolist(), strict=True)),
            **dict(zip(("nx", "ny", "nz"), one.direction.tolist(), strict=True)),
            "approach_speed": approach,
            "normal_impulse": float(normal),
            "tangential_impulse": float(tangential),
            "mode": MODES[SLIDING if slides else STICKING],
            "energy_lost": float(sum(np.median(part.lost) for part in self.parts)),
            "restitution": max(e, 0.0) if self.parting > -self.first.slow else None,
            "restitution_error": e_error if self.parting > -self.first.slow else None,
            "friction": mu,
            "friction_error": mu_error + noise / max(float(normal), noise),
        }


def _way_of(impacts: list[_Impact], bodies: int) -> int | None:
    """Return the choice of normal and field for which coefficients of the same materials agree best."""
    groups: dict[int, list[FloatArray]] = {}
    for impact in impacts:
        if len(ways := impact.ways):
            # one group for each plane, one for pairs of bodies
            groups.setdefault(max(impact.pair[1] - bodies, -1), []).append(ways)
    known = [np.array(group) for group in groups.values() if len(group) >= FEWEST]
    if not known:
        return None
    return int(np.argmin(sum(np.abs(group - np.median(group, axis=0)).sum(axis=0) for group in known)))


def _spread(values: FloatArray) -> tuple[float, float]:
    """Return the median of values, and their largest deviation from it."""
    middle = float(np.median(values))
    return middle, float(np.abs(values - middle).max())


def measured_impacts(recording: Recording, start: float | None = None, end: float | None = None) -> pa.Table:
    """Return the impacts of an interval (s), as `Recording.impacts` does, with `COEFFICIENTS`.

    Impacts in clusters whose impulses are unknown have no row; the metadata have the number of such impacts under
    `UNSOLVED`.
    """
    first, last = interval(recording, start, end)
    found, unsolved = list[_Impact](), 0
    going: dict[tuple[int, int], _Impact] = {}
    for frame in frames_of(recording, first, last):
        began, going = going, {}
        for pair, part in frame.measured.items():
            size, known = float(np.median(part.normal)), began.pop(pair, None)
            if known is not None and known.parting > frame.slow:
                found.append(known)
                known = None
            if size <= 2.0 * part.least or (known is None and not _hits(frame, part)):
                if known is not None:
                    found.append(known)
                continue
            impact = known or _Impact(frame, pair)
            impact.parts.append(part)
            if abs(impact.parting) <= frame.slow and size * part.ease <= frame.slow:  # the contact is at rest
                found.append(impact)
            else:
                going[pair] = impact
        found += began.values()
        unsolved += sum(pair not in going for pair in _unsolved(frame))
    found += going.values()
    way = _way_of(found, len(recording.bodies.mass))
    rows = (impact.row(way) for impact in found)
    inside = [row for row in rows if first - tolerance(first) <= row["time"] <= last + tolerance(last)]
    inside.sort(key=lambda row: (row["step"], row["i"], row["j"]))
    return _table(inside, MEASURED, unsolved)


def _hits(frame: MeasuredFrame, part: Measurement) -> bool:
    """Return whether the closing speed and its change exceed the speed of contacts at rest."""
    changed = float(np.median(part.normal)) * part.ease
    return bool(part.closing.max() > frame.slow) and changed > frame.slow


def _unsolved(frame: MeasuredFrame) -> Iterator[tuple[int, int]]:
    """Yield the pairs that lost half of their closing speed in a cluster whose impulses are unknown."""
    near = frame.near
    touched = np.minimum(near.gap_before - frame.closing * frame.dt, near.gap_now) <= 0.0
    lost = (frame.closing > frame.slow) & (near.closing_now < TUNNELLED * frame.closing)
    for row in np.flatnonzero(touched & lost).tolist():
        if frame.pair(row) not in frame.measured:
            yield frame.pair(row)


def _table(rows: list[dict[str, Any]], source: str, unsolved: int = 0) -> pa.Table:
    """Return a table with the columns of a contact, and `COEFFICIENTS`."""
    columns = {name: [row.get(name) for row in rows] for name in (*SCHEMA.names, *COEFFICIENTS)}
    table = table_of({name: columns[name] for name in SCHEMA.names}, source)
    for name in COEFFICIENTS:
        table = table.append_column(pa.field(name, pa.float64()), pa.array(columns[name], pa.float64()))
    return table.replace_schema_metadata({SOURCE: source, UNSOLVED: str(unsolved)})


def measured_contacts(recording: Recording, at: float | None = None) -> pa.Table:
    """Return the contacts of the frame that contains a time (s), as `Recording.contacts` does.

    If the engine reports forces, the table has them; otherwise, impulses follow from the states. Approach speeds and
    losses always follow from the states. Bodies that touch although the engine reports no contact have a row, too.
    """
    moment = recording.moment(at)
    recorded: list[dict[str, Any]] = recording.contacts(moment).to_pylist() if recording.records_contacts else []
    frame = next(
        (each for each in frames_of(recording, moment, moment) if each.time >= moment - tolerance(moment)), None
    )
    if frame is None:
        return _table(recorded, "recorded" if recorded else MEASURED)
    near = frame.near
    places = {frame.pair(row): row for row in range(len(near))}
    for row in recorded:
        pair = row["i"], row["j"]
        if pair in places:
            row["approach_speed"] = max(float(frame.closing[places[pair]]), 0.0)
        if pair in frame.measured:
            row["energy_lost"] = float(np.median(frame.measured[pair].lost))
    known = {(row["i"], row["j"]) for row in recorded}
    touches = near.gap_now <= TOUCH * near.small
    rows = [
        _contact(frame, place, pair)
        for pair, place in places.items()
        if pair not in known and (touches[place] or _pressed(frame.measured.get(pair)))
    ]
    rows = sorted([*recorded, *rows], key=lambda row: (row["i"], row["j"]))
    source = f"recorded; approach and loss {MEASURED}" if recording.records_contacts else MEASURED
    return _table(rows, source)


def _pressed(part: Measurement | None) -> bool:
    return part is not None and abs(float(np.median(part.normal))) > 2.0 * part.least


def _contact(frame: MeasuredFrame, place: int, pair: tuple[int, int]) -> dict[str, Any]:
    """Return the row of a near pair, with the impulse between its two frames if it is known."""
    near, part = frame.near, frame.measured.get(pair)
    approach = max(float(frame.closing[place]), 0.0)
    direction = near.normal[place]
    row = {"step": frame.step, "time": frame.time, "i": pair[0], "j": pair[1], "mode": MODES[OPEN]}
    row |= {"approach_speed": approach} | dict(zip(("nx", "ny", "nz"), direction.tolist(), strict=True))
    if part is None:
        return row
    row |= dict(zip("xyz", part.point.tolist(), strict=True))
    normal, rubbed = (float(np.median(values)) for values in (part.normal, part.tangential))
    if not _pressed(part):
        normal = rubbed = 0.0
    elif approach > frame.slow and normal * part.ease > frame.slow:
        row["mode"] = MODES[IMPACT_MODE]
    else:
        row["mode"] = MODES[SLIDING if float(np.median(part.slip)) > frame.slow else STICKING]
        row |= {"normal_force": normal / frame.dt, "tangential_force": rubbed / frame.dt}
    return row | {
        "normal_impulse": normal,
        "tangential_impulse": rubbed,
        "energy_lost": float(np.median(part.lost)) if normal else 0.0,
    }
