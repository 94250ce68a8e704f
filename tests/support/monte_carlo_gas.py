"""Rough spheres without positions: Boltzmann's equation of a homogeneous gas, by direct simulation Monte Carlo.

Bird, *Molecular Gas Dynamics and the Direct Simulation of Gas Flows* (1994): pairs are drawn at random and collide
with a probability proportional to the speed at which they approach, in a random direction. That has what a closure with
Maxwellian distributions leaves out (fast spheres spin faster than slow ones), and nothing of positions: no overlaps, no
flows, no memory of whom a sphere met before.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from periodic_gas import DIAMETER, INERTIA, MASS

FASTEST = 7.0  # thermal speeds; the approach of a pair is Gaussian with √2 of them, so 5 standard deviations
DRAWN = 0.4  # of the spheres in each round; about a tenth of them collides


def rough_gas(restitution: float, spheres: int, until: float, seed: int) -> NDArray[np.float64]:
    """Let spheres that stick in every contact cool; return rows of (collisions of a sphere, T_rot / T_tr)."""
    random = np.random.default_rng(seed)
    velocity = random.standard_normal((spheres, 3))
    velocity -= velocity.mean(axis=0)
    spin = random.standard_normal((spheres, 3)) * np.sqrt(0.5 / INERTIA)
    arm = DIAMETER / 2
    turning = 2 / MASS + 2 * arm**2 / INERTIA
    collisions, rows = 0, []
    while 2 * collisions < until * spheres:
        thermal = np.sqrt(np.mean(velocity**2))
        drawn = random.permutation(spheres)[: 2 * int(DRAWN * spheres / 2)]
        normal = random.standard_normal((len(drawn) // 2, 3))
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        approach = -np.sum((velocity[drawn[1::2]] - velocity[drawn[::2]]) * normal, axis=1)
        meets = approach > random.random(len(normal)) * FASTEST * thermal
        i, j, n, vn = drawn[::2][meets], drawn[1::2][meets], normal[meets], approach[meets, None]
        slip = velocity[j] - velocity[i] + vn * n - np.cross(arm * (spin[i] + spin[j]), n)
        impulse = (1 + restitution) * vn * n * MASS / 2 - slip / turning
        turn = arm / INERTIA * np.cross(n, impulse)
        velocity[i] -= impulse / MASS
        velocity[j] += impulse / MASS
        spin[i] -= turn
        spin[j] -= turn
        collisions += len(i)
        rows.append((2 * collisions / spheres, INERTIA * np.mean(spin**2) / (MASS * np.mean(velocity**2))))
    return np.array(rows)
