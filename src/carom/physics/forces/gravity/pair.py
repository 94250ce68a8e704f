"""The gravity of a pair of bodies: the only copy of its formulas, which kernels inline.

    a_i = G m_j d / R³      a_j = -G m_i d / R³      φ_i = -G m_j / R      d = x_j - x_i,  R² = d² + ε²

Without softening, coincident bodies neither attract each other nor have a potential, since both are undefined.

Each pair needs one square root and one division. All sums over pairs use these expressions, so integrators and methods
that sum pairs in the same order agree to the last bit. Only vector instructions have a separate form
(`fast_multipole.taylor.attract_bodies`).
"""

from __future__ import annotations

import numpy as np

from carom.physics.jit.decorators import inline


@inline
def attraction(gm: float, r2: float) -> float:
    """Return gm / R³. Times d, it is the acceleration by a body with G m = ``gm``; times -R², the body's potential.

    The result is 0 for coincident bodies without softening.
    """
    by_distance: float = gm / (r2 * np.sqrt(r2)) if r2 > 0.0 else 0.0
    return by_distance


@inline
def mutual_attraction(
    dx: float, dy: float, dz: float, gm_i: float, gm_j: float, eps2: float
) -> tuple[float, float, float]:
    """Return gm_j / R³ and gm_i / R³ of a pair, the accelerations of i and j divided by d, and R² in m²."""
    r2 = dx * dx + dy * dy + dz * dz + eps2
    inverse_cube = attraction(1.0, r2)
    return gm_j * inverse_cube, gm_i * inverse_cube, r2


@inline
def own_potential(eps2: float) -> float:
    """Return 1/ε, the contribution of a softened body of mass 1 to the sum at its own position; 0 without softening."""
    return attraction(eps2, eps2)
