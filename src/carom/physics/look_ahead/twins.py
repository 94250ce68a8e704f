"""Runs that begin almost alike, and how they diverge."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from carom.arrays import FloatArray
from carom.physics.look_ahead.error_curve import with_start
from carom.scene.start import InitialBodies

APART = 1e-2  # of the size; beyond, twins no longer diverge exponentially
EPS = float(np.finfo(np.float64).eps)
MOST_GROWTH = 600.0  # of the logarithm of their distance, which stays finite


@dataclass(frozen=True, slots=True)
class Twins:
    """How two runs diverge that begin almost alike."""

    apart: FloatArray  # (K,) largest distance so far over the size
    exponent: float  # 1/s

    @classmethod
    def grown(cls, times: FloatArray, apart: FloatArray, began: float, known: int) -> Twins:
        """Continue the distance, (K,) over the size, beyond where it is no longer small.

        It is unknown, and infinite, from the time ``known`` on.
        """
        if known < len(apart):
            if not known:
                return cls(np.full(len(apart), np.inf), 0.0)
            part = cls.grown(times[:known], apart[:known], began, known)
            return cls(np.concatenate((part.apart, np.full(len(apart) - known, np.inf))), part.exponent)
        apart = np.maximum(apart, began)
        over = np.flatnonzero(~(apart < APART))
        last = int(over[0]) if len(over) else len(apart) - 1  # beyond, they are taken to diverge at the same rate
        apart[last] = min(apart[last], 1.0)
        exponent = math.log(apart[last] / began) / float(times[last])
        growth = np.minimum(max(exponent, 0.0) * (times[last + 1 :] - times[last]), MOST_GROWTH)
        apart[last + 1 :] = apart[last] * np.exp(growth)
        return cls(apart, exponent)

    def steps_that_count(self, began: float, steps: int) -> FloatArray:
        """Return how many steps with the error of the first add up to the error at all times, (K,).

        An error of a step grows like the distance G of twins: ∫ G(t - s) ds / G(t) over the length of a step. That is
        half the steps so far for regular motion, and those of the last 1 / λ for chaotic motion.
        """
        before = with_start(self.apart[:-1], began)
        growth = np.log(self.apart / before)
        mean = np.where(growth > 0.0, (self.apart - before) / np.where(growth > 0.0, growth, 1.0), before)
        return np.asarray(np.cumsum(mean) / self.apart * (steps / len(mean)))

    def continued(self, times: FloatArray, error: FloatArray, known: FloatArray) -> FloatArray:
        """Interpolate an error that all steps add to, and continue it where it is infinite; (K,) at all times, in s.

        It grows like t times the distance of twins, which is in proportion to t for regular motion.
        """
        finite = np.isfinite(error)
        if not finite.any():
            return np.ones(len(times))
        share = error[finite] / (known[finite] * np.interp(known[finite], times, self.apart))
        return np.asarray(times * self.apart * np.interp(times, known[finite], share))

    def at(self, times: FloatArray, known: FloatArray, began: float) -> Twins:
        """Interpolate to other times, in s; between known times the distance grows exponentially."""
        grown = np.log(np.maximum(with_start(self.apart, began), EPS**2))
        return Twins(np.exp(np.interp(times, with_start(known, 0.0), grown)), self.exponent)


def displaced(start: InitialBodies, distance: float) -> InitialBodies:
    """Return a start whose free bodies are displaced by an rms distance in m, or else by a last bit."""
    direction = 2.0 * np.random.default_rng(0).random(start.position.shape) - 1.0  # of rms length 1
    moved = start.position + distance * direction
    unmoved = np.nextafter(start.position, np.copysign(np.inf, direction))
    moved = np.where(moved == start.position, unmoved, moved)
    return replace(start, position=np.where(start.fixed[:, np.newaxis], start.position, moved))
