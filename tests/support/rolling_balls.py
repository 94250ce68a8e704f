"""The equations of a solid ball that rolls or slides on a wall or another ball, to compare runs with.

With N the normal from the wall to the centre, g a uniform field and s the velocity of the wall at the contact point,

    v = a ω × N + s,    dv/dt = f + P g - (v·dN/dt) N,    dω/dt = -5/(2a) N × f
    f = 2/7 (P (a (ω - Ω) × dN/dt + Ω × v) - P g),    P the projection onto the tangential plane

f is the friction over the mass. It follows from the derivative of the first equation; I = 2/5 m a². The wall has the
angular velocity Ω about an axis through the origin, so s = Ω × (x - a N). If the ball slides, the first equation does
not hold, and

    f = -μ p u/|u|,    u = v - a ω × N - s,    p = -g·N - v·dN/dt
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.integrate import solve_ivp

from carom.arrays import FloatArray

Turning = Callable[[FloatArray, FloatArray], tuple[FloatArray, FloatArray]]
"""Returns N and dN/dt of a centre (m) that moves with a velocity (m/s)."""

EXACT = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-13}
AT_REST = np.zeros(3)


def on_plane(normal: FloatArray) -> Turning:
    """Return N on a plane at rest."""
    return lambda x, v: (normal, np.zeros(3))


def in_sphere(distance: float) -> Turning:
    """Return N inside a hollow sphere about the origin, for centres at a distance from it."""
    return lambda x, v: (-x / distance, -v / distance)


def on_sphere(distance: float) -> Turning:
    """Return N on a ball about the origin, for centres at a distance from it."""
    return lambda x, v: (x / distance, v / distance)


def in_cylinder(axis: FloatArray, distance: float) -> Turning:
    """Return N inside a cylinder whose axis, a unit vector, goes through the origin."""

    def across(x: FloatArray) -> FloatArray:
        return np.asarray(x - (x @ axis) * axis)

    return lambda x, v: (-across(x) / distance, -across(v) / distance)


def in_cone(angle: float) -> Turning:
    """Return N inside a cone that opens upwards about z, with an angle between the axis and the surface."""

    def turning(x: FloatArray, v: FloatArray) -> tuple[FloatArray, FloatArray]:
        rho = np.hypot(x[0], x[1])
        outwards, along = np.array([x[0], x[1], 0.0]) / rho, np.array([-x[1], x[0], 0.0]) / rho
        turn = -np.cos(angle) * (v @ along) / rho * along
        return -np.cos(angle) * outwards + np.sin(angle) * np.array([0.0, 0.0, 1.0]), turn

    return turning


def rolling_without_slip(
    turning: Turning,
    x: FloatArray,
    v: FloatArray,
    spin: float,
    a: float,
    g: FloatArray,
    duration: float,
    wall: FloatArray = AT_REST,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the spin (rad/s) at the start, and the position (m) and velocity (m/s) of the centre at the end.

    ``spin`` in rad/s is the angular velocity about N at the start, ``a`` the radius in m, ``wall`` Ω in rad/s.
    """
    N = turning(x, v)[0]
    relative = v - np.cross(wall, x - a * N)  # a ω × N
    spins = spin * N + np.cross(N, relative) / a

    def rates(_: float, state: FloatArray) -> FloatArray:
        x, v, w = state.reshape(3, 3)
        N, turn = turning(x, v)

        def tangential(u: FloatArray) -> FloatArray:
            return np.asarray(u - (u @ N) * N)

        f = 2.0 / 7.0 * tangential(a * np.cross(w - wall, turn) + np.cross(wall, v) - g)
        return np.concatenate((v, f + tangential(g) - (v @ turn) * N, -2.5 / a * np.cross(N, f)))

    end = solve_ivp(rates, (0.0, duration), np.concatenate((x, v, spins)), **EXACT).y[:, -1]
    return spins, end[:3], end[3:6]


def sliding(
    turning: Turning,
    x: FloatArray,
    v: FloatArray,
    spin: FloatArray,
    a: float,
    g: FloatArray,
    mu: float,
    duration: float,
    wall: FloatArray = AT_REST,
) -> tuple[FloatArray, FloatArray]:
    """Return the position (m) and the velocity (m/s) of the centre of a ball that slides all the time.

    ``spin`` is the angular velocity at the start, (3,) rad/s; the other arguments are as in `rolling_without_slip`.
    """

    def rates(_: float, state: FloatArray) -> FloatArray:
        x, v, w = state.reshape(3, 3)
        N, turn = turning(x, v)
        u = v - a * np.cross(w, N) - np.cross(wall, x - a * N)
        press = -(g @ N) - v @ turn
        u = u - (u @ N) * N
        f = -mu * press * u / np.linalg.norm(u)
        return np.concatenate((v, f + g - (g @ N) * N - (v @ turn) * N, -2.5 / a * np.cross(N, f)))

    end = solve_ivp(rates, (0.0, duration), np.concatenate((x, v, spin)), **EXACT).y[:, -1]
    return end[:3], end[3:6]
