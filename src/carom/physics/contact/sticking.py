"""The time at which a contact stops sliding, or a body stops rolling, so that a step can end there.

Friction ends at that moment: the acceleration of the bodies jumps by Δa. A step of length h that passes this moment at
a fraction f of the step moves the bodies too far by ½ Δa h² min(f, 1 - f)². A comparison with other steps does not show
this error if they end at the same time. The prediction is exact under constant forces. Otherwise its error is of second
order in the step, and the error of a step that ends at the predicted time is of fourth order.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from carom.arrays import FloatArray, IntArray, RecordArray
from carom.physics.aligned import columns
from carom.physics.bodies import Ends
from carom.physics.contact.law import IMPULSES
from carom.physics.contact.records import ContactRecord

# a motion that moves a body less than this in a step, relative to the requested error, may end anywhere in the step
NEGLIGIBLE = 1e-2
SOON = 1e-3  # fraction of the next step; a motion that ends sooner may end in the step, with 1e-6 of the largest error


class SlidingContacts(NamedTuple):
    """The contacts of the last step, and the impulses that held them."""

    pairs: IntArray  # (m, 2)
    place: IntArray  # (m,) index of each contact's record
    contacts: RecordArray[ContactRecord]  # (m,) contacts at the end of the step
    impulse: FloatArray  # (m, 4) N s, components λ_n and λ_t, or (m, 7) with Λ if the law resists rolling
    kick: float  # s, length of the kick in which the impulses acted


def time_to_stick(held: SlidingContacts, ends: Ends, dt: float, tolerance: float) -> float:
    """Return the time (s) until a contact stops sliding, rolling or twisting; infinite if no contact stops.

    Parameters
    ----------
    held, ends
        The contacts, and the bodies and planes that they join.
    dt
        s, the next step.
    tolerance
        The error that the run may make, relative to the radii.
    """
    (i, j), impulse = held.pairs.T, held.impulse / held.kick
    geometry = columns(held.contacts, ("nx", "ny", "nz", "arm_i", "arm_j"))[held.place]
    n, arm_i, arm_j = geometry[:, :3], geometry[:, 3:4], geometry[:, 4:]
    force, turn = impulse[:, :1] * n + impulse[:, 1:4], np.cross(impulse[:, 1:4], n)
    resists = impulse.shape[1] > len(IMPULSES)
    torque = impulse[:, 4:] if resists else np.zeros_like(force)
    # accelerations by all forces, and by the contacts' forces and torques, which act on j and oppositely on i
    a, alpha = ends.acceleration.copy(), np.zeros_like(ends.angular_velocity)
    inverse_mass, inverse_inertia = ends.inverse_mass[:, np.newaxis], ends.inverse_inertia[:, np.newaxis]
    np.add.at(a, j, force * inverse_mass[j])
    np.add.at(a, i, -force * inverse_mass[i])
    np.add.at(alpha, j, (arm_j * turn + torque) * inverse_inertia[j])
    np.add.at(alpha, i, (arm_i * turn - torque) * inverse_inertia[i])

    def slip(v: FloatArray, omega: FloatArray) -> FloatArray:
        apart = v[j] - v[i]
        across = apart - np.sum(apart * n, axis=1, keepdims=True) * n
        return np.asarray(across - np.cross(arm_i * omega[i] + arm_j * omega[j], n))

    motions = [(slip(ends.velocity, ends.angular_velocity), slip(a, alpha))]
    radius = np.minimum(ends.radius[i], ends.radius[j])
    if resists:
        spin, change = (omega[j] - omega[i] for omega in (ends.angular_velocity, alpha))
        twist, twist_change = (np.sum(each * n, axis=1, keepdims=True) * n for each in (spin, change))
        arm = radius[:, np.newaxis]
        motions += [(arm * (spin - twist), arm * (change - twist_change)), (arm * twist, arm * twist_change)]
    first = np.inf
    for speed, rate in motions:
        closing, square = -np.sum(speed * rate, axis=1), np.sum(rate * rate, axis=1)
        matters = np.linalg.norm(speed, axis=1) * dt > NEGLIGIBLE * tolerance * radius
        matters &= closing > SOON * dt * square
        first = min(first, float(np.min(closing[matters] / square[matters], initial=np.inf)))
    return first
