"""The impulses that hold a group of contacts: nearest velocities by the dual method of Goldfarb & Idnani (1983).

Among all velocities at which each contact closes no faster than its gap allows, the solution is the nearest to the
previous velocities, measured by kinetic energy (`held_group`). The dual method finds it in finitely many steps: it adds
the contact that closes fastest, and opens contacts whose impulse would become negative. The method works with
orthogonal directions of the scaled velocities √m v. At mass ratios above 10¹², the matrix of the contacts would lose a
light body between heavy ones to rounding.

Goldfarb, D., Idnani, A.: A numerically stable dual method for solving strictly convex quadratic programs. Mathematical
Programming 27 (1983) 1–33.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from carom.arrays import BoolArray, FloatArray, IntArray
from carom.physics.jit.decorators import inline, inner, long_kernel

MOST_BODIES = 48  # largest number of bodies in a group; other bodies are held in other groups
MOST_CONTACTS = 3 * MOST_BODIES
MOST_CHANGES = 20  # limit on changes of the held set, per contact; rounding could exchange two contacts forever
DEPENDENT = 1e-29  # squared orthogonal part of a direction, relative to the whole direction, up to which it is rounding


class Group(NamedTuple):
    """Bodies and contacts that are held together, and workspace."""

    body: IntArray  # (MOST_BODIES,) moving bodies and guided walls
    v: FloatArray  # (MOST_BODIES, 3) m/s, velocities of the bodies in the drift; for a guided wall, only their change
    root: FloatArray  # (MOST_BODIES,) square root of the inverse mass, in the group's unit
    changed: IntArray  # (MOST_BODIES,) bodies whose velocities the group has changed
    ends: IntArray  # (MOST_CONTACTS, 2) a body, and a body or plane
    place: IntArray  # (MOST_CONTACTS, 2) indices of both ends in `body`; -1 for an end that does not move
    normal: FloatArray  # (MOST_CONTACTS, 3) normal from the first to the second end
    before: FloatArray  # (MOST_CONTACTS,) m/s, v_n in the drift before the group is held
    # (MOST_CONTACTS,) m/s, closing speed that the gap allows; for an elastic contact, its rest speed
    allowed: FloatArray
    impulse: FloatArray  # (MOST_CONTACTS,) N s, impulse divided by the group's unit
    scale: FloatArray  # (MOST_CONTACTS,) square root of the inverse reduced mass
    ignored: BoolArray  # (MOST_CONTACTS,) whether no impulse can open a contact
    active: IntArray  # (MOST_CONTACTS,) indices of the held contacts
    load: FloatArray  # (MOST_CONTACTS,) √kg m/s, loads on the held contacts
    weight: FloatArray  # (MOST_CONTACTS,) rates at which the loads decrease
    z: FloatArray  # (3 MOST_BODIES,) a direction
    Q: FloatArray  # (MOST_CONTACTS, 3 MOST_BODIES) with `R`: QR factors of the held contacts' directions
    R: FloatArray  # (MOST_CONTACTS, MOST_CONTACTS)


def empty_group() -> Group:
    """Return the arrays of a group, filled with zeros."""
    bodies, contacts = MOST_BODIES, MOST_CONTACTS
    return Group(
        body=np.zeros(bodies, np.int64),
        v=np.zeros((bodies, 3)),
        root=np.zeros(bodies),
        changed=np.zeros(bodies, np.int64),
        ends=np.zeros((contacts, 2), np.int64),
        place=np.full((contacts, 2), -1),
        normal=np.zeros((contacts, 3)),
        before=np.zeros(contacts),
        allowed=np.zeros(contacts),
        impulse=np.zeros(contacts),
        scale=np.zeros(contacts),
        ignored=np.zeros(contacts, np.bool_),
        active=np.zeros(contacts, np.int64),
        load=np.zeros(contacts),
        weight=np.zeros(contacts),
        z=np.zeros(3 * bodies),
        Q=np.zeros((contacts, 3 * bodies)),
        R=np.zeros((contacts, contacts)),
    )


@long_kernel
def find_impulses(bodies: int, contacts: int, negligible: float, group: Group) -> None:
    """Write the impulses of a group's bodies and contacts, and the velocities after them.

    A closing speed up to ``negligible`` (m/s) needs no impulse.
    """
    most, count = min(contacts, 3 * bodies), 0
    scale, ignored, active, load, weight = group.scale, group.ignored, group.active, group.load, group.weight
    z, Q, R = group.z[: 3 * bodies], group.Q[:most, : 3 * bodies], group.R[:most, :most]
    for c in range(contacts):
        group.impulse[c], ignored[c] = 0.0, False
        square = 0.0
        for end in range(2):
            k = group.place[c, end]
            square += group.root[k] * group.root[k] if k >= 0 else 0.0
        scale[c] = np.sqrt(square)
    for _ in range(MOST_CHANGES * contacts):
        worst, c = negligible, -1
        for k in range(contacts):
            excess = -_normal_velocity(k, group) - group.allowed[k]
            if excess > worst and not ignored[k]:
                worst, c = excess, k
        if c < 0:
            break
        added = 0.0
        while True:
            square = _project(c, count, scale[c], group, Q, R, weight, z)
            full = np.inf
            if square > DEPENDENT and count < most:
                full = (-_normal_velocity(c, group) - group.allowed[c]) / (scale[c] * square)
            partial, opened = np.inf, -1
            for k in range(count):
                if weight[k] > 0.0 and load[k] < partial * weight[k]:
                    partial, opened = load[k] / weight[k], k
            step = min(full, partial)
            if step == np.inf:  # the direction is a combination of held directions, and no held contact can open
                ignored[c] = True
                break
            if full < np.inf:
                for k in range(bodies):
                    for d in range(3):
                        group.v[k, d] += step * z[3 * k + d] * group.root[k]
            for k in range(count):
                load[k] = max(0.0, load[k] - step * weight[k])
            added += step
            if full <= partial:
                _extend(count, square, Q, R, weight, z)
                active[count], load[count] = c, added
                count += 1
                break
            for k in range(opened, count - 1):
                active[k], load[k] = active[k + 1], load[k + 1]
            count -= 1
            for k in range(count):  # all factors are computed again: a group is small, and contacts seldom open
                _extend(k, _project(active[k], k, scale[active[k]], group, Q, R, weight, z), Q, R, weight, z)
    for k in range(count):
        group.impulse[active[k]] = load[k] / scale[active[k]]


@inline
def _normal_velocity(c: int, group: Group) -> float:
    """Return v_n of a contact in the drift, in m/s; an end that does not move has no velocity."""
    vn = 0.0
    for end in range(2):
        k = group.place[c, end]
        if k >= 0:
            for d in range(3):
                vn += (2 * end - 1) * group.normal[c, d] * group.v[k, d]
    return vn


@inner
def _project(
    c: int, count: int, scale: float, group: Group, Q: FloatArray, R: FloatArray, weight: FloatArray, z: FloatArray
) -> float:
    """Write to ``z`` the component of a contact's direction that is orthogonal to all ``count`` held directions.

    Return the square of the length of this component. The components along the held directions are written to a column
    of ``R``. The rates at which the held impulses fall, as the impulse of the contact rises, are written to ``weight``.
    """
    z[:] = 0.0
    for end in range(2):
        k = group.place[c, end]
        if k >= 0:
            for d in range(3):
                z[3 * k + d] += (2 * end - 1) * group.normal[c, d] * group.root[k] / scale
    for k in range(count):
        weight[k] = 0.0
    for _ in range(2):  # a second pass removes the rounding errors of the first
        for k in range(count):
            component = 0.0
            for d in range(len(z)):
                component += Q[k, d] * z[d]
            weight[k] += component
            for d in range(len(z)):
                z[d] -= component * Q[k, d]
    if count < len(R):
        for k in range(count):
            R[k, count] = weight[k]
    for k in range(count - 1, -1, -1):
        for later in range(k + 1, count):
            weight[k] -= R[k, later] * weight[later]
        weight[k] /= R[k, k]
    square = 0.0
    for d in range(len(z)):
        square += z[d] * z[d]
    return square


@inline
def _extend(count: int, square: float, Q: FloatArray, R: FloatArray, weight: FloatArray, z: FloatArray) -> None:
    """Add the direction written by `_project` to the held directions."""
    length = np.sqrt(square)
    R[count, count] = length
    for d in range(len(z)):
        Q[count, d] = z[d] / length
