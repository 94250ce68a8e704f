"""The pair correlation function: the number of pairs at a distance, relative to an ideal gas.

g(s) is the number of pairs in a shell, divided by the number expected for uniform random positions. s is the
distance of the centres over the sum of the radii, so bodies touch at s = 1 whatever their sizes. In a periodic box
every body serves as a centre. Elsewhere, the bodies are assumed to fill the box around their centres, and only bodies
at least the largest distance s away from its faces serve as centres.

The value at contact extends a parabola through the first shells to s = 1. For equal elastic spheres it is g = (1 -
φ/2)/(1 - φ)³ at the packing fraction φ (Carnahan & Starling, J. Chem. Phys. 51, 635, 1969).
"""

from __future__ import annotations

from math import pi, sqrt
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from carom.arrays import FloatArray
from carom.errors import RecordingError
from carom.lab.statistics.interval import Interval
from carom.lab.statistics.statistic import Histogram, MeasuredValue, Statistic

SHELLS = 80
RANGE = 4.0  # largest distance, in diameters of the largest body
SPACINGS = 3.0  # largest distance in a dilute system, in mean distances of neighbours
MOST_CENTRES = 50_000  # in all frames
MOST_CENTRES_OF_FRAME = 5_000
NEAR = np.linspace(1.0, 1.25, 11)  # edges of the shells from which the value at contact is extrapolated


class Distances(NamedTuple):
    """The distances from the centres to all other bodies in a frame."""

    values: FloatArray  # (k,) over the sum of the radii
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

    largest = _largest_distance(*present(steps[-1]), box)
    shells = max(1, round(SHELLS / largest))  # up to s = 1
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


def _largest_distance(position: FloatArray, radius: FloatArray, box: FloatArray | None) -> float:
    """Return the largest distance at which pairs are counted, over the sum of the radii."""
    size = np.ptp(position, axis=0) if box is None else box
    spacing = float((np.prod(size) / len(position)) ** (1 / 3))
    widest = 2 * float(radius.max())
    largest = min(max(RANGE * widest, SPACINGS * spacing), float(size.min()) / (4 if box is None else 2)) / widest
    if largest <= 1.0:
        raise RecordingError("the bodies are too few, or too flat a layer, for a pair correlation in space")
    return largest


def distances_of(position: FloatArray, radius: FloatArray, box: FloatArray | None, largest: float) -> Distances:
    """Find the distances of one frame, up to a largest one over the sum of the radii.

    Parameters
    ----------
    position
        (n, 3) m.
    radius
        (n,) m.
    box
        Size of the periodic box, (3,) m; None without one.
    """
    n, reach = len(position), largest * 2 * float(radius.max())
    low = position.min(axis=0)
    size = np.ptp(position, axis=0) if box is None else box
    place = position - low
    if box is not None:
        place = np.where(place % box < box, place % box, 0.0)
        others = n - 1
        inner = np.arange(n)
    else:
        others = n - 7  # without the centre itself and the six bodies that define the faces
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
    weight = ideal / np.sqrt(2 * found)  # 1/σ of g: each pair is counted from both of its ends
    inverse = np.linalg.inv((terms * weight[:, None] ** 2).T @ terms)
    return float((inverse @ (terms * weight[:, None] ** 2).T @ (found / ideal))[0]), sqrt(float(inverse[0, 0]))
