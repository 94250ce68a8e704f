"""The contact table: impulses, mode and energies of the contacts of a step, one row per contact.

Impulses have the sign for body j, which receives ``normal_impulse`` along the normal and ``friction``; body i receives
the opposite. docs/physics.md, section 9, defines impulses, modes and energies.
"""

from __future__ import annotations

from typing import Annotated, Protocol

import numpy as np

from carom.arrays import dtype_of

MODES = ("impact", "sticking", "sliding", "resting", "open")  # `mode` is an index into these
IMPACT_MODE, STICKING, SLIDING, RESTING, OPEN = range(len(MODES))
# impact: closed faster than the rest speed; sticking, sliding: by Coulomb's law; resting: without friction in the
# model; open: touches without an impulse


class ContactRow(Protocol):
    """A row of the contact table."""

    step: int
    time: float  # s, of the impact, or the end of the step
    i: int  # i < j
    j: int  # from n on: planes, as in the collision graph
    x: float  # m, the contact point
    y: float
    z: float
    nx: float  # the normal, from i to j
    ny: float
    nz: float
    approach_speed: float  # m/s, closing speed before the impulses; 0 if separating
    normal_impulse: float  # N s
    friction_x: float  # N s, the tangential impulse
    friction_y: float
    friction_z: float
    mode: Annotated[int, np.uint8]
    restitution_loss: float  # J, dissipated by the normal impulse
    friction_loss: float  # J, dissipated by the tangential impulse
    stabilisation_gain: float  # J, injected by the position correction or the bias


CONTACT_ROW = dtype_of(ContactRow)
NO_ROWS = np.empty(0, CONTACT_ROW)

ROUNDED_OVERLAP = 1e-13  # of a radius; largest overlap by rounding of bodies that just touch
