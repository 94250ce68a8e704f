"""Velocities at a contact, of body j relative to body i.

    v = v_j - v_i,    v_n = v·n,    v_t = v - v_n n,    u = v_t - (ρ_i ω_i + ρ_j ω_j) × n     (slip)

The helpers are inlined by Numba.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from carom.physics.jit.decorators import inline
from carom.physics.jit.lanes import where


@inline
def relative_velocity(contact: Any, a: Any, b: Any) -> tuple[float, float, float, float]:
    """Return v_n and v_t of two bodies, in m/s."""
    return velocity_along(contact.nx, contact.ny, contact.nz, a, b)


@inline
def velocity_along(nx: float, ny: float, nz: float, a: Any, b: Any) -> tuple[float, float, float, float]:
    """Return v_n and v_t of two bodies, in m/s, for a normal from a to b."""
    ux, uy, uz = b.vx - a.vx, b.vy - a.vy, b.vz - a.vz
    vn = ux * nx + uy * ny + uz * nz
    return vn, ux - vn * nx, uy - vn * ny, uz - vn * nz


@inline
def slip_velocity(
    tx: float, ty: float, tz: float, nx: float, ny: float, nz: float, wx: float, wy: float, wz: float
) -> tuple[float, float, float]:
    """Return the slip at the contact point, u = v_t - w × n, in m/s.

    Parameters
    ----------
    tx, ty, tz
        m/s, v_t, the tangential part of the centres' relative velocity.
    nx, ny, nz
        The normal, from i to j.
    wx, wy, wz
        m/s, w = ρ_i ω_i + ρ_j ω_j, with the lever arms ρ.
    """
    return tx - (wy * nz - wz * ny), ty - (wz * nx - wx * nz), tz - (wx * ny - wy * nx)


@inline
def slip(contact: Any, a: Any, b: Any, tx: float, ty: float, tz: float) -> tuple[float, float, float]:
    """Return the slip u of two bodies, in m/s, given v_t."""
    ri, rj = contact.arm_i, contact.arm_j
    wx, wy, wz = ri * a.wx + rj * b.wx, ri * a.wy + rj * b.wy, ri * a.wz + rj * b.wz
    return slip_velocity(tx, ty, tz, contact.nx, contact.ny, contact.nz, wx, wy, wz)


@inline
def change_of_velocity(contact: Any, a: Any, b: Any) -> tuple[float, float, float, float]:
    """Return the changes of v_n and u in the last iteration, in m/s."""
    nx, ny, nz, ri, rj = contact.nx, contact.ny, contact.nz, contact.arm_i, contact.arm_j
    px, py, pz = b.dvx - a.dvx, b.dvy - a.dvy, b.dvz - a.dvz
    pn = px * nx + py * ny + pz * nz
    wx, wy, wz = ri * a.dwx + rj * b.dwx, ri * a.dwy + rj * b.dwy, ri * a.dwz + rj * b.dwz
    ux, uy, uz = slip_velocity(px - pn * nx, py - pn * ny, pz - pn * nz, nx, ny, nz, wx, wy, wz)
    return pn, ux, uy, uz


@inline
def bias_of(contact: Any, between_bodies: bool, tx: float, ty: float, tz: float, drift: float) -> float:
    """Return the bias c of a contact at these velocities, in m/s: after a drift of two bodies `bias_along_arc`."""
    bias: float = contact.velocity_bias
    if drift > 0.0 and between_bodies:
        bias = bias_along_arc(bias, contact.arm_i + contact.arm_j, tx, ty, tz, drift)
    return bias


@inline
def bias_along_arc(bias: float, reach: float, tx: float, ty: float, tz: float, drift: float) -> float:
    """Return the speed c at which a contact may close so that it just touches after a drift, in m/s.

    Spheres that roll about each other separate along the tangent by R - √(R² - v_t² dt²) in a drift of dt, where R is
    the distance of their centres after it. ``bias`` is c for a drift along the normal.

    Parameters
    ----------
    bias
        m/s
    reach
        m, sum of the lever arms.
    tx, ty, tz
        m/s, v_t.
    drift
        s
    """
    R = reach - bias * drift
    t2 = (tx * tx + ty * ty + tz * tz) * drift * drift
    more = t2 / ((R + np.sqrt(R * R - t2)) * drift)
    return bias + where((t2 > 0.0) & (t2 < R * R), more, 0.0)
