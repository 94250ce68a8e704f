"""Plummer's model of a star cluster (1911): positions, and velocities in equilibrium.

    M(<r) = M r³ / (r² + a²)^(3/2),    ψ(r) = G M / √(r² + a²)

Velocities have the distribution of the model, f(E) ∝ (-E)^(7/2). With the escape speed v_e = √(2 ψ) and v = q v_e,

    g(q) = q² (1 - q²)^(7/2)

is drawn by rejection (Aarseth, Hénon & Wielen 1974, A&A 37, 183).
"""

from __future__ import annotations

import numpy as np

from carom.arrays import FloatArray
from carom.physics.placement.region import PlummerModel
from carom.scene.portable_math import cube_root

EQUILIBRIUM = 0.5  # ratio of kinetic to potential energy in equilibrium
HIGHEST = 0.1  # a bound above the largest value of g(q), 0.092


def mass_within(distance: float, scale: float) -> float:
    """Return the fraction of the mass within a distance (m) of the centre, for the scale a (m)."""
    square = 1.0 + (scale / distance) * (scale / distance)
    return float(1.0 / (square * np.sqrt(square)))


def drawn_distances(scale: float, cut: float, count: int, rng: np.random.Generator) -> FloatArray:
    """Draw distances from the centre, (count,) m, up to a cut."""
    root = cube_root(rng.random(count) * mass_within(cut, scale))
    return np.asarray(scale * root / np.sqrt(1.0 - root * root))


def drawn_velocities(
    distance: FloatArray, scale: float, parameter: float, virial: float, rng: np.random.Generator
) -> FloatArray:
    """Draw isotropic velocities, (n, 3) m/s, at distances from the centre, (n,) m.

    ``parameter`` is G M of the whole model in m³/s², ``virial`` is the ratio of the kinetic to the potential energy.
    """
    q, missing = np.zeros(len(distance)), np.arange(len(distance))
    while len(missing):
        drawn, height = rng.random(len(missing)), HIGHEST * rng.random(len(missing))
        left = 1.0 - drawn * drawn
        accepted = height < drawn * drawn * left * left * left * np.sqrt(left)
        q[missing[accepted]] = drawn[accepted]
        missing = missing[~accepted]
    escape = np.sqrt(2.0 * parameter / np.sqrt(distance * distance + scale * scale))
    direction = rng.standard_normal((len(distance), 3))
    direction /= np.sqrt((direction * direction).sum(axis=1))[:, None]
    return np.asarray(direction * (np.sqrt(virial / EQUILIBRIUM) * q * escape)[:, None])


PLUMMER = PlummerModel(mass_within, drawn_distances, drawn_velocities)
