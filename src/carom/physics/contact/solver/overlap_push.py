"""The push that removes the overlap of a contact at rest; see `position_correction`.

The formulas take doubles or lanes.
"""

from __future__ import annotations

from typing import Any

from carom.physics.jit.decorators import inline

# Of the rest speed; contacts that separate faster are not pushed. 1 also pushes slow rebounds (10 times the energy in
# the worst step); 0 leaves overlaps in a pile (a quarter of a radius while it forms).
MAX_SEPARATION = 0.1
ENOUGH = 1e-9  # of the sum of radii; smaller overlaps need no further iteration
ENOUGH_AS_NEEDED = 1e-5  # with sweeps as needed or quick; what is left is pushed in the next step


@inline
def separates(vn: float, rest_speed: float, e: float) -> bool:
    """Tell whether a contact clears itself, and is not pushed: it separates, or rebounds with e.

    Parameters
    ----------
    vn, rest_speed
        m/s
    """
    return (vn > MAX_SEPARATION * rest_speed) | (e > 0.0)


@inline
def push_of(fraction: float, overlap: float, a: Any, b: Any) -> tuple[float, float, float, float]:
    """Return δ in m, the parts of it by which the bodies move, and the reduced mass μ in kg."""
    total = a.inverse_mass + b.inverse_mass
    return fraction * overlap, a.inverse_mass / total, b.inverse_mass / total, 1.0 / total


@inline
def relative_change_of_vt(d: float, delta: float) -> float:
    """Return σ = d/(d + δ) - 1, the relative change of v_t."""
    return d / (d + delta) - 1.0


@inline
def gain_of(reduced: float, tx: float, ty: float, tz: float, sigma: float) -> float:
    """Return ½ μ v_t² σ (2 + σ), the energy in J that scaling v_t by 1 + σ puts in."""
    return 0.5 * reduced * (tx * tx + ty * ty + tz * tz) * sigma * (2.0 + sigma)
