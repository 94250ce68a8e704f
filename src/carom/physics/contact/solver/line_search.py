"""An exact line search after each iteration of the solver.

An iteration passes a load from contact to contact, and only a small part of it where a light body lies between heavy
ones. Therefore the change s of all impulses in an iteration is repeated α times. α minimises the energy that the
solution minimises, and is limited so that no contact begins to pull (λ_n ≥ 0):

    α = -s·(v + c) / s·(A s),   v = (v_n, u) at the contacts, A s the change of v by the impulses s

In sums over bodies, whose velocities and spins s changes by p and t,

    s·v = Σ m p·v + I t·ω,    s·A s = Σ m p² + I t²

A ball squeezed between two that are 10⁹ times heavier then sinks by less than 10⁻¹¹ of its radius. Without the search
it sinks by 0.1 radii at a mass ratio of 10² (docs/physics.md, section 9).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from carom.physics.contact.constraints import BODIES_PER_BLOCK, ConstraintSystem
from carom.physics.contact.solver.repeat_change import repeat_change
from carom.physics.jit.decorators import inline, unowned
from carom.physics.jit.index import from_front

Records = NDArray[np.void]


@unowned
def line_search(first: int, end: int, system: ConstraintSystem) -> None:
    """Sum m p·v + I t·ω, and m p² + I t², over each of some blocks of bodies."""
    for block in range(first, end):
        _sum_up(block, system)


@inline
def _sum_up(block: int, system: ConstraintSystem) -> None:
    active, slope, curvature = system.active, 0.0, 0.0
    for k in range(block * BODIES_PER_BLOCK, min(len(active), (block + 1) * BODIES_PER_BLOCK)):
        body = system.bodies[from_front(active[k])]
        px, py, pz, m = body.dvx, body.dvy, body.dvz, body.mass
        slope += (px * body.vx + py * body.vy + pz * body.vz) * m
        curvature += (px * px + py * py + pz * pz) * m
        tx, ty, tz, inertia = body.dwx, body.dwy, body.dwz, body.inertia
        slope += (tx * body.wx + ty * body.wy + tz * body.wz) * inertia
        curvature += (tx * tx + ty * ty + tz * tz) * inertia
    sums = system.sums[block]
    sums.slope, sums.curvature = slope, curvature


@unowned
def step_length(found: Records, sums: Records) -> float:
    """Return α; 0 if repeating the change would not help."""
    slope, curvature, step_limit = 0.0, 0.0, np.inf
    for k in range(len(found)):
        slope += found[k].slope
        step_limit = min(step_limit, found[k].step_limit)
    for k in range(len(sums)):
        slope += sums[k].slope
        curvature += sums[k].curvature
    if slope >= 0.0 or curvature <= 0.0:
        return 0.0
    return min(-slope / curvature, step_limit)


@unowned
def extrapolate(first: int, end: int, system: ConstraintSystem) -> None:
    """Change the velocities of some blocks of bodies by α p and α t, and clear p and t."""
    alpha, active = system.settings[0].alpha, system.active
    for k in range(first * BODIES_PER_BLOCK, min(len(active), end * BODIES_PER_BLOCK)):
        repeat_change(system.bodies, from_front(active[k]), alpha)
