"""Frames at the instants of impacts: bodies, edges and impulses at the instant, energies and spins before and after it.

These frames lie between two frames of the run, and have no step. Impulses, losses and normals belong to the impacts.
Other changes between the two frames are assumed to be linear in time: energies, spins, orientations.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import rerun as rr

from carom.arrays import BoolArray, FloatArray, IntArray, Records, SingleArray
from carom.contact_table import turning_impulses
from carom.physics.aligned import columns
from carom.physics.contact.rolling import ANGULAR_IMPULSE
from carom.physics.diagnostics.ledger import terms_of
from carom.recording.layout.drawing import single
from carom.recording.schema.header import Header
from carom.recording.schema.paths import IMPACT_SPINS
from carom.recording.write.impact_plan import orientations_at, positions_at
from carom.recording.write.rows import NO_STEPS, NO_TIMES, Index, Rows, any_column, plain_column, vector_column
from carom.state.checkpoint import Checkpoint
from carom.state.energies import Energy
from carom.state.frame import CollisionGraph, Frame

STEPPING = (  # the series that change at an impact, in the order of `Instant.energies`
    "energy/translational",
    "energy/rotational",
    "energy/total",
    "energy/ledger/restitution",
    "energy/ledger/friction",
)
_SPIN_ARROW = 1.3  # length of the faster spin's arrow, in radii of the smaller body
_SPIN_WIDTH = 0.04  # radius of the arrow, in radii of the smaller body
_BEFORE, _AFTER = 0x8A93A6FF, 0x5CE0B0FF


class Instant(NamedTuple):
    """The state at an impact."""

    number: int  # number of the impact, from 1 on
    end: float  # s, time of the next frame
    frame: Frame  # positions, contacts and impulses at the instant; nothing has a torque there
    energies: FloatArray  # (2, 5) J, `STEPPING` before and after all impacts of the instant
    bodies: IntArray  # (b,) bodies that meet: a single body if it meets a plane
    spins: FloatArray | None  # (2, b, 3) rad/s, spins before and after; None if spins are not modelled


def instants(
    header: Header,
    before: Frame | Checkpoint,
    frame: Frame,
    impacts: Records,
    chosen: IntArray,
    numbers: IntArray,
) -> list[Instant]:
    """Determine the state at some impacts between two frames.

    ``impacts`` are all impacts between the frames, `CONTACT_ROW`, in order of time. ``chosen``, (k,), are indices of
    the selected impacts, and ``numbers``, (k,), their numbers in the run.
    """
    box = np.zeros(3) if header.box is None else np.asarray(header.box, dtype=np.float64)
    times = impacts["time"][chosen]
    positions = positions_at(times, before, frame, impacts, header.radius, box, header.shear)
    orientations = orientations_at(times, before, frame)
    struck = _Jumps(header, before, frame, impacts)
    found = []
    for place, (k, number) in enumerate(zip(chosen.tolist(), numbers.tolist(), strict=True)):
        together = _together(impacts, k)
        instant = replace(
            frame,
            time=float(impacts["time"][k]),
            position=positions[place],
            orientation=None if orientations is None else orientations[place],
            torque=None,
            angular_acceleration=None,
            angular_impulse=struck.angular_impulse(together),
            contacts=_graph(impacts[together]),
            contact_rows=impacts[together],
            impacts=None,
            events=(),
            slot=None,
        )
        bodies = np.array([end for end in (impacts["i"][k], impacts["j"][k]) if end < header.bodies])
        found.append(Instant(number, frame.time, instant, struck.energies(k), bodies, struck.spins(k, bodies)))
    return found


def _together(impacts: Records, k: int) -> IntArray:
    """Return the indices of the impacts at the time of one impact, one per pair: the larger if a pair meets twice."""
    same = np.flatnonzero(impacts["time"] == impacts["time"][k])
    same = same[np.argsort(-impacts["normal_impulse"][same], kind="stable")]
    same = np.append(k, same)  # the first impact of a pair is kept
    _, first = np.unique(_pairs(impacts[same]), axis=0, return_index=True)
    return np.asarray(same[first])


def _graph(rows: Records) -> CollisionGraph:
    normals, none = np.stack([rows["nx"], rows["ny"], rows["nz"]], axis=1), np.zeros(len(rows), dtype=np.int64)
    return CollisionGraph(_pairs(rows), normals, np.zeros(len(rows)), none)


def _pairs(rows: Records) -> IntArray:
    return np.stack([rows["i"], rows["j"]], axis=1)


class _Jumps:
    """Energies and spins between two frames: jumps at impacts, and a remainder that is linear in time."""

    def __init__(self, header: Header, before: Frame | Checkpoint, frame: Frame, impacts: Records) -> None:
        self._time, self._ends = impacts["time"], (before.time, frame.time)
        self._pairs = _pairs(impacts)
        self._before, self._after = before, frame
        spins = before.angular_velocity is not None and frame.angular_velocity is not None
        self._turns = turns_of(impacts)  # (k, 2, 3) N m s, angular impulses on both ends
        self._turns[_still(header, before, frame, self._pairs)] = 0.0
        self._kicks = None  # (k, 2, 3) rad/s, changes of both spins
        if spins:
            self._kicks = self._turns / np.append(header.inertia, 1.0)[_ends(header, self._pairs)][:, :, None]
        terms = terms_of(impacts)
        rotational = np.zeros(len(impacts)) if self._kicks is None else self._gains(header)
        lost = terms[:, 0] + terms[:, 1] - terms[:, 2]
        # change by each impact, in the order of `STEPPING`
        self._jump = np.stack([-lost - rotational, rotational, -lost, terms[:, 0], terms[:, 1]], axis=1)

    def angular_impulse(self, which: IntArray) -> FloatArray:
        """Return the sum of the angular impulses of some impacts on each body, (n, 3) N m s."""
        found = np.zeros((len(self._after.position) + 1, 3))  # the last row is for planes
        np.add.at(found, np.minimum(self._pairs[which], len(found) - 1), self._turns[which])
        return found[:-1]

    def energies(self, k: int) -> FloatArray:
        """Return the energies before and after all impacts at the time of an impact, (2, 5) J."""
        earlier, until = self._time < self._time[k], self._time <= self._time[k]
        smooth = _between(
            self._part(self._time[k]), _terms(self._before.energy), _terms(self._after.energy) - self._jump.sum(axis=0)
        )
        return np.stack([smooth + self._jump[earlier].sum(axis=0), smooth + self._jump[until].sum(axis=0)])

    def spins(self, k: int, bodies: IntArray) -> FloatArray | None:
        """Return the spins of bodies before and after all impacts at the time of an impact, (2, b, 3) rad/s."""
        if self._kicks is None:
            return None
        assert self._before.angular_velocity is not None and self._after.angular_velocity is not None
        return self._sides(k, bodies, self._before.angular_velocity, self._after.angular_velocity, self._kicks)

    def velocities(self, k: int, bodies: IntArray, pushes: FloatArray) -> FloatArray:
        """Return velocities before and after an impact, (2, b, 3) m/s, given the changes of both ends, (k, 2, 3)."""
        return self._sides(k, bodies, self._before.velocity, self._after.velocity, pushes)

    def _sides(self, k: int, bodies: IntArray, first: FloatArray, last: FloatArray, kicks: FloatArray) -> FloatArray:
        """Return vectors of bodies before and after all impacts at the time of an impact, (2, b, 3)."""
        time = self._time[k]
        found = np.empty((2, len(bodies), 3))
        for place, body in enumerate(bodies.tolist()):
            own = self._pairs == body  # (k, 2)
            smooth = _between(self._part(time), first[body], last[body] - kicks[own].sum(axis=0))
            for side, past in enumerate((self._time < time, self._time <= time)):
                found[side, place] = smooth + kicks[own & past[:, None]].sum(axis=0)
        return found

    def _gains(self, header: Header) -> FloatArray:
        """Return the increase of the rotational energy in each impact, (k,) J."""
        assert self._kicks is not None
        assert self._before.angular_velocity is not None and self._after.angular_velocity is not None
        body = self._pairs.ravel()
        order = np.argsort(body, kind="stable")  # by body, then in order of time
        order = order[body[order] < header.bodies]
        body, kick, impact = body[order], self._kicks.reshape(-1, 3)[order], order // 2
        bodies, first, which, count = np.unique(body, return_index=True, return_inverse=True, return_counts=True)
        # the earlier kicks of each body, added one by one so that the bits equal the bits of `spins`
        earlier, rank = np.zeros_like(kick), np.arange(len(body)) - first[which]
        for k in range(1, int(count.max(initial=0))):
            later = np.flatnonzero(rank == k)
            earlier[later] = earlier[later - 1] + kick[later - 1]
        ends = first + count - 1
        start, last = self._before.angular_velocity[bodies], self._after.angular_velocity[bodies]
        last = last - (earlier[ends] + kick[ends])
        parts = np.array([self._part(time) for time in self._time.tolist()])[impact, None]
        spin = _between(parts, start[which], last[which]) + earlier
        gains, kicked = np.zeros(len(self._time)), (kick != 0.0).any(axis=1)
        # written as a sum of products, because the bits of a matrix product depend on the processor
        gain = header.inertia[body] * ((spin + 0.5 * kick) * kick).sum(axis=1)
        np.add.at(gains, impact[kicked], gain[kicked])
        return gains

    def _part(self, time: float) -> float:
        """Return the fraction of the interval that has passed at a time (s)."""
        start, end = self._ends
        return min(max((time - start) / (end - start), 0.0), 1.0)


def turns_of(impacts: Records) -> FloatArray:
    """Return the angular impulses of impacts, `CONTACT_ROW`, on both bodies, (k, 2, 3) N m s."""
    names = ("nx", "ny", "nz"), ("arm_i", "arm_j"), ("friction_x", "friction_y", "friction_z"), ANGULAR_IMPULSE
    return turning_impulses(*(columns(impacts, each) for each in names))


def velocities_at(
    header: Header, before: Frame | Checkpoint, frame: Frame, impacts: Records, k: int, bodies: IntArray
) -> FloatArray:
    """Return the velocities of bodies before and after the k-th impact between two frames, (2, b, 3) m/s."""
    names = ("nx", "ny", "nz"), ("friction_x", "friction_y", "friction_z")
    normal, friction = (columns(impacts, each) for each in names)
    impulse = impacts["normal_impulse"][:, None] * normal + friction  # impulse on the second body
    pairs = _pairs(impacts)
    mass = np.append(header.mass, np.inf)[_ends(header, pairs)]
    mass[(mass == 0.0) | _still(header, before, frame, pairs)] = np.inf
    pushes = np.stack([-impulse, impulse], axis=1) / mass[:, :, None]
    return _Jumps(header, before, frame, impacts).velocities(k, bodies, pushes)


def _still(header: Header, before: Frame | Checkpoint, frame: Frame, pairs: IntArray) -> BoolArray:
    """Return which ends (k, 2) of pairs are planes or bodies that do not move between two frames."""
    still = np.all((before.position == frame.position) & (before.velocity == 0.0) & (frame.velocity == 0.0), axis=1)
    return np.asarray(np.append(still, True)[_ends(header, pairs)])


def _ends(header: Header, pairs: IntArray) -> IntArray:
    """Return the ends (k, 2) of pairs, with one number for all planes."""
    return np.minimum(pairs, header.bodies)


def _between(part: float | FloatArray, first: FloatArray, last: FloatArray) -> FloatArray:
    return first + part * (last - first)


def _terms(energy: Energy) -> FloatArray:
    ledger = energy.ledger
    return np.array([energy.translational, energy.rotational, energy.total, ledger.restitution, ledger.friction])


def spin_rows(header: Header, found: Sequence[Instant], points: SingleArray) -> Iterable[Rows]:
    """Draw the spins of bodies that meet, with earlier spins in grey, on the timeline of impacts only."""
    spinning = [(one, places, one.spins) for one, places in zip(found, points, strict=True) if one.spins is not None]
    if not spinning:
        return
    vectors, origins = [], []
    for one, places, spins in spinning:
        fastest = float(np.sqrt((spins * spins).sum(axis=2)).max())
        vectors.append(_SPIN_ARROW * header.radius[one.bodies].min() / (fastest or 1.0) * spins.reshape(-1, 3))
        origins.append(np.tile(places[one.bodies], (2, 1)))
    each = np.array([len(one.bodies) for one, *_ in spinning])
    colours = np.concatenate([np.repeat(np.array([_BEFORE, _AFTER], np.uint32), count) for count in each])
    widths = single(np.repeat([_SPIN_WIDTH * header.radius[one.bodies].min() for one, *_ in spinning], 2 * each))
    arrows, at = single(np.concatenate(vectors)), single(np.concatenate(origins))
    bodies = np.concatenate([one.bodies for one, *_ in spinning]).astype(np.uint32)
    before, after = (single(np.concatenate([spins[side] for *_, spins in spinning])) for side in (0, 1))
    columns = [
        vector_column(rr.Arrows3D.descriptor_vectors(), arrows, 2 * each),
        vector_column(rr.Arrows3D.descriptor_origins(), at, 2 * each),
        plain_column(rr.Arrows3D.descriptor_colors(), colours, 2 * each),
        plain_column(rr.Arrows3D.descriptor_radii(), widths, 2 * each),
        any_column("bodies", bodies, each),
        any_column("before", before.ravel(), 3 * each),
        any_column("after", after.ravel(), 3 * each),
    ]
    numbers = np.array([one.number for one, *_ in spinning])
    yield Rows(IMPACT_SPINS, Index(NO_STEPS, NO_TIMES, numbers), columns)
