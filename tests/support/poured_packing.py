"""Random packings of equal spheres: how they are poured, and how much of the space in their midst they fill.

Units: diameter 1 m, mass 1 kg, g = 1 m/s².
"""

from __future__ import annotations

from math import pi

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from carom.physics.space import Space
from carom.scene.load import Scene

FloatArray = NDArray[np.float64]

DIAMETER = 1.0  # m
POURED = 0.28  # packing fraction of the random start
POINTS = 200_000  # at which the filling of the midst is sampled: to 0.1 %


def pour(count: int, width: float, friction: float, settling: float, until: float, sweeps: int, seed: int) -> Space:
    """Let spheres settle in a box through a liquid that slows them, as Onoda & Liniger (1990) did.

    The liquid is the scene's drag: spheres sink with g τ and touch without an impact.

    Parameters
    ----------
    settling
        s, τ.
    until
        s.
    """
    size = [width, width, count * pi / 6 / (POURED * width**2)]
    space = Space(
        Scene.from_dict(
            {
                "seed": seed,
                "time": {"duration": until, "cfl": 0.05},
                "gravity": {"constant": 0.0, "uniform": [0, 0, -1]},
                "drag": {"relaxation_time": settling},
                "contact": {
                    "restitution": 0.0,
                    "static_friction": friction,
                    "kinetic_friction": friction,
                    "sweeps": sweeps,
                },
                "domain": {"boundary": "walls", "size": size},
                "record": {"check_every": 1_000_000},
                "group": [
                    {"count": count, "radius": DIAMETER / 2, "mass": 1.0, "region": {"shape": "box", "size": size}}
                ],
            }
        ),
        threads=1,
    )
    for _ in space.run():
        pass
    return space


def midst(space: Space, margin: float = 2.5) -> tuple[FloatArray, FloatArray]:
    """Return two corners of the box that is so many diameters away from walls, floor and surface, where order ends."""
    half = np.array(space.scene.domain.size) / 2
    surface = float(np.quantile(space.state.position[:, 2], 0.97))
    return margin * DIAMETER - half, np.array([*half[:2], surface]) - margin * DIAMETER


def packing_fraction(space: Space) -> float:
    """Measure how much of the midst is filled, at random points: those within a radius of the nearest centre."""
    points = np.random.default_rng(0).uniform(*midst(space), (POINTS, 3))
    nearest, _ = cKDTree(space.state.position).query(points)
    return float(np.mean(nearest <= DIAMETER / 2))


def contacts_of_a_body(space: Space, fewest: int) -> float:
    """Count the contacts of a sphere in the midst, without rattlers: those that fewer contacts cannot hold."""
    n, pairs = len(space.state), space.contacts.pairs
    held = np.ones(n + len(space.planes), dtype=bool)
    while True:
        kept = pairs[held[pairs].all(axis=1)]
        count = np.bincount(kept.ravel(), minlength=len(held))
        rattlers = held[:n] & (count[:n] < fewest)
        if not rattlers.any():
            break
        held[:n] &= ~rattlers
    low, high = midst(space)
    inside = ((space.state.position > low) & (space.state.position < high)).all(axis=1)
    return float(count[:n][inside & held[:n]].mean())
