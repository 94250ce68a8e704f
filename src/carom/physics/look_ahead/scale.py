"""The size of a system, in which distances between runs are given."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from carom.arrays import FloatArray
from carom.physics.periodic_box import minimum_images
from carom.scene.schema import Scene
from carom.scene.start import InitialBodies


class Run(Protocol):
    """A run ahead."""

    @property
    def times(self) -> FloatArray:
        """(K,) s."""

    def at(self, sample: int) -> FloatArray | None:
        """Return the positions at one of the times, (n, 3) m; None where it failed before."""


@dataclass(frozen=True, slots=True)
class Scale:
    """The size of a system, and the distances of its states over it."""

    size: float  # m
    box: FloatArray | None  # (3,) m, of a periodic domain

    @classmethod
    def of(cls, scene: Scene, start: InitialBodies) -> Scale:
        """Return half the box, the rms distance of the bodies from their centre, or that of a single body from 0.

        The size of a single body at 0 is its radius.
        """
        if scene.domain.boundary == "periodic":
            box = np.array(scene.domain.size)
            return cls(float(box.min()) / 2.0, box)
        apart = start.position - start.position.mean(axis=0)
        size = math.sqrt(float(np.mean(np.sum(apart * apart, axis=1))))
        return cls(size or math.sqrt(float(np.sum(start.position[0] ** 2))) or float(start.radius.max()), None)

    def distance(self, a: FloatArray, b: FloatArray) -> float:
        """Return the rms distance between positions, (n, 3) m, over the size."""
        d = a - b if self.box is None else minimum_images(a - b, self.box)
        return math.sqrt(float(np.mean(np.sum(d * d, axis=1)))) / self.size

    def apart(self, one: Run, other: Run, enough: float) -> FloatArray:
        """Compare two runs until their distance is ``enough``; return the largest so far over the size, (K,)."""
        apart = np.full(len(one.times), np.inf)
        largest = 0.0
        for k in range(len(apart)):
            a, b = one.at(k), other.at(k)
            if a is None or b is None:
                break
            apart[k] = largest = max(largest, self.distance(a, b))
            if not largest < enough:
                break
        return apart
