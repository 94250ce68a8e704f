"""`Observer`: makes frames of a recording from the states of another engine."""

from __future__ import annotations

from typing import Any

import numpy as np

from carom.arrays import Records
from carom.errors import RecordingError
from carom.event import Event
from carom.physics.bodies import Bodies
from carom.physics.checkpoint import Books
from carom.physics.contact.graph import CollisionGraph
from carom.physics.contact.statistics import ContactStatistics
from carom.physics.diagnostics.energy import Energy, EnergyAccount
from carom.physics.diagnostics.energy_monitor import MonitorState
from carom.physics.diagnostics.extremes import NOTHING, Extreme, Extremes
from carom.physics.diagnostics.ledger import Ledger
from carom.physics.diagnostics.momentum import Momentum, MomentumAccount, TotalMotion
from carom.physics.diagnostics.run_monitor import Activity
from carom.physics.forces.gravity.direct import DirectGravity
from carom.physics.frame import Frame, FrameStore, copies
from carom.recording.schema.header import Header, Scalar
from carom.recording.schema.properties import LARGEST
from carom.recording.source.engine_contacts import checked_contacts, has_forces, rows_of_contacts, rows_of_graph
from carom.recording.source.law_audit import AuditFinding, Fault, LawAudit, Tolerances
from carom.recording.source.proximity import EngineMoment, Proximity
from carom.recording.source.source import Setup, State
from carom.scene.forces import GRAVITY, UNIFORM_FIELD
from carom.scene.schema.settings import called
from carom.scene.start import InitialBodies
from carom.scene.units.system import SI, UnitSystem
from carom.scene.wording import Names

DT_LIMIT = "engine"  # the recorded limit of dt


class Observer:
    """Converts states to frames with energies, momenta, contacts and the faults found by the audit.

    Parameters
    ----------
    setup
        The constants of the run.
    first
        The first state.
    tolerances
        Of the audit.
    units
        Of the numbers, and of the numbers in messages of faults.
    """

    def __init__(self, setup: Setup, first: State, tolerances: Tolerances, units: UnitSystem = SI) -> None:
        self.setup = setup
        self.units = units
        self.extremes = Extremes()
        self.names = Names(setup.names, setup.planes.name)
        self.bodies = Bodies.at_start(_start(setup, first), spins=setup.spins, orients=setup.turns)
        anchored = bool(setup.fixed.any()) or len(setup.planes) > 0
        self._energies = EnergyAccount(self.bodies, setup.gravity, anchored)
        self._momenta = MomentumAccount(self.bodies, setup.gravity, bool(setup.box[0]), anchored)
        self._gravity = DirectGravity(setup.mass, setup.constant, setup.softening) if setup.constant else None
        self._proximity = Proximity(setup)
        self.audit = LawAudit(setup, tolerances, self.names, units)
        self._activity = Activity(len(setup), anchored or bool(setup.gravity.any()))
        self._ledger = Ledger()
        self._lowest_error, self._gain = 0.0, NOTHING
        self._pull: float | None = None  # J, gravitational energy at the last frame
        self._before: EngineMoment | None = None
        self._began = first.time

    def highlights(self) -> tuple[Event, ...]:
        """Return the extremes of the run as events, in order of time."""
        return self.extremes.highlights(self.names, self.units, energy_error="change of the energy without contact")

    def frame(self, step: int, state: State, store: FrameStore | None = None) -> Frame:
        """Return the frame of a state; states must be finite and in order of time."""
        self._take(state)
        now, before = self._moment(state), self._before
        dt = 0.0 if before is None else now.time - before.time
        potentials, pull = self._potentials()
        seen, contacts, rows = self._judge(step, before or now, now, state.contacts, pull)
        self._ledger = Ledger(restitution=self._ledger.restitution + seen.taken + seen.unjudged)
        motion = TotalMotion.of(self.bodies)
        energy = self._energies.balance(motion, potentials, self._ledger)
        momentum = self._momenta.balance(motion, now.time - self._began)
        if before is not None:
            self._activity.add_step(len(contacts), seen.struck)
            self._activity.judge(energy)
        events = self._see(step, now.time, energy, momentum, contacts, seen)
        self._before, self._pull = now, pull
        slot = None if store is None else store.keep()
        arrays = copies(self.bodies) if store is None or slot is None else store.kept(slot)
        position, velocity, acceleration, orientation, angular_velocity, _, _ = arrays
        return Frame(
            step=step,
            time=now.time,
            dt=dt,
            dt_limit=DT_LIMIT if before is not None else "start",
            position=position,
            velocity=velocity,
            acceleration=acceleration,
            orientation=orientation if self.setup.turns else None,
            angular_velocity=angular_velocity if self.setup.spins else None,
            torque=None,
            angular_acceleration=None,
            contacts=contacts,
            energy=energy,
            momentum=momentum.linear,
            angular_momentum=momentum.angular,
            sweeps=0,
            phase=self._activity.phase,
            events=tuple(events),
            previous_dt=dt,
            memory=None,
            books=self._books(),
            momentum_error=momentum.linear_error,
            angular_momentum_error=momentum.angular_error,
            slot=slot,
            contact_rows=rows,
        )

    def _see(
        self, step: int, time: float, energy: Energy, momentum: Momentum, contacts: CollisionGraph, seen: AuditFinding
    ) -> list[Event]:
        """Update the extremes of the run; return the events of the frame."""
        drift = self.audit.drifted(step, time, energy)
        faults = seen.faults if drift is None else [*seen.faults, drift]
        events = [*self._first_contact(step, time, contacts), *(fault.event for fault in faults)]
        statistics = self._statistics(contacts, seen)
        if statistics.contacts or statistics.impacts:  # otherwise there is no extreme to name
            self.extremes.add_contacts(step, time, statistics)
        # update the extremes of the energy; energy returned by soft contacts is not a gain
        extremes = self.extremes
        extremes.add_energy(step, time, energy)
        self._lowest_error = min(self._lowest_error, energy.integration_error)
        gain = energy.relative(energy.integration_error - self._lowest_error)
        self._gain = Extreme(gain, step, time) if gain > self._gain.value else self._gain
        extremes.energy_gain, extremes.contact_gain = self._gain, NOTHING
        self.extremes.add_momentum(step, time, momentum)
        return events

    def _take(self, state: State) -> None:
        """Copy a state into the bodies."""
        self.bodies.position[:] = state.position
        self.bodies.velocity[:] = state.velocity
        if self.setup.turns:
            self.bodies.orientation[:] = state.orientation
        if self.setup.spins:
            self.bodies.angular_velocity[:] = state.angular_velocity

    def _moment(self, state: State) -> EngineMoment:
        bodies = self.bodies
        return EngineMoment(state.time, bodies.position.copy(), bodies.velocity.copy(), bodies.angular_velocity.copy())

    def _potentials(self) -> tuple[dict[str, float], float | None]:
        """Return the potential energies by their names, and that of the bodies' own gravity, in J."""
        found: dict[str, float] = {}
        bodies, pull = self.bodies, None
        if self._gravity is not None:
            pull = self._gravity.accelerate(bodies.position, bodies.acceleration, potential=True)
            found[GRAVITY.potential] = pull or 0.0
        if self.setup.gravity.any():
            moving = np.where(self.setup.fixed, 0.0, self.setup.mass)
            found[UNIFORM_FIELD.potential] = -float(moving @ (bodies.position @ self.setup.gravity))
        return found, pull

    def _judge(
        self, step: int, before: EngineMoment, now: EngineMoment, known: Any, pull: float | None
    ) -> tuple[AuditFinding, CollisionGraph, Records | None]:
        setup, near, rows = self.setup, self._proximity.between(before, now), None
        if setup.forces and known is not None:
            rows = rows_of_contacts(self.named(known), step, now.time, now.time - before.time)
            contacts = self._proximity.graph_of_rows(rows, now.position)
        else:
            contacts = self._proximity.graph(near, None if known is None else self.named(known))
            if setup.forces:
                rows = rows_of_graph(contacts, now.position, setup.radius, step, now.time)
        potentials = None if pull is None else (pull if self._pull is None else self._pull, pull)
        if before is now:
            return AuditFinding(), contacts, rows
        return self.audit.see(step, before, now, near, potentials), contacts, rows

    def named(self, known: Any) -> Any:
        """Return the contacts that the engine reports, (m,) `CONTACT` or pairs (m, 2); refuse invalid ones."""
        ends = len(self.setup) + len(self.setup.planes)
        if has_forces(known) or self.setup.forces:
            if not has_forces(known):
                raise RecordingError(f"{self.setup.engine}: contacts have no forces, and had some in the first state")
            records = checked_contacts(self.setup.engine, known, len(self.setup), ends)
            return records if self.setup.forces else np.stack([records["i"], records["j"]], axis=1)
        pairs = np.asarray(known, dtype=np.int64)
        if pairs.size and (pairs.ndim != 2 or pairs.shape[1] != 2):
            raise RecordingError(f"{self.setup.engine}: contacts has the shape {pairs.shape} instead of (m, 2)")
        if pairs.size and not (pairs.min() >= 0 and pairs.max() < ends):
            wrong = pairs[(pairs < 0) | (pairs >= ends)][0]
            raise RecordingError(f"{self.setup.engine}: contacts names {wrong}; bodies and planes are 0 to {ends - 1}")
        return pairs.reshape(-1, 2)

    def _statistics(self, contacts: CollisionGraph, seen: AuditFinding) -> ContactStatistics:
        deepest, pair = 0.0, (0, 0)
        if len(contacts):
            radius = np.append(self.setup.radius, np.full(len(self.setup.planes), np.inf))
            judged = np.append(self.setup.judged, np.ones(len(self.setup.planes), bool))
            known = judged[contacts.pairs].all(axis=1)
            relative = contacts.overlaps / radius[contacts.pairs].min(axis=1)
            depth = np.where(known, np.maximum(relative, 0.0), 0.0)  # a small gap counts as contact
            worst = int(np.argmax(depth))
            deepest, pair = float(depth[worst]), (int(contacts.pairs[worst, 0]), int(contacts.pairs[worst, 1]))
        return ContactStatistics(
            work=np.zeros((0, 3)),
            contacts=len(contacts),
            impacts=seen.impacts,
            struck=seen.struck,
            hardest=seen.hardest,
            hardest_pair=seen.hardest_pair,
            deepest=deepest,
            deepest_pair=pair,
        )

    def _first_contact(self, step: int, time: float, contacts: CollisionGraph) -> list[Event]:
        if self.extremes.total_contacts or len(contacts) == 0:
            return []
        text = f"First contact: {self.names.pair(contacts.pairs[contacts.first].tolist())}."
        return [Event(step, time, "INFO", text, "first-contact")]

    def _books(self) -> Books:
        assert self._energies.baseline is not None, "the first frame sets it"
        return Books(
            energy=self._energies.baseline,
            momentum=self._momenta.baseline,
            watch=MonitorState(),
            moments=self.extremes.copy(),
            activity=self._activity.impact_energy,
            phase=self._activity.phase,
            limits=(),
        )


def header_of_source(
    setup: Setup,
    *,
    title: str,
    run_id: str,
    duration: float,
    exact: bool,
    properties: dict[str, Scalar],
    units: UnitSystem = SI,
) -> Header:
    """Return the header of a recording of another engine.

    Parameters
    ----------
    exact
        Whether every frame has the exact state.
    """
    forces = {GRAVITY.name: setup.constant != 0.0, UNIFORM_FIELD.name: bool(setup.gravity.any())}
    return Header(
        title=called(title),
        description=f"Recorded from {setup.engine}, which carom cannot rerun.",
        scene_toml=f"# Recorded from {setup.engine}: there is no carom scene.\n",
        seed=0,
        run_id=run_id,
        names=setup.names,
        group=np.zeros(len(setup), dtype=np.int64),
        mass=setup.mass,
        radius=setup.radius,
        inertia=setup.inertia,
        spins=setup.spins,
        has_orientation=setup.turns,
        has_torque=False,
        has_friction=setup.forces,
        forces=frozenset(name for name, there in forces.items() if there),
        collides=setup.collides,
        stabilises=False,
        body_colouring=False,
        duration=duration,
        shortest_dt_hint=setup.time_step,
        box=setup.box if setup.box[0] > 0.0 else None,
        planes=setup.planes if len(setup.planes) else None,
        properties=properties,
        units=units,
        record_impacts="auto" if setup.forces else "none",
        engine=setup.engine,
        exact=exact,
    )


def not_finite(setup: Setup, step: int, state: State) -> Fault | None:
    """Name the first body whose state is not finite or would overflow; None if there is none."""
    for name in ("position", "velocity", "orientation", "angular_velocity"):
        values = getattr(state, name)
        if values is None:
            continue
        array = np.asarray(values, dtype=np.float64)
        wrong = ~(np.abs(array) <= LARGEST)
        if wrong.any():
            body, axis = (int(k) for k in np.argwhere(wrong)[0])
            called = Names(setup.names, []).of(body)
            text = f"{name.replace('_', ' ').capitalize()} of {called} is {array[body, axis]:g} in component {axis}."
            return Fault("not-finite", step, state.time, float("inf"), text, (body,))
    return None


def _start(setup: Setup, first: State) -> InitialBodies:
    n = len(setup)
    return InitialBodies(
        name=setup.names,
        group=np.zeros(n, dtype=np.int64),
        position=np.array(first.position, dtype=np.float64),
        velocity=np.array(first.velocity, dtype=np.float64),
        angular_velocity=np.array(first.angular_velocity, dtype=np.float64) if setup.spins else np.zeros((n, 3)),
        mass=setup.mass,
        radius=setup.radius,
        inertia=setup.inertia,
        fixed=setup.fixed,
    )
