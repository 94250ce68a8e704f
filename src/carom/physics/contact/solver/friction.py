"""The friction of a lasting contact in one kick, given the impulse that would end its slip.

A contact that sticks exerts this impulse. A contact that slides exerts kinetic friction against the slip u, at the time
between two steps:

    λ_t = -μ_k λ_n u/|u|,    in the last kick of a step: u after it;  in the first kick: u before it

Both kicks around that time thus have friction in one direction, that of the slip in the middle of the time in which
they act. A step is then time-reversible and of second order where the slip turns, as on an incline, on a turntable or
in a bowl. With u after the first kick, friction would follow the slip with a delay of dt/4.
"""

from __future__ import annotations

import numpy as np

from carom.physics.contact.law import lasting_friction, sliding_friction, sticks
from carom.physics.contact.records import ContactStateRecord
from carom.physics.jit.decorators import inline
from carom.physics.vector import Vector
from carom.scene.schema import Coefficients

# Number of kicks in which friction would end the slip, up to which the slip before the kick does not count; it counts
# fully from twice as many on. With 1, the first kicks of a drum take 10 % more sweeps, with 4, none; errors of
# `test_sliding_friction.py` are the same.
ALMOST_ENDED = 4.0


@inline
def friction(
    state: ContactStateRecord,
    material: Coefficients,
    keeps_sliding: bool,
    normal: float,
    tx: float,
    ty: float,
    tz: float,
) -> Vector:
    """Return the tangential impulse that a contact exerts, (3,) N s.

    Parameters
    ----------
    state, material
        `CONTACT_STATE` and `MATERIAL` of the contact; ``slides`` is noted in ``state``.
    keeps_sliding
        Whether a contact that has slid once keeps sliding, see `solver.phases`.
    normal
        N s, total of the normal impulse since the kick.
    tx, ty, tz
        N s, total of the tangential impulse that would end the slip.
    """
    if keeps_sliding and (state.slides or not sticks(material, normal, tx, ty, tz)):
        state.slides = True
        return sliding_friction(material, normal, tx, ty, tz)
    return lasting_friction(material, normal, tx, ty, tz)


@inline
def _share(kicks: float) -> float:
    """Return the weight of the slip before the kick, given the number of kicks in which friction would end the slip.

    The weight is continuous, because sweeps would not converge if the direction of friction jumped.
    """
    return min(1.0, max(0.0, kicks / ALMOST_ENDED - 1.0))


@inline
def against_first_slip(
    state: ContactStateRecord, mass: float, tx: float, ty: float, tz: float, x: float, y: float, z: float
) -> Vector:
    """Turn the friction of a contact that slides in the first kick against the slip before it, which is in ``state``.

    Friction that nearly ends the slip in this kick stays as it is: against the slip before the kick, it could
    accelerate the slip after it.

    Parameters
    ----------
    mass
        kg, effective mass for tangential impulses.
    tx, ty, tz
        N s, the impulse that would end the slip after the kick.
    x, y, z
        N s, the friction against this slip.
    """
    given, most = x * x + y * y + z * z, tx * tx + ty * ty + tz * tz
    if not 0.0 < given < most:  # contacts that stick do not load the slip into the cache
        return x, y, z
    sx, sy, sz = mass * state.slip_x, mass * state.slip_y, mass * state.slip_z
    first = sx * sx + sy * sy + sz * sz
    if not given < first:
        return x, y, z
    given, most, first = np.sqrt(given), np.sqrt(most), np.sqrt(first)
    weight = _share(first / given) * _share(most / given)
    t, s = (1.0 - weight) / most, weight / first
    gx, gy, gz = t * tx - s * sx, t * ty - s * sy, t * tz - s * sz
    squared = gx * gx + gy * gy + gz * gz
    if not squared > 0.0:
        return x, y, z
    scale = given / np.sqrt(squared)
    return scale * gx, scale * gy, scale * gz
