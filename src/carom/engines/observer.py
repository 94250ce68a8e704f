"""`Observer`: makes frames of a recording from the states of another engine."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from carom.arrays import Records
from carom.engines.engine_contacts import (
    EngineMoment,
    Proximity,
    checked_contacts,
    rows_of_contacts,
    rows_of_graph,
    whole_numbers,
)
from carom.engines.faults import Fault, Tolerances
from carom.engines.law_audit import AuditFinding, LawAudit
from carom.engines.population import Present
from carom.engines.source import Setup, State, has_forces
from carom.errors import RecordingError
from carom.event import Event
from carom.physics.bodies import Bodies
from carom.physics.contact.statistics import ContactStatistics
from carom.physics.diagnostics.energy import EnergyAccount
from carom.physics.diagnostics.extremes import add_contacts, add_energy, add_momentum
from carom.physics.diagnostics.momentum import Momentum, MomentumAccount, TotalMotion
from carom.physics.diagnostics.run_monitor import Activity
from carom.physics.forces.gravity.direct import DirectGravity
from carom.physics.frame_store import FrameStore, copies
from carom.recording.schema.header import LARGEST, Header, Scalar
from carom.scene.forces import GRAVITY, UNIFORM_FIELD
from carom.scene.schema.settings import called
from carom.scene.start import InitialBodies
from carom.scene.units.system import SI, UnitSystem
from carom.scene.wording import Names, in_one_line
from carom.state.books import NOTHING, Books, Extreme, Extremes, MonitorState, PaceTally
from carom.state.energies import Energy, Ledger
from carom.state.frame import CollisionGraph, Frame

DT_LIMIT = "engine"  # the name of the limit of dt in recordings


class Observer:
    """Converts states to frames with energies, momenta, contacts and the faults found by the audit."""

    def __init__(
        self,
        setup: Setup,
        first: State,
        tolerances: Tolerances,
        units: UnitSystem = SI,  # units of the numbers, also in messages about faults
        present: Present | None = None,  # the bodies that exist, with the constants in ``setup``, if bodies come and go
    ) -> None:
        self.setup = setup
        self.units = units
        self.extremes = Extremes()
        self.names = Names(setup.names, setup.planes.name) if present is None else present.names
        self._ends = None if present is None else present.lasting_ends
        start = InitialBodies(
            name=setup.names,
            group=np.zeros(len(setup), dtype=np.int64),
            position=np.array(first.position, dtype=np.float64),
            velocity=np.array(first.velocity, dtype=np.float64),
            angular_velocity=np.array(first.angular_velocity if setup.spins else np.zeros((len(setup), 3)), np.float64),
            mass=setup.mass,
            radius=setup.radius,
            inertia=setup.inertia,
            fixed=setup.fixed,
        )
        self.bodies = Bodies.at_start(start, spins=setup.spins, orients=setup.turns)
        anchored = bool(setup.fixed.any()) or len(setup.planes) > 0
        self._energies = EnergyAccount(self.bodies, setup.gravity, anchored, spins_count=True)
        self._momenta = MomentumAccount(self.bodies, setup.gravity, bool(setup.box[0]), anchored)
        self._gravity = DirectGravity(setup.mass, setup.constant, setup.softening) if setup.constant else None
        self._proximity = Proximity(setup)
        self.audit = LawAudit(setup, tolerances, self.names, units, self._ends)
        self._tolerances = tolerances
        self._activity = Activity(len(setup), anchored or bool(setup.gravity.any()))
        self._ledger = Ledger()
        self._lowest_error, self._gain = 0.0, NOTHING
        self._error = 0.0  # J, integration error at the last frame
        self._pull: float | None = None  # J, gravitational energy at the last frame; None without gravity
        self._before: EngineMoment | None = None
        self._began = first.time
        self._last_time: float | None = None  # s, time of the last frame; None before the first frame

    def continued(self, present: Present, state: State) -> Observer:
        """Return the observer for the bodies that exist in and after a state.

        The change of energy since the previous frame is due to bodies that came or went; it is neither an error nor
        absorbed by contacts. Later momenta are compared with the momenta of this state.
        """
        new = Observer(present.setup, state, self._tolerances, self.units, present)
        new.extremes, new._ledger, new._last_time = self.extremes, self._ledger, self._last_time
        new._lowest_error, new._gain, new._error = self._lowest_error, self._gain, self._error
        new._activity.reopen(self._activity.phase, self._activity.impact_energy)
        new.audit.go_on(self.audit)
        return new

    def highlights(self) -> tuple[Event, ...]:
        """Return the extremes of the run as events, in order of time."""
        return self.extremes.highlights(self.names, self.units, energy_error="change of the energy without contact")

    def frame(self, step: int, state: State, store: FrameStore | None = None) -> Frame:
        """Return the frame of a state; states must be finite and in order of time."""
        self.bodies.position[:] = state.position
        self.bodies.velocity[:] = state.velocity
        if self.setup.turns:
            self.bodies.orientation[:] = state.orientation
        if self.setup.spins:
            self.bodies.angular_velocity[:] = state.angular_velocity
        bodies, before = self.bodies, self._before
        now = EngineMoment(
            state.time,
            bodies.position.copy(),
            bodies.velocity.copy(),
            bodies.angular_velocity.copy(),
            bodies.orientation.copy() if self.setup.turns else np.empty((0, 4)),
            *(np.empty((0, 3)) if given is None else np.array(given) for given in (state.force, state.torque)),
        )
        dt_known = self._last_time is not None
        dt = 0.0 if self._last_time is None else now.time - self._last_time
        potentials, pull = self._potentials()
        seen, contacts, rows = self._judge(step, before or now, now, state.contacts, pull)
        self._ledger = Ledger(restitution=self._ledger.restitution + seen.taken + seen.unjudged - seen.forced)
        motion = TotalMotion.of(self.bodies)
        energy = self._energies.balance(motion, potentials, self._ledger, roundings=step)
        baseline = self._energies.baseline
        assert baseline is not None, "the call above set it"
        if before is None and self._last_time is not None:  # bodies came or went
            baseline = replace(baseline, initial=baseline.initial + energy.integration_error - self._error)
            self._energies.baseline = baseline
            energy = self._energies.balance(motion, potentials, self._ledger, roundings=step)
        self._error = energy.integration_error
        momentum = self._momenta.balance(motion, now.time - self._began)
        if before is not None:
            self._activity.add_step(len(contacts), seen.struck)
            self._activity.judge(energy)
        events = self._see(step, now.time, energy, momentum, contacts, seen)
        self._before, self._pull, self._last_time = now, pull, now.time
        slot = None if store is None else store.keep()
        arrays = copies(self.bodies) if store is None or slot is None else store.kept(slot)
        position, velocity, acceleration, orientation, angular_velocity, _, _ = arrays
        return Frame(
            step=step,
            time=now.time,
            dt=dt,
            dt_limit=DT_LIMIT if dt_known else "start",
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
            books=Books(
                energy=baseline,
                momentum=self._momenta.baseline,
                watch=MonitorState(),
                moments=self.extremes.copy(),
                activity=self._activity.impact_energy,
                phase=self._activity.phase,
                limits=(),
                pace=PaceTally(),
            ),
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
        events = [fault.event for fault in faults]
        if len(contacts) and not self.extremes.total_contacts:
            pair = contacts.pairs[contacts.first]
            ends = pair if self._ends is None else self._ends[pair]
            text = f"First contact: {self.names.pair(ends.tolist())}."
            events.insert(0, Event(step, time, "INFO", text, "first-contact"))
        statistics = self._statistics(contacts, seen)
        # otherwise the frame has no extreme to name
        if statistics.contacts or statistics.impacts or statistics.deepest:
            add_contacts(self.extremes, step, time, statistics)
        # update the extremes of the energy; energy returned by soft contacts is not a gain
        extremes = self.extremes
        add_energy(extremes, step, time, energy)
        self._lowest_error = min(self._lowest_error, energy.integration_error)
        gain = energy.relative_change(energy.integration_error - self._lowest_error)
        self._gain = Extreme(gain, step, time) if gain > self._gain.value else self._gain
        extremes.energy_gain, extremes.contact_gain = self._gain, NOTHING
        add_momentum(self.extremes, step, time, momentum)
        return events

    def _potentials(self) -> tuple[dict[str, float], float | None]:
        """Return the potential energies by name, and the potential energy of the bodies' own gravity, in J."""
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
        setup, near, rows, reported = self.setup, self._proximity.between(before, now), None, None
        if setup.forces and known is not None:
            dt = now.time - (before.time if self._last_time is None else self._last_time)
            reported = self.named(known)
            rows = rows_of_contacts(reported, step, now.time, dt)
            contacts = self._proximity.graph_of_rows(rows, now.position)
        else:
            contacts = self._proximity.graph(near, None if known is None else self.named(known))
            if setup.forces:
                rows = rows_of_graph(contacts, now.position, setup.radius, step, now.time)
        potentials = None if pull is None else (pull if self._pull is None else self._pull, pull)
        found = AuditFinding() if before is now else self.audit.see(step, before, now, near, potentials, reported)
        judged = np.append(setup.judged, np.ones(len(setup.planes), bool))
        depth = np.where(judged[near.pairs].all(axis=1), -near.gap_now / near.small, 0.0)
        if len(depth) and depth.max() > 0.0:
            deepest = int(np.argmax(depth))
            found.deepest = float(depth[deepest])
            found.deepest_pair = int(near.pairs[deepest, 0]), int(near.pairs[deepest, 1])
        return found, contacts, rows

    def named(self, known: Any) -> Any:
        """Return the contacts that the engine reports, (m,) `CONTACT` or pairs (m, 2); refuse invalid contacts."""
        ends = len(self.setup) + len(self.setup.planes)
        if has_forces(known) or self.setup.forces:
            if not has_forces(known):
                raise RecordingError(f"{self.setup.engine}: contacts have no forces, and had some in the first state")
            records = checked_contacts(self.setup.engine, known, len(self.setup), ends)
            return records if self.setup.forces else np.stack([records["i"], records["j"]], axis=1)
        pairs = whole_numbers(self.setup.engine, "contacts", known)
        if pairs.size and (pairs.ndim != 2 or pairs.shape[1] != 2):
            raise RecordingError(f"{self.setup.engine}: contacts has the shape {pairs.shape} instead of (m, 2)")
        if pairs.size and not (pairs.min() >= 0 and pairs.max() < ends):
            wrong = pairs[(pairs < 0) | (pairs >= ends)][0]
            raise RecordingError(
                f"{self.setup.engine}: a contact has the number {wrong}; bodies and planes are 0 to {ends - 1}"
            )
        return pairs.reshape(-1, 2)

    def _statistics(self, contacts: CollisionGraph, seen: AuditFinding) -> ContactStatistics:
        pair, hardest = seen.deepest_pair, seen.hardest_pair
        if (ends := self._ends) is not None:
            pair, hardest = (int(ends[pair[0]]), int(ends[pair[1]])), (int(ends[hardest[0]]), int(ends[hardest[1]]))
        return ContactStatistics(
            work=np.zeros((0, 3)),
            contacts=len(contacts),
            impacts=seen.impacts,
            struck=seen.struck,
            hardest=seen.hardest,
            hardest_pair=hardest,
            deepest=seen.deepest,
            deepest_pair=pair,
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
    """Return the header of a recording of another engine; with ``exact``, every frame has the exact state."""
    forces = {GRAVITY.name: setup.constant != 0.0, UNIFORM_FIELD.name: bool(setup.gravity.any())}
    return Header(
        title=called(title),
        description=f"Recorded from {setup.engine}, which carom cannot rerun.",
        scene_toml=f"# Recorded from {in_one_line(setup.engine)}: there is no carom scene.\n",
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
        uniform_field=setup.gravity,
        exact=exact,
        gravity_constant=setup.constant,
        gravity_softening=setup.softening,
        fixed=setup.fixed if setup.fixed.any() else None,
        judged=None if setup.judged.all() else setup.judged,
    )


def not_finite(setup: Setup, step: int, state: State) -> Fault | None:
    """Return a fault for the first body whose state is not finite or would overflow; None if there is none."""
    for name in ("position", "velocity", "orientation", "angular_velocity"):
        values = getattr(state, name)
        if values is None:
            continue
        array = np.asarray(values, dtype=np.float64)
        wrong = ~(np.abs(array) <= LARGEST)
        if wrong.any():
            body, axis = (int(k) for k in np.argwhere(wrong)[0])
            called = Names(setup.names, []).of(body) if state.ids is None else f"the body with the id {state.ids[body]}"
            text = f"{name.replace('_', ' ').capitalize()} of {called} is {array[body, axis]:g} in component {axis}."
            return Fault("not-finite", step, state.time, float("inf"), text, (body,))
    return None
