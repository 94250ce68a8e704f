"""The reactions of the contacts of a step: torques on bodies, and accelerations that contacts support."""

from __future__ import annotations

import numpy as np

from carom.arrays import FloatArray, IntArray, RecordArray
from carom.physics.bodies import Bodies
from carom.physics.contact.constraints import ContactRecord
from carom.physics.contact.solver.prepare import ImpulseCache
from carom.physics.jit.decorators import kernel, long_kernel
from carom.physics.jit.team import Team

MIN_BODIES_PER_TASK, MIN_BODIES_PER_COPY = 1000, 10_000  # about 10 µs of work
NO_SUPPORT = np.empty(0)  # m/s², without lasting contacts


class Torques:
    """Computes the torques of each step from the spins before and after it."""

    def __init__(self, bodies: Bodies, team: Team) -> None:
        self._bodies, self._team = bodies, team
        self._spin = np.zeros_like(bodies.torque)  # rad/s, at the beginning of the step

    def remember(self) -> None:
        """Begin a step at the present spins."""
        spins = self._bodies.angular_velocity
        self._team.divide(len(self._spin), MIN_BODIES_PER_COPY, _remember, spins, self._spin)

    def write(self, dt: float) -> None:
        """Write the torques of a step of dt s, Σ r × J / dt = I Δω / dt, and the angular accelerations τ / I."""
        bodies = self._bodies
        arrays = (bodies.angular_velocity, bodies.inertia, dt, bodies.torque, bodies.angular_acceleration)
        self._team.divide(len(self._spin), MIN_BODIES_PER_TASK, write_torques, self._spin, *arrays)


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
