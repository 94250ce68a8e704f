"""Momentum and angular momentum, and their errors.

    p = Σ m v,    L = Σ (m x × v + I ω)

Contacts and direct gravity conserve both to round-off. A uniform field g changes them in closed form, because the
centre of mass X moves on a parabola:

    p(t) = p₀ + M g t,    L(t) = L₀ + M (X₀ t + ½ V₀ t²) × g

With drag, the impulses of the medium and the field are booked step by step instead. Planes, walls and fixed bodies take
up both momenta; nothing is compared then.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carom.physics.bodies import Bodies
from carom.physics.diagnostics.motion import Motion

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Momentum:
    """Momentum at one time and its relative errors."""

    linear: FloatArray  # (3,) kg m/s
    angular: FloatArray  # (3,) kg m²/s about the origin
    linear_error: float | None  # over the largest Σ m |v| so far; None if something is fixed
    angular_error: float | None  # over the largest Σ (m |x| |v| + I |ω|) so far; None likewise, and in a periodic box


@dataclass(frozen=True, slots=True)
class MomentumBaseline:
    """Reference values: the momenta at the start, and the largest sums of magnitudes so far."""

    linear: tuple[float, float, float]  # kg m/s
    angular: tuple[float, float, float]  # kg m²/s
    centre: tuple[float, float, float]  # m, the centre of mass
    linear_scale: float  # kg m/s
    angular_scale: float  # kg m²/s


class MomentumAccount:
    """Compares momentum with its value at the start."""

    def __init__(self, bodies: Bodies, field: FloatArray, periodic: bool, anchored: bool = False) -> None:
        self._field = field
        self._has_field = bool(field.any())
        self._periodic = periodic
        self._anchored = anchored
        self._linear, self._angular, self._linear_scale, self._angular_scale, *_ = Motion.of(bodies)
        self._mass = float(bodies.mass.sum())
        self._centre = (bodies.mass[:, np.newaxis] * bodies.position).sum(axis=0) / self._mass
        self._baseline: MomentumBaseline | None = None  # None where it has changed since it was last asked for

    @property
    def baseline(self) -> MomentumBaseline:
        """The reference values; set them to continue an earlier run."""
        if self._baseline is None:
            linear, angular, centre = (tuple(vector.tolist()) for vector in (self._linear, self._angular, self._centre))
            self._baseline = MomentumBaseline(linear, angular, centre, self._linear_scale, self._angular_scale)
        return self._baseline

    @baseline.setter
    def baseline(self, known: MomentumBaseline) -> None:
        self._linear, self._angular, self._centre = map(np.array, (known.linear, known.angular, known.centre))
        self._linear_scale, self._angular_scale = known.linear_scale, known.angular_scale
        self._baseline = known

    def receive(self, linear: FloatArray, angular: FloatArray) -> None:
        """Add momenta that came from outside to the reference values."""
        self._linear, self._angular = self._linear + linear, self._angular + angular
        self._baseline = None

    def balance(self, motion: Motion, time: float) -> Momentum:
        """Return the momenta at a time since the start, in seconds."""
        linear, angular, linear_scale, angular_scale, *_ = motion
        if linear_scale > self._linear_scale or angular_scale > self._angular_scale:
            self._linear_scale = max(self._linear_scale, linear_scale)
            self._angular_scale = max(self._angular_scale, angular_scale)
            self._baseline = None
        expected_linear, expected_angular = self._expected(time)
        return Momentum(
            linear=linear,
            angular=angular,
            linear_error=None if self._anchored else _relative(linear, expected_linear, self._linear_scale),
            angular_error=None
            if self._periodic or self._anchored
            else _relative(angular, expected_angular, self._angular_scale),
        )

    def _expected(self, time: float) -> tuple[FloatArray, FloatArray]:
        if not self._has_field:
            return self._linear, self._angular
        weight = self._mass * self._field
        path = self._centre * time + 0.5 * (self._linear / self._mass) * time * time
        return self._linear + weight * time, self._angular + np.cross(path, weight)


def _relative(found: FloatArray, expected: FloatArray, scale: float) -> float:
    x, y, z = (found - expected).tolist()
    return math.sqrt(x * x + y * y + z * z) / scale if scale > 0.0 else 0.0
