"""Draws of numbers and vectors from coarse grids, by a generator of random numbers or by a test library.

The grids make ties, exact touches and exact zeros frequent, which is where mistakes live.
"""

from __future__ import annotations

import itertools
import random
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
Value = TypeVar("Value")

# Vectors of quarters up to 1 in each direction, the simplest first. One draw each: three would take most of the time.
QUARTERS = np.array(sorted(itertools.product(np.arange(-4, 5) / 4, repeat=3), key=lambda v: (np.abs(v).sum(), *v)))
DIRECTIONS = QUARTERS[1:] / np.linalg.norm(QUARTERS[1:], axis=1, keepdims=True)


class Draw(Protocol):
    """What draws."""

    def choice(self, *values: Value) -> Value:
        """Draw one of some values."""

    def integer(self, low: int, high: int) -> int:
        """Draw a whole number from low to high."""


class RandomDraw:
    """Draws with a seed."""

    def __init__(self, seed: str) -> None:
        self._rng = random.Random(seed)

    def choice(self, *values: Value) -> Value:
        """Draw one of some values."""
        return self._rng.choice(values)

    def integer(self, low: int, high: int) -> int:
        """Draw a whole number from low to high."""
        return self._rng.randint(low, high)


def one_in(draw: Draw, count: int) -> bool:
    """Draw true once in so many times."""
    return draw.integer(0, count - 1) == count - 1


def part(draw: Draw) -> float:
    """Draw a part of one, in eighths."""
    return draw.integer(0, 8) / 8


def decade(draw: Draw, low: int, high: int) -> float:
    """Draw from 10^low to 10^high, four values a decade."""
    return float(10.0 ** (draw.integer(4 * low, 4 * high) / 4))


def vector(draw: Draw) -> FloatArray:
    """Draw a vector of quarters up to 1 in each direction."""
    return np.asarray(QUARTERS[draw.integer(0, len(QUARTERS) - 1)])


def direction(draw: Draw) -> FloatArray:
    """Draw a unit vector."""
    return np.asarray(DIRECTIONS[draw.integer(0, len(DIRECTIONS) - 1)])


def row(values: FloatArray) -> list[float]:
    """Write a vector as a scene has it."""
    return [float(value) for value in values]
