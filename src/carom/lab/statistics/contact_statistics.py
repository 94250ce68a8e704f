"""The network of lasting contacts, the distribution of normal forces, and the chains that carry large ones.

Coordination number: Z = (2 contacts of two bodies + contacts with planes)/N. Rattlers are bodies held by too few
contacts. They are removed with their contacts, repeatedly, until none is left. The remaining bodies of a jammed packing
without friction have Z = 6, and 3 contacts per body if contacts with walls are counted once, too (O'Hern et al., Phys.
Rev. E 68, 011306, 2003). Fabric: F = ⟨n ⊗ n⟩ over contacts, with trace 1 (Satake 1982).

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

from carom.arrays import BoolArray, FloatArray, IntArray
from carom.extend import FORCE
from carom.lab.statistics.interval import Interval
from carom.lab.statistics.statistic import Histogram, MeasuredValue, Statistic

HOLDING = {False: 4, True: 2}  # smallest number of contacts that hold a sphere, without and with friction
ALONG = 1 / sqrt(2)  # cos 45°
SHORTEST = 3  # bodies of a chain


def measure_network(interval: Interval) -> Statistic:
    """Measure the network, averaged over frames."""
    contacts, n = interval.contacts, interval.bodies
    fewest = HOLDING[bool(interval.recording.info["has_friction"])]
    counts, held_counts, rattlers, kept_contacts = [], [], 0, 0
    for frame, moving in enumerate(contacts.moving):
        own = contacts.frame == frame
        pairs = np.stack([contacts.i[own], contacts.j[own]], axis=1)
        counts.append(contact_counts(pairs, n)[moving])
        held, kept = held_bodies(pairs, moving, fewest)
        held_counts.append(contact_counts(kept, n)[held])
        kept_contacts += len(kept)
        rattlers += int(np.count_nonzero(moving)) - int(np.count_nonzero(held))
    each, of_held = np.concatenate(counts), np.concatenate(held_counts)
    fabric = contacts.normal.T @ contacts.normal / len(contacts.normal)
    principal, axes = np.linalg.eigh(fabric)
    frames, bodies = len(contacts.moving), np.count_nonzero(contacts.moving)
    values = {
        "frames": MeasuredValue("frames with their contacts", frames),
        "contacts": MeasuredValue("contacts that carry an impulse, of a frame", len(contacts.i) / frames),
        "coordination": MeasuredValue("contacts of a body", float(each.mean())),
        "rattlers": MeasuredValue(f"rattlers, held by fewer than {fewest} contacts", rattlers / bodies),
        "coordination_of_held": MeasuredValue(
            "contacts of a body without rattlers", float(of_held.mean()) if len(of_held) else np.nan
        ),
        "contacts_over_held": MeasuredValue(
            "contacts / bodies without rattlers", kept_contacts / len(of_held) if len(of_held) else np.nan
        ),
        "fabric": MeasuredValue("fabric", fabric),
        "anisotropy": MeasuredValue("… largest less smallest principal value", float(principal[-1] - principal[0])),
        "principal_direction": MeasuredValue("… direction of the largest", axes[:, -1]),
    }
    edges = np.arange(int(each.max()) + 2, dtype=np.float64) - 0.5
    share = np.histogram(each, edges)[0] / len(each)
    return Statistic(
        values, {"contacts_of_a_body": Histogram("contacts of a body", edges, share, function="fraction of the bodies")}
    )


def contact_counts(pairs: IntArray, bodies: int) -> IntArray:
    """Return the number of contacts of each body, (n,), given both ends of all contacts, (k, 2)."""
    ends = pairs.ravel()
    return np.bincount(ends[ends < bodies], minlength=bodies)


def held_bodies(pairs: IntArray, moving: BoolArray, fewest: int) -> tuple[BoolArray, IntArray]:
    """Remove rattlers and their contacts until none is left; return a mask of the other bodies, and their pairs.

    Planes and fixed bodies hold others, and need no contacts themselves.
    """
    n, held = len(moving), np.ones(max(len(moving), int(pairs.max(initial=0)) + 1), dtype=bool)
    while True:
        kept = pairs[held[pairs].all(axis=1)]
        loose = held[:n] & moving & (contact_counts(kept, n) < fewest)
        if not loose.any():
            return held[:n] & moving, kept
        held[:n] &= ~loose


def measure_forces(interval: Interval) -> Statistic:
    """Measure the forces of lasting contacts, and their chains frame by frame."""
    contacts = interval.contacts
    mean = float(contacts.force.mean())
    ratio, frames = contacts.force / mean, len(contacts.moving)
    chains = [
        size
        for frame in range(frames)
        for size in chains_of(
            np.stack([contacts.i, contacts.j], axis=1)[contacts.frame == frame],
            contacts.normal[contacts.frame == frame],
            contacts.force[contacts.frame == frame],
            interval.recording.bodies.radius,
        )
    ]
    bodies = np.count_nonzero(contacts.moving)
    values = {
        "mean_force": MeasuredValue("mean normal force", mean, FORCE),
        "largest_force": MeasuredValue("largest", float(contacts.force.max()), FORCE),
        "second_moment": MeasuredValue("⟨f²⟩/⟨f⟩²", float(np.mean(ratio * ratio))),
        "strong": MeasuredValue("contacts with more than the mean", float(np.mean(ratio > 1.0))),
        "friction": MeasuredValue("friction / normal force, mean", float(np.mean(contacts.friction / contacts.force))),
        "chains": MeasuredValue("chains, of a frame", len(chains) / frames),
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
