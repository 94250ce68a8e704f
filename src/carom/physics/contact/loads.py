"""The load of each body, and the restitution threshold of a contact that follows from it.

A contact is at rest if its pair would be pressed together again within about a step. The acceleration that presses a
pair along its normal is

    A = max(0, (a_i - a_j)·n, max(0, b_i·n) + max(0, -b_j·n)) + n·(L_i + L_j)·n,
    b = a + Σ J/(m h),    L = Σ λ n nᵀ/(m h)

where the sums are over the contacts of a body in the last kick h, J are the contacts' impulses on the body, and λ are
their normal impulses. The first term is the relative acceleration, without the contacts (a) and with them (b). With the
contacts, each body counts by itself: two bodies of a high column may still fall alike, but will be stopped one after
the other. The second term is the load that contacts carry along the normal: in a pile, where nothing accelerates, a
body that leaves one contact is pressed back by the others. Marbles side by side on a floor carry a load, but none along
their common normal, so they bounce at any speed.

The rest speed is `PER_STEP` A dt, and at most the load speed of the island (`islands`): no load accelerates a body more
than the largest acceleration.
"""

from __future__ import annotations

import numpy as np

from carom.arrays import FloatArray, IntArray, RecordArray, dtype_of
from carom.physics.contact.impact_log import ROUNDING
from carom.physics.contact.records import ContactRecord, ContactStateRecord, LoadRecord
from carom.physics.jit.decorators import inline, inner, kernel, long_kernel
from carom.physics.jit.instructions import from_front
from carom.physics.vector import Vector, between, vector
from carom.scene.rest_speed import PER_STEP

UNKNOWN = 1e200  # m/s², a load in all directions, so large that the rest speed is the load speed


LOAD = dtype_of(LoadRecord)


@kernel
def clear_loads(active: IntArray, loads: RecordArray[LoadRecord]) -> None:
    """Remove the loads of given bodies."""
    for k in range(len(active)):
        load = loads[active[k]]
        load.x = load.y = load.z = 0.0
        load.xx = load.yy = load.zz = load.xy = load.xz = load.yz = 0.0


@long_kernel
def add_loads(
    pairs: IntArray,
    contacts: RecordArray[ContactRecord],
    inverse_mass: FloatArray,
    kick: float,
    loads: RecordArray[LoadRecord],
) -> None:
    """Add the impulses of a kick (s) to the loads of the bodies at both ends, in the order of the contacts."""
    for c in range(len(pairs)):
        contact = contacts[c]
        normal = contact.normal_impulse
        if not normal > 0.0:
            continue
        nx, ny, nz = contact.nx, contact.ny, contact.nz
        fx, fy, fz = contact.friction_x, contact.friction_y, contact.friction_z
        for end in range(2):
            i = from_front(pairs[c, end])
            w = inverse_mass[i] / kick
            if w == 0.0:
                continue
            load, s = loads[i], (2 * end - 1) * w
            load.x += s * (normal * nx + fx)
            load.y += s * (normal * ny + fy)
            load.z += s * (normal * nz + fz)
            w *= normal
            load.xx += w * nx * nx
            load.yy += w * ny * ny
            load.zz += w * nz * nz
            load.xy += w * nx * ny
            load.xz += w * nx * nz
            load.yz += w * ny * nz


@inner
def pressing(i: int, j: int, normal: Vector, a: FloatArray, loads: RecordArray[LoadRecord]) -> float:
    """Return the acceleration A (m/s²) that presses two bodies, or a body and a solid, together; see the module."""
    nx, ny, nz = normal
    one, other = loads[i], loads[j]
    ax, ay, az = between(a, j, i)
    freely = ax * nx + ay * ny + az * nz
    (ix, iy, iz), (jx, jy, jz) = vector(a, i), vector(a, j)
    first = (ix + one.x) * nx + (iy + one.y) * ny + (iz + one.z) * nz
    second = (jx + other.x) * nx + (jy + other.y) * ny + (jz + other.z) * nz
    supported = max(0.0, first) + max(0.0, -second)
    xx, yy, zz = one.xx + other.xx, one.yy + other.yy, one.zz + other.zz
    xy, xz, yz = one.xy + other.xy, one.xz + other.xz, one.yz + other.yz
    across = 2.0 * (nx * ny * xy + nx * nz * xz + ny * nz * yz)
    carried = nx * nx * xx + ny * ny * yy + nz * nz * zz + across
    return float(max(0.0, freely, supported) + max(0.0, carried))


@long_kernel
def write_rest_speeds(
    lo: int,
    hi: int,
    pairs: IntArray,
    contacts: RecordArray[ContactRecord],
    pressed: tuple[FloatArray, FloatArray, RecordArray[LoadRecord], float],
    load_speed: FloatArray,
    states: RecordArray[ContactStateRecord],
) -> None:
    """Write the rest speeds (m/s) of the contacts [lo, hi).

    ``pressed`` holds velocities (m/s), accelerations (m/s²) and loads of bodies and planes, and the length of the step
    (s). A pair whose closing speed is within the rounding of velocities is also at rest.
    """
    v, a, loads, dt = pressed
    for c in range(lo, hi):
        rest_speed, most = 0.0, load_speed[c]
        if most > 0.0:
            i, j = from_front(pairs[c, 0]), from_front(pairs[c, 1])
            contact = contacts[c]
            normal = contact.nx, contact.ny, contact.nz
            rounded = _size(v, i) + _size(v, j) + (contact.arm_i + contact.arm_j) / dt
            rest_speed = min(most, max(ROUNDING * rounded, PER_STEP * dt * pressing(i, j, normal, a, loads)))
        states[c].rest_speed = rest_speed


@inline
def _size(v: FloatArray, i: int) -> float:
    vx, vy, vz = vector(v, i)
    size: float = np.abs(vx) + np.abs(vy) + np.abs(vz)
    return size
