"""Sums over all bodies, of which energy and momentum are made."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from carom.physics.bodies import Bodies
from carom.physics.parallel.jit import kernel
from carom.physics.vector import square, vector

FloatArray = NDArray[np.float64]


class Motion(NamedTuple):
    """The motion of all bodies together."""

    linear: FloatArray  # (3,) kg m/s, Σ m v
    angular: FloatArray  # (3,) kg m²/s about the origin, Σ (m x × v + I ω)
    linear_scale: float  # kg m/s, Σ m |v|
    angular_scale: float  # kg m²/s, Σ (m |x| |v| + I |ω|)
    translational: float  # J, Σ ½ m v²
    rotational: float  # J, Σ ½ I ω²

    @classmethod
    def of(cls, bodies: Bodies) -> Motion:
        """Sum over the bodies as they move now."""
        linear, angular = np.empty(3), np.empty(3)
        state = bodies.position, bodies.velocity, bodies.angular_velocity
        return cls(linear, angular, *_add_up(*state, bodies.mass, bodies.inertia, linear, angular))


def internal_energy(bodies: Bodies) -> float:
    """Return the kinetic energy relative to the centre of mass, Σ ½ m (v - V)², in J."""
    return _internal_energy(bodies.velocity, bodies.mass)


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
def _internal_energy(velocity: FloatArray, mass: FloatArray) -> float:
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
    """Write p and L; return the scales and energies of `Motion`."""
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
