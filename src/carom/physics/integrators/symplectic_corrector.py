"""The symplectic corrector of Wisdom–Holman integration; `wisdom_holman` has the Hamiltonian.

The terms in ε and all even powers of h are those of a change of variables, which a symplectic corrector undoes (Wisdom,
Holman & Touma 1996). The integration runs in the variables of the steps; the corrector leads into them at the start,
and out of them for output. With x for h times the rate of change along the orbits, its generator is H_mutual times
(1 - x/2 / sinh(x/2))/x. It is a product of `STAGES` factors

    drift(a h) kick(b h) drift(-2 a h) kick(-b h) drift(a h),        a = k `SPREAD`

each of which adds 2 b sinh(a x) in first order in ε; they agree with it up to x^{2 `STAGES` - 1}. Errors in
ε² h² remain.
"""

from __future__ import annotations

from fractions import Fraction
from math import factorial

import numpy as np

from carom.arrays import FloatArray
from carom.physics.integrators.jacobi import from_jacobi
from carom.physics.integrators.kepler import revolve_all
from carom.physics.integrators.mutual_pull import kick
from carom.physics.integrators.orbit_arrays import Orbits
from carom.physics.jit.decorators import unowned

STAGES = 4  # of the corrector
SPREAD = Fraction(2, 5)


def _corrector() -> tuple[FloatArray, FloatArray]:
    """Return a and b of the stages: Σ 2 b sinh(a x) = (1 - x/2 / sinh(x/2)) / x up to x^{2 STAGES - 1}."""
    # (x/2) / sinh(x/2) = Σ c_j x^{2j}, from sinh(x/2) / (x/2) = Σ x^{2j} / 4^j (2j+1)!
    quotient = [Fraction(1)]
    for j in range(1, STAGES + 1):
        quotient.append(-sum(quotient[j - i] / (4**i * factorial(2 * i + 1)) for i in range(1, j + 1)))
    spread = [SPREAD * k for k in range(1, STAGES + 1)]
    rows = [[*(2 * a ** (2 * j + 1) / factorial(2 * j + 1) for a in spread), -quotient[j + 1]] for j in range(STAGES)]
    for k in range(STAGES):  # Gauss–Jordan elimination; no pivot vanishes, as in any Vandermonde matrix
        rows[k] = [entry / rows[k][k] for entry in rows[k]]
        for j in range(STAGES):
            if j != k:
                rows[j] = [entry - rows[j][k] * pivot for entry, pivot in zip(rows[j], rows[k], strict=True)]
    return np.array([float(a) for a in spread]), np.array([-float(row[-1]) for row in rows])


CORRECTOR_DRIFT, CORRECTOR_KICK = _corrector()


@unowned
def drift(x: FloatArray, v: FloatArray, mu: FloatArray, lanes: FloatArray, h: float) -> None:
    """Move all on their Kepler orbits, and the centre of mass on a line."""
    for k in range(3):
        x[0, k] += h * v[0, k]
    revolve_all(x, v, mu, h, lanes)


@unowned
def correct(o: Orbits, x: FloatArray, v: FloatArray, h: float, into: bool) -> None:
    """Apply the corrector, or its inverse: into the variables of the steps or out of them."""
    waiting = 0.0  # drift that is not done yet
    for stage in range(STAGES):
        k = stage if into else STAGES - 1 - stage
        a, b = CORRECTOR_DRIFT[k], CORRECTOR_KICK[k]
        if not into:
            a = -a
        drift(x, v, o.mu, o.lanes, (waiting + a) * h)
        from_jacobi(x, o.share, o.place)
        kick(o, x, v, b * h)
        drift(x, v, o.mu, o.lanes, -2.0 * a * h)
        from_jacobi(x, o.share, o.place)
        kick(o, x, v, -b * h)
        waiting = a
    drift(x, v, o.mu, o.lanes, waiting * h)
