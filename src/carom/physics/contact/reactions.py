"""The reactions of the contacts of a step: torques on bodies, and accelerations that contacts support.

A body's spin changes by impacts and by contacts that last. The angular impulse of an impact does not depend on the
length of the step. Divided by the step, it would give a torque that doubles when the step is halved, so only lasting
contacts have torques.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from carom.arrays import BoolArray, FloatArray, IntArray, RecordArray
from carom.contact_table import turning_impulses
from carom.physics.aligned import columns
from carom.physics.bodies import Bodies
from carom.physics.contact.impact_log import Impacts
from carom.physics.contact.records import ContactRecord
from carom.physics.contact.rolling import angular_impulses_of
from carom.physics.contact.solver.contact_solver import ContactSolver
from carom.physics.contact.solver.prepare import ImpulseCache
from carom.physics.jit.decorators import kernel, long_kernel
from carom.physics.jit.team import Team

MIN_BODIES_PER_TASK, MIN_BODIES_PER_COPY = 1000, 10_000  # bodies for about 10 µs of work
NO_SUPPORT = np.empty(0)  # m/s², result of a step without lasting contacts
# relative rounding error of angular impulses and spins: a cross product, three factors and a sum
_ROUNDING = 8.0 * np.finfo(np.float64).eps


class Torques:
    """Computes the torques of each step from the spins before and after it."""

    def __init__(self, bodies: Bodies, team: Team) -> None:
        self._bodies, self._team = bodies, team
        self._spin = np.zeros_like(bodies.torque)  # rad/s, spins at the beginning of the step

    def remember(self) -> None:
        """Begin a step at the present spins."""
        spins = self._bodies.angular_velocity
        self._team.divide(len(self._spin), MIN_BODIES_PER_COPY, _remember, spins, self._spin)

    def write(self, dt: float) -> None:
        """Write the mean torques of a step of dt s, Σ r × J / dt = I Δω / dt, and the angular accelerations τ / I."""
        bodies = self._bodies
        arrays = (bodies.angular_velocity, bodies.inertia, dt, bodies.torque, bodies.angular_acceleration)
        self._team.divide(len(self._spin), MIN_BODIES_PER_TASK, write_torques, self._spin, *arrays)


@dataclass(frozen=True, slots=True)
class ImpactTurns:
    """The angular impulses of the impacts of a step on each body."""

    sum: FloatArray  # (n, 3) N m s, sum of the angular impulses on each body
    size: FloatArray  # (n,) N m s, sum of their magnitudes
    count: IntArray  # (n,) number of impacts

    @classmethod
    def of(cls, impacts: Impacts, solver: ContactSolver, bodies: Bodies) -> ImpactTurns | None:
        """Add up the impacts of the drift and the impacts that the solver resolved after it; None without impacts."""
        late = solver.approach > solver.rest_speed
        late &= columns(solver.recorded, ("normal_impulse",))[:, 0] > 0.0
        early = impacts.approach > impacts.rest_speed
        if not (early.any() or late.any()):
            return None
        of_drift, at_end = (impacts.log, impacts.log, early), (solver.contacts, solver.recorded, late)
        body = np.concatenate((impacts.pairs[early].ravel(), solver.order.pairs[late].ravel()))
        turns = np.concatenate((_turns(*of_drift), _turns(*at_end))).reshape(-1, 3)
        turns[bodies.ends.inverse_inertia[body] == 0.0] = 0.0
        n = len(bodies.ends.inverse_inertia)
        found = cls(np.zeros((n, 3)), np.zeros(n), np.bincount(body, minlength=n))
        np.add.at(found.sum, body, turns)
        np.add.at(found.size, body, np.sqrt((turns * turns).sum(axis=1)))
        n = len(bodies)
        return cls(found.sum[:n], found.size[:n], found.count[:n])

    def take_from(
        self, torque: FloatArray, angular_acceleration: FloatArray, dt: float, spin: FloatArray, inertia: FloatArray
    ) -> None:
        """Remove the torques of the impacts from the torques of a step of dt s, in place; only lasting contacts remain.

        The remaining change of a body's spin is 0 within the rounding of its impacts. ``spin``, (n, 3) rad/s, is the
        spin after the step.
        """
        struck = np.flatnonzero(self.count)
        whole = dt * torque[struck]
        left = whole - self.sum[struck]
        most = self.size[struck] + np.linalg.norm(whole, axis=1)
        most += inertia[struck] * np.linalg.norm(spin[struck], axis=1)  # N m s, with I ω after the step
        left[np.linalg.norm(left, axis=1) <= _ROUNDING * self.count[struck] * most] = 0.0
        torque[struck] = left / dt
        angular_acceleration[struck] = torque[struck] / inertia[struck, None]


def _turns(geometry: RecordArray[object], given: RecordArray[object], which: BoolArray) -> FloatArray:
    """Return the angular impulses of some contacts on both of their bodies, (k, 2, 3) N m s."""
    normal, arms = (columns(geometry, names)[which] for names in (("nx", "ny", "nz"), ("arm_i", "arm_j")))
    friction = columns(given, ("friction_x", "friction_y", "friction_z"))[which]
    return turning_impulses(normal, arms, friction, angular_impulses_of(given)[which])


@long_kernel
def _remember(lo: int, hi: int, angular_velocity: FloatArray, before: FloatArray) -> None:
    for i in range(lo, hi):
        for k in range(3):
            before[i, k] = angular_velocity[i, k]


@long_kernel
def write_torques(
    lo: int,
    hi: int,
    before: FloatArray,
    angular_velocity: FloatArray,
    inertia: FloatArray,
    dt: float,
    torque: FloatArray,
    angular_acceleration: FloatArray,
) -> None:
    """Write the torques on the bodies [lo, hi) and their angular accelerations, given the spins before a step."""
    for i in range(lo, hi):
        for k in range(3):
            torque[i, k] = inertia[i] * (angular_velocity[i, k] - before[i, k]) / dt
            angular_acceleration[i, k] = torque[i, k] / inertia[i]


def supported_acceleration(cache: ImpulseCache, inverse_mass: FloatArray) -> FloatArray:
    """Return Σ λ_n / (m h) of each body and plane, (n + p,) m/s², where h is the kick in which the impulses acted.

    Opposing forces add up, so the sum is large for a body squeezed between two others.
    """
    if cache.kick == 0.0 or len(cache.pairs) == 0:
        return NO_SUPPORT
    supported = np.zeros(len(inverse_mass))
    add_support(cache.pairs, cache.place, cache.contacts, inverse_mass, cache.kick, supported)
    return supported


@kernel
def add_support(
    pairs: IntArray,
    place: IntArray,
    contacts: RecordArray[ContactRecord],
    inverse_mass: FloatArray,
    kick: float,
    supported: FloatArray,
) -> None:
    """Add the accelerations that contacts support to ``supported``; see `supported_acceleration`."""
    for c in range(len(pairs)):
        impulse = contacts[place[c]].normal_impulse
        for end in range(2):
            supported[pairs[c, end]] += impulse * inverse_mass[pairs[c, end]] / kick
