"""The records of contacts at the start of a step: cleared, with their geometry."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from carom.physics.contact.geometry import update_geometry
from carom.physics.contact.rolling import set_angular_impulse, set_change_of_angular_impulse, set_spin_before
from carom.physics.diagnostics.ledger import clear_terms
from carom.physics.jit.decorators import inline, long_kernel

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
Records = NDArray[np.void]

TOUCHING = 1e-9  # of the sum of radii; a smaller gap counts as contact, since iterations and rounding leave such gaps
CACHED_CONTACTS = 64  # contacts whose records fit into the first-level cache


@long_kernel
def begin_contacts(
    lo: int,
    hi: int,
    pairs: IntArray,
    x: FloatArray,
    radius: FloatArray,
    box: FloatArray,
    surface: FloatArray,
    offset: FloatArray,
    contacts: Records,
    states: Records,
    rounding: float,
    normals: FloatArray,
) -> None:
    """Clear the records of the contacts [lo, hi), find their geometry, and note whether they touch."""
    for first in range(lo, hi, CACHED_CONTACTS):
        end = min(hi, first + CACHED_CONTACTS)
        for c in range(first, end):
            _clear(contacts[c], states[c])
        update_geometry(first, end, pairs, x, radius, box, surface, offset, contacts, states)
        for c in range(first, end):
            contact, state = contacts[c], states[c]
            normals[c, 0], normals[c, 1], normals[c, 2] = contact.nx, contact.ny, contact.nz
            overlap = state.overlap
            state.found_overlap = max(0.0, overlap)
            reach = contact.arm_i + contact.arm_j + overlap
            state.apart = overlap < -(TOUCHING * reach + rounding)


@inline
def _clear(contact: Any, state: Any) -> None:
    """Clear the fields that `update_geometry` does not write."""
    contact.normal_mass = contact.tangent_mass = contact.velocity_bias = 0.0
    contact.normal_impulse = contact.friction_x = contact.friction_y = contact.friction_z = 0.0
    contact.delta_normal = contact.delta_x = contact.delta_y = contact.delta_z = 0.0
    set_angular_impulse(contact, 0.0, 0.0, 0.0)
    set_change_of_angular_impulse(contact, 0.0, 0.0, 0.0)
    set_spin_before(contact, 0.0, 0.0, 0.0)
    state.rest_speed = state.approach_speed = 0.0
    state.normal_before = state.slip_x = state.slip_y = state.slip_z = 0.0
    clear_terms(state)
    state.push_x = state.push_y = state.push_z = state.push_fraction = 0.0
    state.biased = False
