"""Writes asteroid-belt.csv, the bodies of asteroid-belt.toml: the Sun, Jupiter and a belt of asteroids.

    python configs/asteroid-belt.py

Orbits have small random eccentricities and inclinations, so that the belt is 0.1 au thick. Distances are in au, speeds
in au/day, masses in solar masses.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

ASTEROIDS = 600  # some of which are left out
NEAREST, FARTHEST = 2.0, 3.4  # au
G = 2.9591220819e-4  # au³/(solar mass day²)
JUPITER_MASS, JUPITER_DISTANCE = 9.5458e-4, 5.204  # solar masses, au
DRAWN_RADIUS = 0.008  # au, of the smallest asteroids: far too large, so that they are seen and meet
FILE = Path(__file__).with_suffix(".csv")


def table() -> tuple[list[str], FloatArray]:
    """Return names and rows x, y, z, vx, vy, vz, mass, radius."""
    rng = np.random.default_rng(18)
    distance = np.sqrt(rng.uniform(NEAREST**2, FARTHEST**2, ASTEROIDS))
    angle, tilt, node = (
        rng.uniform(0.0, 2.0 * np.pi, ASTEROIDS),
        rng.normal(0.0, 0.02, ASTEROIDS),
        rng.uniform(0.0, 2.0 * np.pi, ASTEROIDS),
    )
    outward = np.stack((np.cos(angle), np.sin(angle), tilt * np.sin(angle - node)), axis=1)
    along = np.stack((-np.sin(angle), np.cos(angle), tilt * np.cos(angle - node)), axis=1)
    speed = np.sqrt(G / distance)[:, None]
    velocity = speed * (along + rng.normal(0.0, 0.02, (ASTEROIDS, 3)))
    size = rng.pareto(2.5, ASTEROIDS) + 1.0
    radius = DRAWN_RADIUS * np.minimum(size, 4.0)
    mass = 1e-13 * np.minimum(size, 4.0) ** 3
    asteroids = np.column_stack((distance[:, None] * outward, velocity, mass, radius))
    asteroids = asteroids[_apart(asteroids[:, :3], radius)]
    jupiter = [JUPITER_DISTANCE, 0, 0, 0, np.sqrt(G * (1.0 + JUPITER_MASS) / JUPITER_DISTANCE), 0, JUPITER_MASS, 0.08]
    sun = [0, 0, 0, 0, 0, 0, 1.0, 0.15]
    names = ["Sun", "Jupiter", *(f"asteroid {number}" for number in range(1, len(asteroids) + 1))]
    return names, np.vstack((sun, jupiter, asteroids))


def _apart(position: FloatArray, radius: FloatArray) -> NDArray[np.bool_]:
    """Tell which spheres touch none before them."""
    distance = np.linalg.norm(position[:, None] - position, axis=2)
    touch = distance < 1.01 * (radius[:, None] + radius)  # the file has five digits
    return np.asarray(~np.tril(touch, -1).any(axis=1))


def main() -> None:
    """Write the file; five digits keep it small."""
    names, rows = table()
    lines = ["name,x,y,z,vx,vy,vz,mass,radius"]
    lines += [",".join([name, *(f"{value:.5g}" for value in row)]) for name, row in zip(names, rows, strict=True)]
    FILE.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
