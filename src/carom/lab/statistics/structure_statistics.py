"""Structure: the network of lasting contacts with its forces and force chains, and the pair correlation function.

Coordination number: Z = (2 contacts of two bodies + contacts with planes)/N. Rattlers are bodies held by too few
contacts. They are removed with their contacts, repeatedly, until none is left. The remaining bodies of a jammed packing
without friction have Z = 6, and 3 contacts per body if contacts with walls also count once (O'Hern et al., Phys.
Rev. E 68, 011306, 2003). Fabric: F = ⟨n ⊗ n⟩ over contacts, with trace 1 (Satake 1982).

Chains are defined by Peters, Muthuswamy, Wibowo & Tordesillas, Phys. Rev. E 72, 041307 (2005): the stress of a body is
σ = Σ r f n ⊗ n over its contacts, divided by its volume; a body belongs to a chain if its largest principal stress is
above the mean. Two such bodies are linked if the contact between them is within 45° of the principal directions of
both. A chain has at least three bodies.

Pair correlation: g(s) is the number of pairs in a shell, divided by the number expected for uniform random positions.
The distance s is the distance of two centres divided by the sum of the radii, so bodies of all sizes touch at s = 1. In
a periodic box, every body serves as a centre. Otherwise, the bodies are assumed to fill the box around their centres,
and a body serves as a centre only if its distance from the faces of this box is at least the largest s.

The value at contact extends a parabola through the first shells to s = 1. For equal elastic spheres it is g = (1 -
φ/2)/(1 - φ)³ at the packing fraction φ (Carnahan & Starling, J. Chem. Phys. 51, 635, 1969).
"""

from __future__ import annotations

from math import pi, sqrt
from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from carom.arrays import BoolArray, FloatArray, IntArray
from carom.errors import RecordingError
from carom.lab.statistics import Interval
from carom.lab.statistics.statistic import Histogram, MeasuredValue, Statistic
from carom.scene.units.dimension import FORCE

HOLDING = {False: 4, True: 2}  # smallest number of contacts that hold a sphere, without and with friction
ALONG = 1 / sqrt(2)  # cos 45°
SHORTEST = 3  # smallest number of bodies of a chain
SHELLS = 80
RANGE = 4.0  # largest distance, in diameters of the largest body
SPACINGS = 3.0  # largest distance in a dilute system, in mean distances of neighbours
MOST_CENTRES = 50_000  # largest number of centres in all frames together
MOST_CENTRES_OF_FRAME = 5_000
NEAR = np.linspace(1.0, 1.25, 11)  # edges of the shells from which the value at contact is extrapolated


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
    frames, bodies, held_count = len(contacts.moving), np.count_nonzero(contacts.moving), len(of_held)
    of_held_body, over_held = (float(of_held.mean()), kept_contacts / held_count) if held_count else (np.nan, np.nan)
    values = {
        "frames": MeasuredValue("frames with their contacts", frames),
        "contacts": MeasuredValue("contacts in a frame that carry an impulse", len(contacts.i) / frames),
        "coordination": MeasuredValue("contacts of a body", float(each.mean())),
        "rattlers": MeasuredValue(f"rattlers, held by fewer than {fewest} contacts", rattlers / bodies),
        "coordination_of_held": MeasuredValue("contacts of a body without rattlers", of_held_body),
        "contacts_over_held": MeasuredValue("contacts / bodies without rattlers", over_held),
        "fabric": MeasuredValue("fabric", fabric),
        "anisotropy": MeasuredValue("… largest less smallest principal value", float(principal[-1] - principal[0])),
        "principal_direction": MeasuredValue("… direction of the largest", axes[:, -1]),
    }
    edges = np.arange(int(each.max()) + 2, dtype=np.float64) - 0.5
    share = np.histogram(each, edges)[0] / len(each)
    histogram = Histogram("contacts of a body", edges, share, function="fraction of the bodies")
    return Statistic(values, {"contacts_of_a_body": histogram})


def contact_counts(pairs: IntArray, bodies: int) -> IntArray:
    """Return the number of contacts of each body, (n,), given both ends of all contacts, (k, 2)."""
    ends = pairs.ravel()
    return np.bincount(ends[ends < bodies], minlength=bodies)


def held_bodies(pairs: IntArray, moving: BoolArray, fewest: int) -> tuple[BoolArray, IntArray]:
    """Remove rattlers and their contacts until none is left; return a mask of the remaining bodies, and their pairs.

    Planes and fixed bodies support other bodies, and need no contacts to be stable.
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
    pairs, chains = np.stack([contacts.i, contacts.j], axis=1), list[int]()
    for frame in range(frames):
        own = contacts.frame == frame
        radius = interval.recording.bodies.radius
        chains += chains_of(pairs[own], contacts.normal[own], contacts.force[own], radius)
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

    ``pairs``, (k, 2), has the ends of contacts, where a number ≥ n is a plane. Normals, (k, 3), point from the
    first end to the second; forces are (k,) N, radii (n,) m.
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


class Distances(NamedTuple):
    """The distances from the centres to all other bodies in a frame."""

    values: FloatArray  # (k,) distances divided by the sum of the radii
    ideal: float  # expected number of pairs up to s = 1 in an ideal gas

    def counts(self, edges: FloatArray) -> FloatArray:
        """Return the numbers of pairs in shells, (2, b): counted, and expected for an ideal gas."""
        return np.stack([np.histogram(self.values, edges)[0], self.ideal * np.diff(edges**3)])


def measure_pair_correlation(interval: Interval) -> Statistic:
    """Measure the pair correlation from drawn positions, averaged over frames."""
    if interval.bodies < 2:
        raise RecordingError("a pair correlation needs at least two bodies")
    interval.refuse_shear("pair correlations")
    if interval.scene is not None and len(set(interval.scene.domain.axes)) > 1:
        raise RecordingError("a pair correlation needs the same boundary along all axes")
    box, recording = interval.box, interval.recording
    centres = min(interval.bodies, MOST_CENTRES_OF_FRAME)
    steps = interval.step[interval.chosen(MOST_CENTRES // centres)].tolist()

    def present(step: int) -> tuple[FloatArray, FloatArray]:
        there = recording.present(step)
        return interval.positions.drawn(step)[there], recording.bodies.radius[there]

    # largest distance at which pairs are counted, divided by the sum of the radii
    position, radius = present(steps[-1])
    size = np.ptp(position, axis=0) if box is None else box
    spacing, widest = float((np.prod(size) / len(position)) ** (1 / 3)), 2 * float(radius.max())
    largest = min(max(RANGE * widest, SPACINGS * spacing), float(size.min()) / (4 if box is None else 2)) / widest
    if largest <= 1.0:
        raise RecordingError("there are too few bodies, or their layer is too flat, for a pair correlation in space")
    shells = max(1, round(SHELLS / largest))  # number of shells up to s = 1
    edges = np.arange(int(largest * shells) + 1) / shells
    counts, near = np.zeros((2, len(edges) - 1)), np.zeros((2, len(NEAR) - 1))
    for step in steps:
        distances = distances_of(*present(step), box, largest)
        counts += distances.counts(edges)
        near += distances.counts(NEAR)
    values = {"frames": MeasuredValue("frames", len(steps))}
    if largest >= NEAR[-1] and np.all(near[0] > 0.0):
        contact, error = value_at_contact(near)
        values["contact_value"] = MeasuredValue("g at contact", contact, error=error)
    g = np.divide(counts[0], counts[1], out=np.zeros_like(counts[0]), where=counts[1] > 0.0)
    histogram = Histogram("distance / sum of radii", edges, g, function="pair correlation g")
    return Statistic(values, {"pair_correlation": histogram})


def distances_of(position: FloatArray, radius: FloatArray, box: FloatArray | None, largest: float) -> Distances:
    """Find the distances in one frame up to ``largest``, all divided by the sum of the radii."""
    n, reach = len(position), largest * 2 * float(radius.max())
    size = np.ptp(position, axis=0) if box is None else box
    place = position - position.min(axis=0)
    if box is not None:
        place = np.where(place % box < box, place % box, 0.0)
        others, inner = n - 1, np.arange(n)
    else:
        others = n - 7  # the centre itself and the six bodies that define the faces are excluded
        inner = np.flatnonzero(((place >= reach) & (place <= size - reach)).all(axis=1))
    inner = inner[np.unique(np.linspace(0, len(inner) - 1, min(len(inner), MOST_CENTRES_OF_FRAME)).astype(np.int64))]
    if not len(inner) or others < 1:
        return Distances(np.empty(0), 0.0)
    centres = cKDTree(place[inner], boxsize=box)
    found = centres.sparse_distance_matrix(cKDTree(place, boxsize=box), reach, output_type="ndarray")
    i, j = inner[found["i"]], found["j"]
    # Σ (rᵢ + rⱼ)³ over pairs of a centre and a body, without the pairs of a centre with itself
    moments = [float(np.sum(radius**power)) for power in range(4)]
    own = [float(np.sum(radius[inner] ** power)) for power in range(4)]
    cubes = sum(c * own[3 - power] * moments[power] for power, c in enumerate((1, 3, 3, 1))) - 8 * own[3]
    ideal = 4 * pi / 3 * cubes * others / (n - 1) / float(np.prod(size))
    return Distances((found["v"] / (radius[i] + radius[j]))[i != j], ideal)


def value_at_contact(near: FloatArray) -> tuple[float, float]:
    """Extend a parabola through the shells of `NEAR` to contact; return its value and its standard error."""
    found, ideal = near
    distance = (NEAR[1:] + NEAR[:-1]) / 2 - 1.0
    terms = np.stack([np.ones_like(distance), distance, distance**2], axis=1)
    weight = ideal / np.sqrt(2 * found)  # 1/σ of g; each pair is counted from both ends
    inverse = np.linalg.inv((terms * weight[:, None] ** 2).T @ terms)
    return float((inverse @ (terms * weight[:, None] ** 2).T @ (found / ideal))[0]), sqrt(float(inverse[0, 0]))
