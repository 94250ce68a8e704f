"""The energy monitor: warns if the energy rises or its error is large.

A closed system cannot gain energy, so a gain is an error. A warning lists the contacts that may have caused the gain.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from carom.arrays import FloatArray
from carom.event import Event
from carom.physics.bodies import Bodies
from carom.physics.contact.pipeline import ContactPipeline
from carom.physics.diagnostics.ledger import FRICTION, RESTITUTION, STABILISATION
from carom.scene.integrators import Integrator
from carom.scene.units.dimension import ANGULAR_VELOCITY, ENERGY, LENGTH, TIME, VELOCITY, Dimension
from carom.scene.units.system import SI, UnitSystem
from carom.scene.wording import Names, counted
from carom.state.books import MonitorState
from carom.state.energies import Energy
from carom.state.frame import CollisionGraph

MOST_CONTACTS = 6  # largest number of contacts in a warning, in descending order of added energy
LOST = 0.1  # error relative to the energy scale, large enough to change the size and the period of an orbit
MOST_WARNINGS = 100  # largest number of warnings of rises in a run


@dataclass(frozen=True, slots=True)
class Suspects:
    """Copies of the contacts of one step, for a warning that may come a step later."""

    step: int
    graph: CollisionGraph
    contributions: Callable[[], FloatArray]  # returns each contact's energies, (m, 3) J
    velocity: FloatArray  # (n + p, 3) m/s, velocities
    angular_velocity: FloatArray | None  # (n + p, 3) rad/s, spins; None if nothing spins

    @classmethod
    def of(cls, step: int, contact: ContactPipeline, bodies: Bodies, spent: Suspects | None = None) -> Suspects:
        """Copy the values that the next step overwrites; velocities go into the arrays of ``spent``, if given."""
        ends = bodies.ends
        velocity = np.empty_like(ends.velocity) if spent is None else spent.velocity
        spin = None if spent is None else spent.angular_velocity
        velocity[:] = ends.velocity
        if len(bodies.angular_velocity):
            spin = np.empty_like(ends.angular_velocity) if spin is None else spin
            spin[:] = ends.angular_velocity
        return cls(step, contact.snapshots.snapshot.graph, contact.snapshots.keep_contributions(), velocity, spin)

    def describe(self, names: Names, units: UnitSystem) -> str:
        """List the contacts that added most energy, and the states of their bodies."""
        if len(self.graph) == 0:
            return f"No bodies were colliding in step {self.step}."
        ledger = self.contributions()
        added = ledger[:, STABILISATION] - ledger[:, (RESTITUTION, FRICTION)].sum(axis=1)
        lines = [f"Collisions in step {self.step}, {counted(len(self.graph), 'contact')}, sorted by added energy:"]
        lines += [self._contact(int(c), float(added[c]), names, units) for c in np.argsort(-added)[:MOST_CONTACTS]]
        return "\n".join(lines)

    def _contact(self, c: int, added: float, names: Names, units: UnitSystem) -> str:
        overlap, energy = units.text(self.graph.overlaps[c], LENGTH, ".3g"), units.text(added, ENERGY, "+.3g")
        lines = [f"  contact of overlap {overlap} added {energy}"]
        for body in self.graph.pairs[c]:
            text = f"    {names.of(int(body))}: v = {_vector(self.velocity[body], VELOCITY, units)}"
            if self.angular_velocity is not None:
                text += f", ω = {_vector(self.angular_velocity[body], ANGULAR_VELOCITY, units)}"
            lines.append(text)
        return "\n".join(lines)


class EnergyMonitor:
    """Checks the energy; warns of a rise, and of an integration error that makes the run useless.

    A rise is relative to the lowest energy since the last warning, so that any rate of checks detects a slow rise. A
    rise is reported if it exceeds ``tolerance`` times the energy scale. The remedy depends on the integrator.
    """

    def __init__(self, tolerance: float, names: Names, integrator: Integrator, units: UnitSystem = SI) -> None:
        self._tolerance = tolerance
        self._names = names
        self._remedy = _remedy(integrator)
        self._units = units
        self.tally = MonitorState()

    def check(
        self, step: int, time: float, energy: Energy, contact_gain: float, suspects: Callable[[], list[Suspects]]
    ) -> list[Event]:
        """Return the warnings of a check at a step.

        ``contact_gain`` is the largest energy that contact impulses have added so far, relative to the energy scale. A
        warning lists ``suspects()``, the contacts of the previous step and of this step. ``suspects`` is a function
        because copying contacts takes as long as the rest of a check, and warnings are rare.
        """
        tally = self.tally
        lowest = tally.lowest or energy
        now, least = energy.undamped, lowest.undamped
        rose = now - least > max(self._tolerance * energy.scale, energy.rounding)
        events = []

        def with_contacts(text: str) -> str:
            return "\n".join([text, *(step.describe(self._names, self._units) for step in suspects())])

        if rose and tally.warnings < MOST_WARNINGS:
            text = with_contacts(_rise(energy, lowest, tally.since, self._units))
            if tally.warnings + 1 == MOST_WARNINGS:
                text += f"\nThis is warning {MOST_WARNINGS}: further ones are not logged."
            events.append(Event(step, time, "WARN", text, "energy-rise"))
        gained = contact_gain > self._tolerance
        if gained and not tally.gained:
            text = with_contacts(_gain(energy, contact_gain, self._units))
            events.append(Event(step, time, "WARN", text, "energy-ledger"))
        lost = energy.relative_error > LOST
        if lost and not tally.lost:
            text = f"{_loss(energy, lowest, self._units)} {self._remedy}"
            events.append(Event(step, time, "WARN", text, "energy-lost"))
        if rose or tally.lowest is None or now < least:
            lowest, since = energy, time
        else:
            since = tally.since
        self.tally = MonitorState(lowest, since, tally.warnings + rose, tally.lost or lost, tally.gained or gained)
        return events


def _rise(energy: Energy, lowest: Energy, since: float, units: UnitSystem) -> str:
    """Return the text of a warning about a rise of the energy since a time (s), with the cause."""
    now, then = energy.ledger, lowest.ledger
    parts = {
        "stabilisation": now.stabilisation - then.stabilisation,
        "the integrator": energy.integration_error - lowest.integration_error,
        "impulses of contacts": then.restitution + then.friction - now.restitution - now.friction,
    }
    changes = {part: units.text(change, ENERGY, "+.4g") for part, change in parts.items() if change}
    shares = ", ".join(f"{change} from {part}" for part, change in changes.items())
    rise = energy.undamped - lowest.undamped
    return (
        f"Energy rose by {units.text(rise, ENERGY, '.4g')} ({energy.relative(rise):.2g} of the scale) since "
        f"t = {units.text(since, TIME)}: {shares}. Mostly {max(parts, key=lambda part: parts[part])}."
    )


def _loss(energy: Energy, lowest: Energy, units: UnitSystem) -> str:
    """Return the text of a warning about the error of the energy."""
    # if bodies have flown apart, their attraction is small
    pull = max(abs(energy.gravitational), abs(lowest.gravitational))
    what = "An orbit is lost" if pull > LOST * energy.scale else "The motion is wrong"
    error = energy.relative_error
    amount = f"{error:.0%} of" if error < 10.0 else f"{error:.2g} times"
    change = units.text(energy.integration_error, ENERGY, "+.4g")
    return f"{what}: integration has changed the total energy by {change}, {amount} the energy scale."


def _remedy(integrator: Integrator) -> str:
    """Return the sentence that says how to reduce the error of an integrator."""
    if integrator.hierarchical:
        return 'Use shorter steps (time.fixed_dt), or time.integrator = "gauss-radau15".'
    if integrator.controls_error:
        return (
            "Without time.fixed_dt the integrator chooses its steps by their error; remove it, or soften close "
            "encounters (gravity.softening)."
        )
    other = "" if integrator.order > 2 else ', or time.integrator = "yoshida4"'
    return f"Use shorter steps (time.target_dx, time.cfl or time.fixed_dt){other}."


def _gain(energy: Energy, contact_gain: float, units: UnitSystem) -> str:
    """Return the text of a warning about energy added by contact impulses."""
    ledger = energy.ledger
    restitution, friction = (units.text(taken, ENERGY, ".4g") for taken in (ledger.restitution, ledger.friction))
    return (
        f"Contact impulses have added energy, {contact_gain:.2g} of the energy scale, but they can only remove it: "
        f"so far restitution has removed {restitution} and friction {friction}."
    )


def _vector(values: FloatArray, dimension: Dimension, units: UnitSystem) -> str:
    numbers = ", ".join(f"{units.shown(value, dimension):.4g}" for value in values)
    return f"({numbers}) {units.unit(dimension)}".rstrip()
