"""The contact table: impulses, mode and energies of the contacts of a step, one row per contact.

Impulses have the sign for body j, which receives ``normal_impulse`` along the normal and ``friction``; body i receives
the opposite. docs/physics.md, section 9, defines impulses, modes and energies.
"""

from __future__ import annotations

import numpy as np

MODES = ("impact", "sticking", "sliding", "resting", "open")  # `mode` is an index into these
IMPACT_MODE, STICKING, SLIDING, RESTING, OPEN = range(len(MODES))
# impact: closed faster than the rest speed; sticking, sliding: by Coulomb's law; resting: without friction in the
# model; open: touches without an impulse

CONTACT_ROW = np.dtype(
    [
        ("step", np.int64),
        ("time", np.float64),  # s, of the impact, or the end of the step
        ("i", np.int64),  # i < j
        ("j", np.int64),  # from n on: planes, as in the collision graph
        ("x", np.float64),  # m, the contact point
        ("y", np.float64),
        ("z", np.float64),
        ("nx", np.float64),  # the normal, from i to j
        ("ny", np.float64),
        ("nz", np.float64),
        ("approach_speed", np.float64),  # m/s, closing speed before the impulses; 0 if separating
        ("normal_impulse", np.float64),  # N s
        ("friction_x", np.float64),  # N s, the tangential impulse
        ("friction_y", np.float64),
        ("friction_z", np.float64),
        ("mode", np.uint8),
        ("restitution_loss", np.float64),  # J, dissipated by the normal impulse
        ("friction_loss", np.float64),  # J, dissipated by the tangential impulse
        ("stabilisation_gain", np.float64),  # J, injected by the position correction or the bias
    ],
    align=True,
)
NO_ROWS = np.empty(0, CONTACT_ROW)

ROUNDED_OVERLAP = 1e-13  # of a radius; largest overlap by rounding of bodies that just touch
