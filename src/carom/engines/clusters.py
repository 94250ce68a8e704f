"""Clusters: sets of bodies that touched nothing outside their set between two moments."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from carom.arrays import BoolArray, FloatArray, IntArray
from carom.engines.engine_contacts import Near
from carom.engines.source import Setup
from carom.physics.contact.islands import number_sets


@dataclass(frozen=True, slots=True)
class Clusters:
    """Sets of bodies that touched nothing outside their set between two moments."""

    label: IntArray  # (n,)
    count: int
    touched: BoolArray  # (count,) whether any body of the cluster may have touched
    judged: BoolArray  # (count,) whether the laws of all bodies of the cluster are known
    free: BoolArray  # (count,) whether the cluster is judged and touched nothing fixed

    def sum(self, values: FloatArray) -> FloatArray:
        """Add up values of bodies, (n,) or (n, 3), by cluster."""
        if values.ndim == 1:
            return np.asarray(np.bincount(self.label, values, self.count), dtype=np.float64)
        return np.stack([np.bincount(self.label, column, self.count) for column in values.T], axis=1)


def clusters_of(setup: Setup, near: Near, *, whole: bool) -> Clusters:
    """Divide the bodies into clusters; if ``whole``, make one cluster of all bodies, as for mutual attraction."""
    n = len(setup)
    anchored = np.zeros(n, bool)
    i, j = near.pairs.T
    plane = j >= n
    anchored[i[plane]] = True
    i, j = i[~plane], j[~plane]
    loose = ~(setup.fixed[i] | setup.fixed[j])
    anchored[i[setup.fixed[j]]] = True
    anchored[j[setup.fixed[i]]] = True
    touched = np.zeros(n, bool)
    touched[near.pairs[near.pairs < n]] = True
    if whole:
        label, count = np.zeros(n, dtype=np.int64), 1
        anchored |= setup.fixed.any()
    else:
        label = np.empty(n, dtype=np.int64)
        count = number_sets(i[loose], j[loose], label)
    strange = np.bincount(label, ~setup.judged, count) > 0
    held = np.bincount(label, anchored | setup.fixed, count) > 0
    return Clusters(label, count, np.bincount(label, touched, count) > 0, ~strange, ~strange & ~held)
