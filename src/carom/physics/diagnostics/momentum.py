"""Momentum and angular momentum, and their errors.

    p = Σ m v,    L = Σ (m x × v + I ω)

Contacts and direct gravity conserve p and L to round-off. A uniform field g changes both in closed form, because the
centre of mass X moves on a parabola:

    p(t) = p₀ + M g t,    L(t) = L₀ + M (X₀ t + ½ V₀ t²) × g

With drag, the impulses of the medium and the field are booked step by step instead. Planes, walls and fixed bodies
absorb momentum; in scenes with any of these, momenta are not compared.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from carom.arrays import FloatArray
from carom.physics.bodies import Bodies
from carom.physics.jit.decorators import kernel
from carom.physics.vector import square, vector
from carom.state.books import MomentumBaseline


class TotalMotion(NamedTuple):
    """The total motion of all bodies."""

    linear: FloatArray  # (3,) kg m/s, Σ m v
    angular: FloatArray  # (3,) kg m²/s, Σ (m x × v + I ω) about the origin
    linear_scale: float  # kg m/s, Σ m |v|
    angular_scale: float  # kg m²/s, Σ (m |x| |v| + I |ω|)
    translational: float  # J, Σ ½ m v²
    rotational: float  # J, Σ ½ I ω²

    @classmethod
    def of(cls, bodies: Bodies) -> TotalMotion:
        """Sum over the present motion of the bodies."""
        linear, angular = np.empty(3), np.empty(3)
        state = bodies.position, bodies.velocity, bodies.angular_velocity
        return cls(linear, angular, *_add_up(*state, bodies.mass, bodies.inertia, linear, angular))


@kernel
def centre_velocity(velocity: FloatArray, mass: FloatArray) -> tuple[float, float, float]:
    """Return the velocity of the centre of mass, m/s."""
    M, px, py, pz = 0.0, 0.0, 0.0, 0.0
    for i in range(len(mass)):
        M += mass[i]
        vx, vy, vz = vector(velocity, i)
        px, py, pz = px + mass[i] * vx, py + mass[i] * vy, pz + mass[i] * vz
    return px / M, py / M, pz / M


@kernel
def internal_energy(velocity: FloatArray, mass: FloatArray) -> float:
    """Return the kinetic energy relative to the centre of mass, Σ ½ m (v - V)², in J."""
    Vx, Vy, Vz = centre_velocity(velocity, mass)
    energy = 0.0
    for i in range(len(mass)):
        vx, vy, vz = velocity[i, 0] - Vx, velocity[i, 1] - Vy, velocity[i, 2] - Vz
        energy += 0.5 * mass[i] * (vx * vx + vy * vy + vz * vz)
    return energy


@kernel
def _add_up(
    x: FloatArray,
    v: FloatArray,
    omega: FloatArray,
    mass: FloatArray,
    inertia: FloatArray,
    linear: FloatArray,
    angular: FloatArray,
) -> tuple[float, float, float, float]:
    """Write p and L; return the scales and energies of `TotalMotion`."""
    linear_scale, angular_scale, translational, rotational = 0.0, 0.0, 0.0, 0.0
    lx, ly, lz = 0.0, 0.0, 0.0
    ax, ay, az = 0.0, 0.0, 0.0
    for i in range(len(mass)):
        m = mass[i]
        px, py, pz = vector(x, i)
        vx, vy, vz = vector(v, i)
        lx += m * vx
        ly += m * vy
        lz += m * vz
        ax += m * (py * vz - pz * vy)
        ay += m * (pz * vx - px * vz)
        az += m * (px * vy - py * vx)
        v2 = vx * vx + vy * vy + vz * vz
        speed = np.sqrt(v2)
        linear_scale += m * speed
        angular_scale += m * speed * np.sqrt(px * px + py * py + pz * pz)
        translational += 0.5 * m * v2
    for i in range(len(omega)):
        I = inertia[i]  # noqa: E741 - the symbol of the equation
        wx, wy, wz = vector(omega, i)
        ax += I * wx
        ay += I * wy
        az += I * wz
        angular_scale += I * np.sqrt(square(omega, i))
        rotational += 0.5 * I * (wx * wx + wy * wy + wz * wz)
    linear[0], linear[1], linear[2] = lx, ly, lz
    angular[0], angular[1], angular[2] = ax, ay, az
    return linear_scale, angular_scale, translational, rotational


@dataclass(frozen=True, slots=True)
class Momentum:
    """Momentum and angular momentum at one time, and their relative errors."""

    linear: FloatArray  # (3,) kg m/s
    angular: FloatArray  # (3,) kg m²/s, angular momentum about the origin
    linear_error: float | None  # error relative to the largest Σ m |v| of all checks; None if anything is fixed
    # error relative to the largest Σ (m |x| |v| + I |ω|); None if anything is fixed, and in a periodic box
    angular_error: float | None


class MomentumAccount:
    """Compares momentum with its value at the start."""

    def __init__(self, bodies: Bodies, field: FloatArray, periodic: bool, anchored: bool = False) -> None:
        self._field = field
        self._has_field = bool(field.any())
        self._periodic = periodic
        self._anchored = anchored
        self._linear, self._angular, self._linear_scale, self._angular_scale, *_ = TotalMotion.of(bodies)
        self._mass = float(bodies.mass.sum())
        moment = (bodies.mass[:, np.newaxis] * bodies.position).sum(axis=0)
        # at the start, all bodies may still be waiting to enter
        self._centre = moment / self._mass if self._mass > 0.0 else moment
        self._baseline: MomentumBaseline | None = None  # None if the momentum has changed since the last access

    @property
    def baseline(self) -> MomentumBaseline:
        """The reference values; set them to continue an earlier run."""
        if self._baseline is None:
            linear, angular, centre = (tuple(vector.tolist()) for vector in (self._linear, self._angular, self._centre))
            self._baseline = MomentumBaseline(linear, angular, centre, self._linear_scale, self._angular_scale)
        return self._baseline

    @baseline.setter
    def baseline(self, known: MomentumBaseline) -> None:
        self._linear, self._angular, self._centre = map(np.array, (known.linear, known.angular, known.centre))
        self._linear_scale, self._angular_scale = known.linear_scale, known.angular_scale
        self._baseline = known

    def receive(self, linear: FloatArray, angular: FloatArray) -> None:
        """Add momenta that entered from outside to the reference values."""
        self._linear, self._angular = self._linear + linear, self._angular + angular
        self._baseline = None

    @property
    def expected(self) -> FloatArray:
        """The reference values of both momenta, (6,) kg m/s and kg m²/s; a caller may add to them."""
        return np.concatenate((self._linear, self._angular))

    @expected.setter
    def expected(self, momenta: FloatArray) -> None:
        self._linear, self._angular = momenta[:3], momenta[3:]
        self._baseline = None

    def balance(self, motion: TotalMotion, time: float, judged: bool = True) -> Momentum:
        """Return the momenta at a time since the start (s).

        ``judged`` marks a check; the scales of later checks are at least as large as its scales.
        """
        linear, angular, linear_scale, angular_scale, *_ = motion
        linear_scale, angular_scale = max(self._linear_scale, linear_scale), max(self._angular_scale, angular_scale)
        if judged and (linear_scale > self._linear_scale or angular_scale > self._angular_scale):
            self._linear_scale, self._angular_scale, self._baseline = linear_scale, angular_scale, None
        if self._anchored:
            return Momentum(linear, angular, None, None)
        expected_linear, expected_angular = self._linear, self._angular
        if self._has_field:
            weight = self._mass * self._field
            path = self._centre * time + 0.5 * (self._linear / self._mass) * time * time
            expected_linear, expected_angular = self._linear + weight * time, self._angular + np.cross(path, weight)
        linear_error = _relative(linear, expected_linear, linear_scale)
        angular_error = None if self._periodic else _relative(angular, expected_angular, angular_scale)
        return Momentum(linear, angular, linear_error, angular_error)


def _relative(measured: FloatArray, expected: FloatArray, scale: float) -> float:
    x, y, z = (measured - expected).tolist()
    return math.sqrt(x * x + y * y + z * z) / scale if scale > 0.0 else 0.0
