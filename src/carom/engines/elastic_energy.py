"""Energy that contacts of another engine may return, or add when they part overlapping bodies."""

from __future__ import annotations

import numpy as np

from carom.arrays import FloatArray
from carom.engines.clusters import Clusters
from carom.engines.engine_contacts import MARGIN, EngineMoment, Near
from carom.engines.missed_impacts import SHALLOW
from carom.engines.source import Setup

TINY = float(np.finfo(np.float64).tiny)  # replaces 0 as a divisor
# In MuJoCo, soft contacts of a body with several others return up to three times the energy that they absorbed, because
# each spring has the stiffness of a contact alone. Such contacts overlap by more than `DEEP`, in smaller radii.
COUPLED, DEEP = 3.0, 0.05
# Fraction of an overlap that engines turn into speed in a step to part the bodies: 0.2 in ODE, Bullet and Box2D.
PARTED = 0.25


class ElasticEnergy:
    """The energy that contacts have absorbed from each body since it was last free."""

    def __init__(self, setup: Setup) -> None:
        self._setup = setup
        self.owed = np.zeros(len(setup))  # J, by body

    def credit(self, near: Near, clusters: Clusters) -> FloatArray:
        """Return the factors by which contacts of each cluster may return more energy than they absorbed, (count,)."""
        plane = near.pairs[:, 1] >= len(self._setup)
        owner = np.where(plane | ~self._setup.fixed[near.pairs[:, 0]], near.pairs[:, 0], near.pairs[:, 1] * ~plane)
        deep = np.bincount(clusters.label[owner], near.gap_now < -DEEP * near.small, clusters.count)
        return np.where(deep > 1, COUPLED, 1.0)

    def by_parting(self, before: EngineMoment, now: EngineMoment, near: Near, clusters: Clusters) -> FloatArray:
        """Return the energy (count,) that an engine may add to each cluster when it parts overlapping bodies.

        The engine lifts bodies in the field by at most their overlap, or gives them the speed of `PARTED` overlaps per
        step.
        """
        setup, dt = self._setup, now.time - before.time
        if not dt > 0.0 or len(near) == 0:
            return np.zeros(clusters.count)
        n, plane = len(setup), near.pairs[:, 1] >= len(setup)
        overlap = np.maximum(-np.minimum(near.gap_before, near.gap_now), 0.0)
        closing = np.maximum(-np.einsum("ij,ij->i", near.relative_before, near.normal), 0.0) * dt
        deep = np.where(np.minimum(near.gap_before - closing, near.gap_now) <= 0.0, overlap + closing, 0.0)
        reach = np.zeros(n)
        for ends, rows in ((near.pairs[:, 0], slice(None)), (near.pairs[~plane, 1], ~plane)):
            np.maximum.at(reach, ends, deep[rows])
        moved = now.position - before.position - 0.5 * dt * (before.velocity + now.velocity)
        strength = setup.field_strength
        lifted = setup.mass * np.clip(-(moved @ setup.gravity), 0.0, strength * reach)
        lifted[setup.fixed] = 0.0
        parting = np.maximum(-near.closing_now, 0.0)
        # the field may act before and after an impact in the step, and the impact reverses the velocity
        speed = np.minimum(PARTED * overlap / dt + strength * dt, parting)
        pushed = np.where(deep > 0.0, speed * (parting - 0.5 * speed) * reduced_masses(self._setup, near), 0.0)
        loose, other = ~setup.fixed[near.pairs[:, 0]], np.minimum(near.pairs[:, 1], n - 1)
        owner = np.where(loose, near.pairs[:, 0], other)
        return clusters.sum(lifted) + np.bincount(clusters.label[owner], pushed, clusters.count)

    def book(self, clusters: Clusters, near: Near, owed: FloatArray) -> None:
        """Divide the energy absorbed by contacts among each cluster's bodies, like the energy of springs.

        The energy belongs to overlapping bodies, and stays with them when others part. Bodies without contacts get none
        of it.
        """
        label, n = clusters.label, len(self._setup)
        squares = np.maximum(-near.gap_now, SHALLOW * near.small) ** 2 * reduced_masses(self._setup, near)
        squares[near.gap_now > MARGIN * near.small] = 0.0
        squares[near.pairs[:, 1] < n] *= 0.5  # half to each body
        weight = np.full(n, np.sqrt(TINY))  # weight of a body that overlaps no other
        for end in near.pairs.T:
            np.add.at(weight, end[end < n], squares[end < n])
        self.owed = np.where(clusters.touched[label], (owed / clusters.sum(weight))[label] * weight, 0.0)


def reduced_masses(setup: Setup, near: Near) -> FloatArray:
    """Return the reduced mass (k,) of each pair in kg; 0 if both ends are fixed."""
    inverse = np.append(np.where(setup.fixed, 0.0, 1.0 / setup.mass), np.zeros(len(setup.planes)))
    weight = inverse[near.pairs].sum(axis=1)
    return np.where(weight > 0.0, 1.0 / np.where(weight > 0.0, weight, 1.0), 0.0)
