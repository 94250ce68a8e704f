"""Orbits about the dominant body, and how near others have to come to disturb them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from carom.arrays import FloatArray
from carom.physics.integrators.kepler import TURN

HILL_RADII = 12.0  # within which bodies are close whose orbits cross (docs/validation.md)
FEWEST_HILL_RADII = 3.0  # where orbits are farther apart than that, bodies are not close in passing
PART_OF_GAP = 0.9  # of the distance between two orbits: within it, both have left them
NEAREST = 0.03  # of the semi-major axis: passages closer than that are left to Gauss–Radau integration


class Conics(NamedTuple):
    """Orbits about the dominant body, (n,) each."""

    axis: FloatArray  # m, semi-major; infinite if unbound
    size: FloatArray  # m, semi-major; its modulus if unbound
    pericentre: FloatArray  # m
    apocentre: FloatArray  # m
    turn: FloatArray  # s, of a circular motion with the angular speed at the pericentre


def conics(position: FloatArray, velocity: FloatArray, pull: FloatArray, first: int) -> Conics:
    """Return the orbits about the dominant body, ``first``, as they are now; its own axis is -1."""
    x, y, z = (position - position[first]).T
    u, v, w = (velocity - velocity[first]).T
    mu = pull + pull[first]
    with np.errstate(divide="ignore", invalid="ignore"):
        beta = 2.0 * mu / np.sqrt(x * x + y * y + z * z) - (u * u + v * v + w * w)
        size = mu / np.abs(beta)
        spin = (y * w - z * v, z * u - x * w, x * v - y * u)
        parameter = (spin[0] * spin[0] + spin[1] * spin[1] + spin[2] * spin[2]) / mu
        e = np.sqrt(np.maximum(1.0 - beta * parameter / mu, 0.0))
        pericentre = parameter / (1.0 + e)
        resolved = np.maximum(pericentre, NEAREST * size)
        turn = TURN * np.sqrt(resolved * resolved * resolved / (mu * (1.0 + e)))
        axis = np.where(beta > 0.0, size, np.inf)
        apocentre = np.where(beta > 0.0, size * (1.0 + e), np.inf)
    axis[first] = -1.0
    return Conics(axis, size, pericentre, apocentre, turn)


def near(conics: Conics, hill_ratio: FloatArray, first: int) -> FloatArray:
    """Return the distances in m from which bodies are close to others, (n,).

    ``hill_ratio`` has the Hill radii over the semi-major axes, (n,).
    """
    hill = hill_ratio * np.minimum(conics.size, np.where(conics.axis < np.inf, np.inf, conics.pericentre))
    close = HILL_RADII * hill
    close[first] = 0.0
    for i in range(len(close)):
        if i == first:
            continue
        gap = np.maximum(conics.pericentre - conics.apocentre[i], conics.pericentre[i] - conics.apocentre)
        gap[[i, first]] = np.inf
        if gap.min() > FEWEST_HILL_RADII * hill[i]:
            close[i] = min(close[i], max(FEWEST_HILL_RADII * hill[i], PART_OF_GAP * gap.min()))
    return close
