"""The distribution of normal forces, and the chains that carry large ones.

Chains are those of Peters, Muthuswamy, Wibowo & Tordesillas, Phys. Rev. E 72, 041307 (2005): the stress of a body is
σ = Σ r f n ⊗ n over its contacts, divided by its volume; a body belongs to a chain if its largest principal stress is
above the mean, and two such bodies are linked if they touch along the principal direction of both, to 45°. A chain has
at least three bodies.
"""

from __future__ import annotations

from math import pi, sqrt

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from carom.arrays import FloatArray, IntArray
from carom.extend import FORCE
from carom.lab.statistics.interval import Interval
from carom.lab.statistics.statistic import Histogram, MeasuredValue, Statistic

ALONG = 1 / sqrt(2)  # cos 45°
SHORTEST = 3  # bodies of a chain


def measure(interval: Interval) -> Statistic:
    """Measure the forces of lasting contacts, and their chains frame by frame."""
    contacts = interval.contacts
    mean = float(contacts.force.mean())
    ratio = contacts.force / mean
    chains = [
        size
        for frame in range(contacts.frames)
        for size in chains_of(
            np.stack([contacts.i, contacts.j], axis=1)[contacts.frame == frame],
            contacts.normal[contacts.frame == frame],
            contacts.force[contacts.frame == frame],
            interval.recording.bodies.radius,
        )
    ]
    bodies = np.count_nonzero(interval.moving) * contacts.frames
    values = {
        "mean_force": MeasuredValue("mean normal force", mean, FORCE),
        "largest_force": MeasuredValue("largest", float(contacts.force.max()), FORCE),
        "second_moment": MeasuredValue("⟨f²⟩/⟨f⟩²", float(np.mean(ratio * ratio))),
        "strong": MeasuredValue("contacts with more than the mean", float(np.mean(ratio > 1.0))),
        "friction": MeasuredValue("friction / normal force, mean", float(np.mean(contacts.friction / contacts.force))),
        "chains": MeasuredValue("chains, of a frame", len(chains) / contacts.frames),
        "chain_length": MeasuredValue("bodies of a chain", float(np.mean(chains)) if chains else 0.0),
        "longest_chain": MeasuredValue("… of the longest", int(max(chains, default=0))),
        "in_chains": MeasuredValue("bodies in chains", sum(chains) / bodies),
    }
    return Statistic(values, {"forces": Histogram.of("normal force / mean", ratio, falls=True)})


def chains_of(pairs: IntArray, normal: FloatArray, force: FloatArray, radius: FloatArray) -> list[int]:
    """Return the number of bodies of each force chain.

    Parameters
    ----------
    pairs
        (k, 2) the ends of contacts; from n on planes.
    normal
        (k, 3) from the first end to the second.
    force
        (k,) N.
    radius
        (n,) m.
    """
    n, bodies = len(radius), pairs < len(radius)
    stress = np.zeros((n, 3, 3))
    dyads = force[:, None, None] * normal[:, :, None] * normal[:, None, :]
    for end in (0, 1):
        np.add.at(stress, pairs[bodies[:, end], end], dyads[bodies[:, end]])
    touched = np.unique(pairs[bodies])
    principal, axes = np.linalg.eigh(stress[touched])
    largest, direction = np.zeros(n), np.zeros((n, 3))
    largest[touched] = principal[:, -1] * 3 / (4 * pi * radius[touched] ** 2)
    direction[touched] = axes[:, :, -1]
    strong = largest > largest[touched].mean() if len(touched) else largest > 0.0
    inner = pairs[bodies.all(axis=1)]
    along = [np.abs((normal[bodies.all(axis=1)] * direction[inner[:, end]]).sum(axis=1)) >= ALONG for end in (0, 1)]
    links = inner[strong[inner].all(axis=1) & along[0] & along[1]]
    graph = coo_array((np.ones(len(links)), (links[:, 0], links[:, 1])), shape=(n, n))
    _, label = connected_components(graph, directed=False)
    return [int(size) for size in np.bincount(label) if size >= SHORTEST]
