"""The push that removes an overlap of bodies at rest; see `position_correction`.

These formulas take doubles or lanes.
"""

from __future__ import annotations

from typing import Any

from carom.physics.contact.law import LAW
from carom.physics.parallel.jit import inline

# Of the rest speed; contacts that separate faster are not pushed. 1 also pushes slow rebounds (10 times the energy in
# the worst step); 0 leaves overlaps in a pile (a quarter of a radius while it forms).
MAX_SEPARATION = 0.1
ENOUGH = 1e-9  # of the sum of radii; smaller overlaps need no further iteration
ENOUGH_AS_NEEDED = 1e-5  # the same with sweeps as needed and quick ones; the next step has one iteration for them


@inline
def rebounds(material: Any, approach: float, rest_speed: float) -> bool:
    """Tell whether a contact that closes at a speed in m/s is an impact that rebounds; not for lanes."""
    return LAW.restitution(material, approach, rest_speed) > 0.0


@inline
def push_of(fraction: float, overlap: float, a: Any, b: Any) -> tuple[float, float, float, float]:
    """Return δ in m, the parts of it by which the bodies move, and the reduced mass μ in kg."""
    total = a.inverse_mass + b.inverse_mass
    return fraction * overlap, a.inverse_mass / total, b.inverse_mass / total, 1.0 / total


@inline
def part_of_tangent(d: float, delta: float) -> float:
    """Return d/(d + δ) - 1, the change of v_t over v_t."""
    return d / (d + delta) - 1.0


@inline
def gain_of(reduced: float, tx: float, ty: float, tz: float, scale: float) -> float:
    """Return the energy in J that scaling v_t by 1 + ``scale`` puts in."""
    return 0.5 * reduced * (tx * tx + ty * ty + tz * tz) * scale * (2.0 + scale)
