"""Shapes of clouds of bodies for tests of gravity, and the direct sum beside which they are summed."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from carom.physics.forces.gravity import GravityMethod
from carom.physics.forces.gravity.direct import DirectGravity

FloatArray = NDArray[np.float64]


def directions(n: int, seed: int) -> FloatArray:
    v = np.random.default_rng(seed).standard_normal((n, 3))
    return np.asarray(v / np.linalg.norm(v, axis=1)[:, None])


def plummer(n: int) -> FloatArray:
    u = np.random.default_rng(1).uniform(0.0, 0.999, n)
    return directions(n, 2) / np.sqrt(u ** (-2 / 3) - 1)[:, None]


def ball(n: int) -> FloatArray:
    return directions(n, 3) * np.random.default_rng(4).uniform(0.0, 1.0, n)[:, None] ** (1 / 3)


def disc(n: int) -> FloatArray:
    return plummer(n) * [1.0, 1.0, 1e-3]


def string(n: int) -> FloatArray:
    return np.linspace(-1.0, 1.0, n)[:, None] * [1.0, 2.0, -0.5]


def with_one_far_away(n: int) -> FloatArray:
    position = plummer(n)
    position[n // 2] = [1e9, -1e9, 3e8]
    return position


def far_from_the_origin(n: int) -> FloatArray:
    return np.asarray(plummer(n) + [1e6, -1e6, 1e6])  # noqa: RUF005 - a sum, not a list that grows


def nested(n: int) -> FloatArray:
    """A cluster of clusters, each 10⁻⁴ of the last one's size: deeper than 63 bits of keys can tell apart."""
    return ball(n) * 1e-4 ** np.arange(n).__mod__(6)[:, None]


def many_at_few_points(n: int) -> FloatArray:
    return plummer(8)[np.arange(n) % 8]


Shape = Callable[[int], FloatArray]
SHAPES: tuple[Shape, ...] = (
    plummer,
    ball,
    disc,
    string,
    with_one_far_away,
    far_from_the_origin,
    nested,
    many_at_few_points,
)


def masses(n: int, decades: float = 1.0) -> FloatArray:
    return np.asarray(10.0 ** np.random.default_rng(5).uniform(0.0, decades, n) / n)


def pulled_by(gravity: GravityMethod, position: FloatArray) -> tuple[FloatArray, float | None]:
    """Accelerations and the potential energy by a method."""
    acceleration = np.empty_like(position)
    return acceleration, gravity.accelerate(position, acceleration, potential=True)


def summed(position: FloatArray, mass: FloatArray, softening: float = 0.0) -> tuple[FloatArray, float | None]:
    """The direct sum."""
    return pulled_by(DirectGravity(mass, 1.0, softening), position)


def total_pull(position: FloatArray, mass: FloatArray, softening: float) -> FloatArray:
    """The sum of the magnitudes of all accelerations of each body: where these cancel, their errors need not."""
    d2 = np.sum((position[None, :, :] - position[:, None, :]) ** 2, axis=2)
    pull = np.divide(np.sqrt(d2), (d2 + softening**2) ** 1.5, out=np.zeros_like(d2), where=d2 > 0.0)
    return np.asarray(np.sum(mass * pull, axis=1))


def errors(found: FloatArray, expected: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.norm(found - expected, axis=1) / np.linalg.norm(expected, axis=1))
