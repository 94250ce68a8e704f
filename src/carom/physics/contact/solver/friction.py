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


@inline
def friction(
    state: ContactStateRecord,
    material: Coefficients,
    keeps_sliding: bool,
    opening: float,
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
    opening
        kg, the effective mass for tangential impulses in the first kick of a step; 0 in the last kick.
    normal
        N s, total of the normal impulse since the kick.
    tx, ty, tz
        N s, total of the tangential impulse that would end the slip.
    """
    if keeps_sliding and (state.slides or not sticks(material, normal, tx, ty, tz)):
        state.slides = True
        x, y, z = sliding_friction(material, normal, tx, ty, tz)
    else:
        x, y, z = lasting_friction(material, normal, tx, ty, tz)
    return _against_first_slip(state, opening, (tx, ty, tz), (x, y, z)) if opening > 0.0 else (x, y, z)


def friction_of_one(
    state: ContactStateRecord,
    material: Coefficients,
    keeps_sliding: bool,
    opening: float,
    normal: float,
    tx: float,
    ty: float,
    tz: float,
) -> Vector:
    """Call `friction`: `Code.call` accepts a plain function of Python, not a kernel."""
    return friction(state, material, keeps_sliding, opening, normal, tx, ty, tz)


@inline
def _against_first_slip(state: ContactStateRecord, mass: float, ending: Vector, friction: Vector) -> Vector:
    """Turn the friction of a contact that slides in the first kick against the slip before it, which is in ``state``.

    Friction that nearly ends the slip in this kick keeps the direction of ``ending``: against the slip before the kick,
    it could accelerate the slip after it. Between one and two times the friction, the direction changes gradually from
    one to the other, because sweeps would not converge if it jumped.

    Parameters
    ----------
    mass
        kg, effective mass for tangential impulses.
    ending, friction
        N s, the impulse that would end the slip after the kick, and the friction against this slip.
    """
    (tx, ty, tz), (x, y, z) = ending, friction
    sx, sy, sz = mass * state.slip_x, mass * state.slip_y, mass * state.slip_z
    given, most, first = x * x + y * y + z * z, tx * tx + ty * ty + tz * tz, sx * sx + sy * sy + sz * sz
    if not 0.0 < given < min(most, first):
        return friction
    given, most, first = np.sqrt(given), np.sqrt(most), np.sqrt(first)
    weight = min(1.0, first / given - 1.0) * min(1.0, most / given - 1.0)
    t, s = (1.0 - weight) / most, weight / first
    gx, gy, gz = t * tx - s * sx, t * ty - s * sy, t * tz - s * sz
    squared = gx * gx + gy * gy + gz * gz
    if not squared > 0.0:
        return friction
    scale = given / np.sqrt(squared)
    return scale * gx, scale * gy, scale * gz
