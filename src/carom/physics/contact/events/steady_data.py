"""The data of the stages in `steady_contacts`: the contacts of a step, rules, and memory for the next steps."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from carom.arrays import BoolArray, FloatArray, IntArray, RecordArray
from carom.physics.aligned import aligned_empty, words
from carom.physics.bodies import Bodies
from carom.physics.contact.constraints import ConstraintSystem
from carom.physics.contact.events.drift import EventDrivenDrift
from carom.physics.contact.events.trajectories import Neighbours, Trajectories
from carom.physics.contact.pipeline import ContactPipeline
from carom.physics.contact.records import ContactRecord
from carom.physics.contact.statistics import BLOCK_COUNTS, DEEP_OVERLAP, BlockCountsRecord
from carom.physics.jit.team import ALONE

Words = tuple[IntArray, ...]  # five arrays; see `SteadyContacts.words`


class SteadyRules(NamedTuple):
    """How contacts are resolved."""

    board: IntArray  # an empty array; this and the next two fields are arguments of `phases.run_job`
    addresses: IntArray
    kind: int
    most_sweeps: int
    lasts: bool  # whether contacts can be at rest
    loads: bool  # whether a force can press contacts together
    pushes: bool  # whether overlaps are corrected
    bends: bool  # whether a uniform field bends the paths of bodies
    anchored: bool  # whether something is fixed
    deepest: float  # ratio of overlap to smaller radius above which a run warns
    field: FloatArray  # (3,) m/s², the uniform field if it accelerates all bodies alike; otherwise zeros


class SteadyBuffers(NamedTuple):
    """Copies of the records at the beginning of a step, and workspaces."""

    saved: Words  # the words in `SteadyContacts.words` at the beginning of the step
    spins: FloatArray  # (n, 3) rad/s, spins at the beginning of the step; empty where nothing spins
    drifting_spins: FloatArray  # (n, 3) rad/s, spins after the first kick
    held: RecordArray[ContactRecord]  # (m,) the contacts that are held, before positions change
    held_words: IntArray  # the words of ``held``
    parent: IntArray  # (n + p,) parents of the ends in trees of islands, see `islands`
    largest: FloatArray  # (n + p,) m²/s⁴, |a|² of each end; at an island's root, the largest in the island
    flags: BoolArray  # (2,)
    counts: RecordArray[BlockCountsRecord]  # (1,)
    near: IntArray  # (n (n - 1) / 2, 2) pairs that may meet during the drift
    later: Neighbours  # the pairs in `near`, as the neighbours of each body


class SteadyContacts(NamedTuple):
    """The contacts of a step; the kernel runs only as long as the next steps have the same contacts."""

    system: ConstraintSystem
    holding: ConstraintSystem  # the same contacts, with the accelerations against which they are held before the drift
    trajectories: Trajectories
    rules: SteadyRules
    buffers: SteadyBuffers
    pairs: IntArray  # (m, 2), sorted
    place: IntArray  # (m,) index of each contact's record
    counts: IntArray  # (n + p,) number of contacts of each body and plane
    normals: FloatArray  # (m, 3) normals before the position correction
    words: Words  # words of the records `CONTACT`, `CONTACT_STATE` and `RECORDED`, the normals and the spins
    supported: FloatArray  # (n + p,) m/s², accelerations that contacts support; empty if no step depends on them
    spins: FloatArray  # (n, 3) rad/s, spins; empty where nothing spins
    mass: FloatArray  # (n,) kg
    inertia: FloatArray  # (n,) kg m²
    torque: FloatArray  # (n, 3) N m, torques; empty where none are modelled
    angular_acceleration: FloatArray  # (n, 3) rad/s², angular accelerations; empty where no torques are modelled

    @classmethod
    def of(
        cls, contact: ContactPipeline, bodies: Bodies, against: FloatArray | None, supported: FloatArray
    ) -> SteadyContacts:
        """Gather the contacts of the last step, and memory for the next ones.

        ``against`` are the accelerations against which contacts are held before the drift, (n + p, 3) m/s² (default:
        the bodies' accelerations).
        """
        solver, settings, event_drift = contact.solver, contact.settings, contact.part(EventDrivenDrift)
        assert event_drift is not None, "see `make` of `steady_steps`"
        system, normals, n = solver.system, solver.found_normals, len(bodies)
        ends, most = len(system.inverse_mass), n * (n - 1) // 2
        held, first = aligned_empty(len(normals), system.contacts.dtype), np.empty(n, dtype=np.int64)
        records = tuple(map(words, (system.contacts, system.states, system.recorded)))
        numbers = (*records, _words_of(normals), _words_of(bodies.angular_velocity))
        spins = np.empty_like(bodies.angular_velocity)
        rules = SteadyRules(
            board=ALONE,
            addresses=solver.code.addresses,
            kind=solver.code.kind,
            most_sweeps=contact.most_sweeps,
            lasts=contact.lasts,
            loads=contact.needs.resting.modelled,
            pushes=settings.stabilisation == "split",
            bends=bool(event_drift.bending.any()),
            anchored=event_drift.anchored,
            deepest=np.inf if settings.allow_overlap else DEEP_OVERLAP,
            field=event_drift.field,
        )
        buffers = SteadyBuffers(
            saved=(*map(np.empty_like, numbers[:-1]), _words_of(spins)),
            spins=spins,
            drifting_spins=np.empty_like(spins),
            held=held,
            held_words=words(held),
            parent=np.empty(ends, dtype=np.int64),
            largest=np.empty(ends),
            flags=np.empty(2, dtype=np.bool_),
            counts=np.empty(1, BLOCK_COUNTS),
            near=np.empty((most, 2), dtype=np.int64),
            later=Neighbours(first, first.copy(), np.empty(most, dtype=np.int64)),
        )
        placed = contact.contacts.pairs, contact.contacts.order.place, solver.counts, normals
        moments = (
            supported,
            bodies.angular_velocity,
            bodies.mass,
            bodies.inertia,
            bodies.torque,
            bodies.angular_acceleration,
        )
        holding = system if against is None else system._replace(acceleration=against)
        event_drift.bend_by(1.0)
        return cls(system, holding, event_drift.trajectories, rules, buffers, *placed, numbers, *moments)


def _words_of(numbers: FloatArray) -> IntArray:
    """Return a view of numbers as words of eight bytes."""
    return numbers.reshape(-1).view(np.int64)
