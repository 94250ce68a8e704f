"""Newton's restitution and Coulomb's friction, the contact law of scenes that choose none; see `contact.law`.

An impact rebounds with the coefficient e, and a contact at rest does not rebound. Friction is bounded:

    v_n' = -e v_n
    |J_t| ≤ μ_s J_n where the contact sticks,  |J_t| = μ_k J_n against the slip where it slides
"""

from __future__ import annotations

import numpy as np

from carom.physics.jit.decorators import inline
from carom.scene.schema import Coefficients

REACHED = 1e-9  # relative deviation from μ_k λ_n up to which a contact slides; sums over iterations err by 1e-15


@inline
def restitution(material: Coefficients, approach: float, rest_speed: float) -> float:
    """Return the restitution e; 0 for contacts that close no faster than the rest speed."""
    return material.restitution if approach > rest_speed else 0.0


@inline
def dissipates(material: Coefficients) -> bool:
    """Return whether e < 1."""
    e: float = material.restitution
    return e < 1.0


@inline
def impact_friction(material: Coefficients, normal: float, stopping: float) -> float:
    """Return the impulse that ends the slip, or kinetic friction if static friction is too weak to end the slip."""
    return material.kinetic_friction * normal if stopping > material.static_friction * normal else stopping


@inline
def lasting_friction(
    material: Coefficients, normal: float, tx: float, ty: float, tz: float
) -> tuple[float, float, float]:
    """Return a tangential impulse, reduced to kinetic friction outside the friction cone."""
    squared = tx * tx + ty * ty + tz * tz
    most = material.static_friction * normal
    if squared > most * most:
        scale = material.kinetic_friction * normal / np.sqrt(squared)
        tx, ty, tz = scale * tx, scale * ty, scale * tz
    return tx, ty, tz


@inline
def sliding_friction(
    material: Coefficients, normal: float, tx: float, ty: float, tz: float
) -> tuple[float, float, float]:
    """Return a tangential impulse, reduced to kinetic friction where it is larger."""
    squared = tx * tx + ty * ty + tz * tz
    most = material.kinetic_friction * normal
    if squared > most * most:
        scale = most / np.sqrt(squared)
        tx, ty, tz = scale * tx, scale * ty, scale * tz
    return tx, ty, tz


@inline
def sticks(material: Coefficients, normal: float, tx: float, ty: float, tz: float) -> bool:
    """Return whether a tangential impulse is inside the friction cone."""
    most: float = material.static_friction * normal
    return tx * tx + ty * ty + tz * tz < most * most


@inline
def slides(material: Coefficients, normal: float, tx: float, ty: float, tz: float) -> bool:
    """Return whether |λ_t| = μ_k λ_n; where a contact sticks, |λ_t| may also lie between μ_k λ_n and μ_s λ_n."""
    tangential: float = np.sqrt(tx * tx + ty * ty + tz * tz)
    kinetic: float = material.kinetic_friction * normal
    static: float = material.static_friction * normal
    holds = (1.0 + REACHED) * kinetic < tangential <= (1.0 + REACHED) * static
    return tangential >= (1.0 - REACHED) * kinetic and not holds


@inline
def rolling(
    material: Coefficients, normal: float, radius: float, x: float, y: float, z: float
) -> tuple[float, float, float]:
    """Return 0: nothing resists rolling."""
    return 0.0, 0.0, 0.0


@inline
def twisting(material: Coefficients, normal: float, radius: float, stopping: float) -> float:
    """Return 0: nothing resists twisting."""
    return 0.0
