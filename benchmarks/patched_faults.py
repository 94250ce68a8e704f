"""Faults planted in the engine while a context lasts, each in a scene of 200 to 500 bodies that shows it.

Compiled kernels cannot be patched, so a fault replaces the Python that calls them, or falsifies their results. Few
bodies take many steps in one kernel, which would skip such a fault, so every fault switches that kernel off.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import Any
from unittest.mock import patch

import numpy as np

from carom.physics import step as stepping
from carom.physics.bodies import Bodies
from carom.physics.contact.broad_phase.grid import HierarchicalGrid
from carom.physics.contact.events.drift import EventDrivenDrift
from carom.physics.contact.impact_log import Impacts
from carom.physics.contact.pipeline import ContactPipeline
from carom.physics.contact.solver.contact_solver import ContactSolver
from carom.physics.diagnostics.bookkeeper import BalanceAudit
from carom.physics.forces.drag import StokesDrag
from carom.physics.forces.force import TotalForce
from carom.physics.step import KickDriftStepper

Document = dict[str, Any]
Plant = Callable[[], dict[Any, dict[str, Any]]]  # returns the replacements: attributes of classes and modules

GAS: Document = {  # 300 spheres that spin and bounce in a periodic box
    "title": "Gas",
    "group": [
        {"count": 300, "radius": 0.5, "region": {"shape": "box", "size": [11, 11, 11]}, "velocity": {"dispersion": 1}}
    ],
    "gravity": {"constant": 0.0},
    "contact": {"restitution": 0.8, "static_friction": 0.3},
    "domain": {"boundary": "periodic", "size": [12, 12, 12]},
    "time": {"duration": 2.0},
}
PILE: Document = {  # 250 balls of two sizes that fall onto a floor between walls
    "title": "Pile",
    "group": [
        {
            "count": 250,
            "radius": {"min": 0.3, "max": 0.5},
            "region": {"shape": "box", "size": [6, 6, 9], "centre": [0, 0, 0]},
        }
    ],
    "gravity": {"constant": 0.0, "uniform": [0, 0, -9.81]},
    "contact": {"restitution": 0.3},
    "domain": {"boundary": "walls", "size": [6.5, 6.5, 10]},
    "time": {"duration": 1.0},
}
CLOUD: Document = {  # 200 boulders that collapse under their gravity
    "title": "Cloud",
    "group": [
        {"count": 200, "radius": 1.0, "mass": 1.0, "region": {"radius": 10}, "velocity": {"dispersion": 0.3}},
    ],
    "gravity": {"constant": 1.0},
    "contact": {"restitution": 0.5},
    "time": {"duration": 3.0},
}
UNLIKE: Document = CLOUD | {  # 200 boulders of several sizes
    "title": "Unlike boulders",
    "group": [CLOUD["group"][0] | {"count": 200, "radius": {"min": 0.5, "max": 1.2}}],
}
THICK: Document = CLOUD | {"title": "Thick air", "drag": {"relaxation_time": 2.0}}
ENERGY, MOMENTUM, SPIN = "energy.max_error > 1e-3", "momentum.max_error > 1e-8", "angular_momentum.max_error > 1e-8"
OVERLAP = "contacts.max_overlap > 0.1"
ERROR = "PhysicsError"


@dataclass(frozen=True, slots=True)
class Fault:
    """A fault: its name, the scene and the condition that show it, and its replacements."""

    name: str
    scene: Document
    condition: str
    plant: Plant

    @contextmanager
    def planted(self) -> Iterator[None]:
        """Plant the fault in this process while the context lasts."""
        with ExitStack() as stack:
            slow = {KickDriftStepper: {"advance": lambda self, goal: self._advance_once(goal)}}
            for place, names in (slow | self.plant()).items():
                for name, value in names.items():
                    stack.enter_context(patch.object(place, name, value))
            yield


def _ledger(change: Callable[[np.ndarray], np.ndarray]) -> Plant:
    """Change the ledger of contacts, (m, 3) J: restitution, friction, stabilisation."""
    book = BalanceAudit.book
    return lambda: {BalanceAudit: {"book": lambda self, work: book(self, change(np.array(work)))}}


def _resolve(spoil: Callable[[Bodies, np.ndarray, np.ndarray, np.ndarray], None]) -> Plant:
    """Falsify velocities after contacts were resolved, given bodies, pairs, and velocities and spins before."""
    resolve, drift = ContactPipeline.resolve, EventDrivenDrift._resolve

    def resolved(self: Any, *given: Any) -> None:
        velocity, spin = self.bodies.velocity.copy(), self.bodies.angular_velocity.copy()
        resolve(self, *given)
        pairs = self.contacts.pairs
        if len(pairs) and not np.array_equal(velocity, self.bodies.velocity):
            spoil(self.bodies, pairs, velocity, spin)

    def drifted(self: Any, *given: Any) -> Impacts:
        velocity, spin = self._bodies.velocity.copy(), self._bodies.angular_velocity.copy()
        impacts = drift(self, *given)
        if len(impacts):
            spoil(self._bodies, impacts.pairs, velocity, spin)
        return impacts

    return lambda: {ContactPipeline: {"resolve": resolved}, EventDrivenDrift: {"_resolve": drifted}}


def _inner(pairs: np.ndarray, bodies: Bodies) -> np.ndarray:
    """Return the pairs of two bodies, without planes."""
    return pairs[pairs[:, 1] < len(bodies)]


def _one_sided(bodies: Bodies, pairs: np.ndarray, velocity: np.ndarray, spin: np.ndarray) -> None:
    for i, j in _inner(pairs, bodies)[:1]:
        if bodies.radius[i] >= bodies.radius[j]:
            bodies.velocity[i] = velocity[i]


def _spin_lost(bodies: Bodies, pairs: np.ndarray, velocity: np.ndarray, spin: np.ndarray) -> None:
    for _, j in _inner(pairs, bodies):
        bodies.angular_velocity[j] = spin[j]


def _spin_reversed(bodies: Bodies, pairs: np.ndarray, velocity: np.ndarray, spin: np.ndarray) -> None:
    bodies.angular_velocity[:] = 2.0 * spin - bodies.angular_velocity


def _spin_of_the_next(bodies: Bodies, pairs: np.ndarray, velocity: np.ndarray, spin: np.ndarray) -> None:
    bodies.angular_velocity[:] = spin + np.roll(bodies.angular_velocity - spin, 1, axis=0)


def _too_much(bodies: Bodies, pairs: np.ndarray, velocity: np.ndarray, spin: np.ndarray) -> None:
    bodies.velocity[:] = velocity + 1.05 * (bodies.velocity - velocity)


def _along_z_only(bodies: Bodies, pairs: np.ndarray, velocity: np.ndarray, spin: np.ndarray) -> None:
    for i, _ in pairs[-1:]:
        if i < len(bodies):
            bodies.velocity[i, 0] = velocity[i, 0]


def _not_a_number(bodies: Bodies, pairs: np.ndarray, velocity: np.ndarray, spin: np.ndarray) -> None:
    ends, counts = np.unique(_inner(pairs, bodies), return_counts=True)
    if len(counts) and counts.max() >= 3:
        bodies.velocity[ends[np.argmax(counts)], 2] = np.nan


def _too_many(bodies: Bodies, pairs: np.ndarray, velocity: np.ndarray, spin: np.ndarray) -> None:
    if len(pairs) and np.unique(_inner(pairs, bodies), return_counts=True)[1].max(initial=0) >= 3:
        raise IndexError("index 3 is out of bounds for axis 0 with size 3")


def _pairs(choose: Callable[[Any, np.ndarray, np.ndarray], np.ndarray]) -> Plant:
    """Leave out some of the pairs that the broad phase finds."""
    pairs = HierarchicalGrid.pairs

    def some(self: Any, position: np.ndarray, *given: Any, **more: Any) -> np.ndarray:
        found = pairs(self, position, *given, **more)
        return np.ascontiguousarray(found[choose(self, position, found)])

    return lambda: {HierarchicalGrid: {"pairs": some}}


def _not_at_borders(self: Any, position: np.ndarray, pairs: np.ndarray) -> np.ndarray:
    """Miss pairs across a border between cells of 2.5 m."""
    cells = np.floor(position[:, 0] / 2.5)
    return np.asarray(cells[pairs[:, 0]] == cells[pairs[:, 1]])


def _not_the_last(self: Any, position: np.ndarray, pairs: np.ndarray) -> np.ndarray:
    """Miss the last pair of each list of three or more."""
    return np.arange(len(pairs)) < (len(pairs) - 1 if len(pairs) >= 3 else len(pairs))


def _after(name: str, spoil: Callable[[np.ndarray, np.ndarray, float], None]) -> Plant:
    """Falsify the result of a kick or a drift, given its rate of change and dt."""
    right = getattr(stepping, name)

    def spoilt(changed: np.ndarray, rate: np.ndarray, dt: float, *given: Any) -> None:
        right(changed, rate, dt, *given)
        spoil(changed, rate, dt)

    return lambda: {stepping: {name: spoilt}}


def _first_kicked_backwards(velocity: np.ndarray, acceleration: np.ndarray, dt: float) -> None:
    fast = int(np.argmax(np.abs(acceleration).max(axis=1)))
    velocity[fast] -= 2.0 * acceleration[fast] * dt


def _first_kicked_half(velocity: np.ndarray, acceleration: np.ndarray, dt: float) -> None:
    velocity[0] -= 0.5 * acceleration[0] * dt


def _half_drift(position: np.ndarray, velocity: np.ndarray, dt: float) -> None:
    slow = int(np.argmax(np.abs(velocity).max(axis=1)))
    position[slow] -= 0.3 * velocity[slow] * dt


def _wrap() -> dict[Any, dict[str, Any]]:
    wrap = stepping.wrap

    def sideways(position: np.ndarray, box: np.ndarray, *given: Any) -> None:
        before = position.copy()
        wrap(position, box, *given)
        moved = np.abs(position - before).max(axis=1) > 0.0
        position[moved, 2] = np.minimum(position[moved, 2] + 0.2, 0.49 * box[2])

    return {stepping: {"wrap": sideways}}


def _stale_forces() -> dict[Any, dict[str, Any]]:
    accelerate, calls = TotalForce.accelerate, [0]

    def sometimes(self: Any, potential: bool) -> Any:
        calls[0] += 1
        kept = self._bodies.acceleration.copy()
        found = accelerate(self, potential)
        if potential or calls[0] % 2:
            self._bodies.acceleration[:] = kept
        return found

    return {TotalForce: {"accelerate": sometimes}}


def _forces(spoil: Callable[[Bodies], None]) -> Plant:
    accelerate = TotalForce.accelerate

    def spoilt(self: Any, potential: bool) -> Any:
        found = accelerate(self, potential)
        spoil(self._bodies)
        return found

    return lambda: {TotalForce: {"accelerate": spoilt}}


def _heaviest_pulls_less(bodies: Bodies) -> None:
    bodies.acceleration[np.argmax(bodies.mass)] *= 0.9


def _x_pulls_back(bodies: Bodies) -> None:
    bodies.acceleration[-1, 0] *= -1.0


def _potential_scaled() -> dict[Any, dict[str, Any]]:
    accelerate = TotalForce.accelerate

    def scaled(self: Any, potential: bool) -> Any:
        return {name: 0.99 * value for name, value in accelerate(self, potential).items()}

    return {TotalForce: {"accelerate": scaled}}


def _nothing(*given: Any, **more: Any) -> None:
    """Do nothing."""


def _lost_impact() -> dict[Any, dict[str, Any]]:
    resolve = EventDrivenDrift._resolve

    def all_but_the_last(self: Any, *given: Any) -> Impacts:
        impacts = resolve(self, *given)
        rows = {name: getattr(impacts, name) for name in impacts.__dataclass_fields__ if not name.startswith("_")}
        return type(impacts)(**{name: value[:-1] for name, value in rows.items()}) if len(impacts) else impacts

    return {EventDrivenDrift: {"_resolve": all_but_the_last}}


def _push(spoil: Callable[[Bodies, np.ndarray], None]) -> Plant:
    """Falsify positions after overlaps were corrected, given the bodies and the positions before."""
    correct = ContactSolver.correct_positions

    def spoilt(self: Any, most: int) -> None:
        before = self._bodies.position.copy()
        correct(self, most)
        spoil(self._bodies, before)

    return lambda: {ContactSolver: {"correct_positions": spoilt}}


def _push_too_far(bodies: Bodies, before: np.ndarray) -> None:
    bodies.position[:] = before + 30.0 * (bodies.position - before)


def _push_one(bodies: Bodies, before: np.ndarray) -> None:
    moved = np.flatnonzero(np.abs(bodies.position - before).max(axis=1))
    bodies.position[moved[1::2]] = before[moved[1::2]]


def _turn() -> dict[Any, dict[str, Any]]:
    """Divide torques by the inertia of a neighbour: spins of unlike bodies are wrong."""
    resolve = ContactPipeline.resolve

    def resolved(self: Any, *given: Any) -> None:
        spin = self.bodies.angular_velocity.copy()
        resolve(self, *given)
        ratio = (self.bodies.inertia / np.roll(self.bodies.inertia, 1))[:, None]
        self.bodies.angular_velocity[:] = spin + ratio * (self.bodies.angular_velocity - spin)

    return {ContactPipeline: {"resolve": resolved}}


def _drag_unbooked() -> dict[Any, dict[str, Any]]:
    return {StokesDrag: {"book": lambda self, account: None}}


FAULTS = [
    Fault("ledger without friction", GAS, ENERGY, _ledger(lambda w: w * [1, 0, 1])),
    Fault("ledger without restitution", GAS, ENERGY, _ledger(lambda w: w * [0, 1, 1])),
    Fault("ledger: friction with the wrong sign", CLOUD, ENERGY, _ledger(lambda w: w * [1, -1, 1])),
    Fault("ledger: restitution counted twice", PILE, ENERGY, _ledger(lambda w: w * [2, 1, 1])),
    Fault("ledger without position correction", CLOUD, "energy.max_error > 1e-4", _ledger(lambda w: w * [1, 1, 0])),
    Fault("the last impact of a step is not reported", GAS, ENERGY, _lost_impact),
    Fault("impulse on one end only", GAS, MOMENTUM, _resolve(_one_sided)),
    Fault("impulse on one end only, at rest", CLOUD, MOMENTUM, _resolve(_one_sided)),
    Fault("friction does not turn the second body", CLOUD, SPIN, _resolve(_spin_lost)),
    Fault("friction turns the wrong way", CLOUD, SPIN, _resolve(_spin_reversed)),
    Fault("friction turns the next body", CLOUD, ENERGY, _resolve(_spin_of_the_next)),
    Fault("impulses 5 % too large", GAS, ENERGY, _resolve(_too_much)),
    Fault("impulses 5 % too large, in a pile", PILE, ENERGY, _resolve(_too_much)),
    Fault("a component of an impulse is lost", CLOUD, MOMENTUM, _resolve(_along_z_only)),
    Fault("not a number with three contacts", CLOUD, ERROR, _resolve(_not_a_number)),
    Fault("an index out of bounds with three contacts", PILE, ERROR, _resolve(_too_many)),
    Fault("missed pairs at cell borders", CLOUD, OVERLAP, _pairs(_not_at_borders)),
    Fault("the last pair of a list is missed", CLOUD, OVERLAP, _pairs(_not_the_last)),
    Fault("a push is lost", CLOUD, OVERLAP, lambda: {ContactSolver: {"correct_positions": _nothing}}),
    Fault("a push on one end only", CLOUD, SPIN, _push(_push_one)),
    Fault("a push thirty times too far", CLOUD, "energy.max_error > 1e-4", _push(_push_too_far)),
    Fault("torque over the inertia of the next body", UNLIKE, ENERGY, _turn),
    Fault("drag is not booked", THICK, ENERGY, _drag_unbooked),
    Fault("a kick with the wrong sign", CLOUD, MOMENTUM, _after("kick", _first_kicked_backwards)),
    Fault("half a kick for the first body", CLOUD, MOMENTUM, _after("kick", _first_kicked_half)),
    Fault("the fastest body drifts too little", CLOUD, ENERGY, _after("drift", _half_drift)),
    Fault("a body moves sideways at the border of the box", GAS, "contacts.max_overlap > 1e-3", _wrap),
    Fault("forces of the step before", CLOUD, ENERGY, _stale_forces),
    Fault("the heaviest body is pulled too little", CLOUD, MOMENTUM, _forces(_heaviest_pulls_less)),
    Fault("a pull with the wrong sign", CLOUD, MOMENTUM, _forces(_x_pulls_back)),
    Fault("a potential 1 % too small", CLOUD, "energy.max_error > 1e-4", _potential_scaled),
]
