"""Radii and masses of bodies, and of a group on average."""

from __future__ import annotations

import math

import numpy as np

from carom.arrays import FloatArray
from carom.scene.portable_math import power
from carom.scene.schema import Body, Group

DEFAULT_DENSITY = 1000.0  # kg/m³


def body_mass(body: Body) -> float:
    """Return the mass of a body in kg."""
    return float(mass_of(body, np.array(body.radius)))


def mean_mass(group: Group) -> float:
    """Return the expected mass of a body of a group in kg."""
    if group.mass is not None:
        return group.mass
    return (DEFAULT_DENSITY if group.density is None else group.density) * mean_volume(group)


@np.errstate(over="ignore")
def mass_of(matter: Body | Group, radius: FloatArray) -> FloatArray:
    """Return masses (n,) in kg for radii (n,) in m."""
    if matter.mass is not None:
        return np.asarray(matter.mass)
    density = DEFAULT_DENSITY if matter.density is None else matter.density
    return np.asarray(density * (4.0 / 3.0) * math.pi * radius * radius * radius)


def drawn_radii(group: Group, rng: np.random.Generator) -> FloatArray:
    """Draw radii by inverting the cumulative distribution."""
    low, high = group.radius.min, group.radius.max
    u = rng.random(group.count)
    if low == high:
        return np.full(group.count, low)
    if group.radius.distribution == "uniform":
        return low + (high - low) * u
    p = group.radius.exponent + 1.0
    if group.radius.distribution == "log-uniform" or p == 0.0:
        return np.asarray(np.clip(low * power(np.array(high / low), u), low, high))
    return np.asarray(np.clip(low * power(1 + u * (power(np.array(high / low), p) - 1), 1 / p), low, high))


def mean_volume(group: Group) -> float:
    """Return the mean volume of a sphere of the group, from a fixed sample of the radius distribution."""
    sample = group.model_copy(update={"count": 4096})
    radius = drawn_radii(sample, np.random.default_rng(0))
    return float(np.mean((4.0 / 3.0) * math.pi * radius * radius * radius))
