"""Bodies on the points of a lattice: simple cubic, face-centred cubic or hexagonal close-packed.

The lattice starts at the lower corner of the region. Points are used from the bottom up, except points at which a body
would leave the region, or touch a plane or an earlier body.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from carom.arrays import FloatArray
from carom.errors import SceneError
from carom.physics.placement.neighbours import Surroundings, overlapping_pairs
from carom.physics.placement.region import Arrangement, bounds, contains, volume
from carom.scene.portable_math import cube_root
from carom.scene.schema import BodyGroup, Region
from carom.scene.units.dimension import LENGTH
from carom.scene.units.system import UnitSystem

# Edges of the orthogonal cell in multiples of the distance between neighbours, and the points of the cell in fractions
# of these edges.
CELLS = {
    "cubic": ((1.0, 1.0, 1.0), ((0.0, 0.0, 0.0),)),
    "fcc": ((math.sqrt(2.0),) * 3, ((0.0, 0.0, 0.0), (0.5, 0.5, 0.0), (0.5, 0.0, 0.5), (0.0, 0.5, 0.5))),
    "hcp": (
        (1.0, math.sqrt(3.0), math.sqrt(8.0 / 3.0)),
        ((0.0, 0.0, 0.0), (0.5, 0.5, 0.0), (0.5, 5.0 / 6.0, 0.5), (0.0, 1.0 / 3.0, 0.5)),
    ),
}
WIDEST = 1.2  # first spacing, over the spacing at which the region, but for its border, would hold the required points
NARROWER = 0.995  # factor for the spacing whenever the region has too few points
TOUCHING = 1.0 + 1e-9  # factor for the sum of radii, so that rounding makes no neighbours overlap
MOST_POINTS = 50_000_000


def _arrange(
    mixture: Mapping[int, BodyGroup],
    region: Region,
    radius: FloatArray,
    around: Surroundings,
    rng: np.random.Generator,
    units: UnitSystem,
) -> FloatArray:
    """Implement `Arrange`, without random numbers."""
    index, group = next(iter(mixture.items()))
    n, largest, key = len(radius), float(radius.max()), ("group", index, "region")
    least = 2.0 * largest * TOUCHING

    def free_points(spacing: float) -> FloatArray:
        points = _points(index, group, region, max(spacing, least), largest)
        return points[around.is_clear(points, np.full(len(points), largest))]

    if group.spacing is not None:
        given = units.text(group.spacing, LENGTH, "g")
        if group.spacing < 2.0 * largest:
            raise SceneError(
                f"group.{index}.spacing = {given} is less than a diameter, {units.text(2.0 * largest, LENGTH, 'g')}; "
                "raise it",
                ("group", index, "spacing"),
            )
        centres = free_points(group.spacing)
        remedy = f"at spacing = {given}; enlarge the region or lower spacing or count"
    else:
        edges, points = CELLS[group.arrangement]
        spacing = WIDEST * float(cube_root(np.array(volume(region) / (n * math.prod(edges) / len(points)))))
        centres = free_points(spacing)
        while len(centres) < n and spacing > least:
            spacing *= NARROWER
            centres = free_points(spacing)
        remedy = "on a lattice; enlarge the region or lower count or radius"
    if len(centres) < n:
        raise SceneError(f"group.{index}.region has space for {len(centres)} of {n} bodies {remedy}", key)
    centres = centres[:n]
    if around.box is not None and len(overlapping_pairs(centres, radius, around.box)):
        raise SceneError(
            f"group.{index}.region: bodies of the lattice touch across the periodic boundary; make the region smaller "
            "than the box by one spacing",
            key,
        )
    return centres


LATTICE = Arrangement(_arrange, lambda radius: math.inf)


def _points(index: int, group: BodyGroup, region: Region, spacing: float, radius: float) -> FloatArray:
    """Return all points of a lattice at which a sphere is inside the region, from the bottom up."""
    edges, fractions = CELLS[group.arrangement]
    cell = spacing * np.array(edges)
    low, high = bounds(region)
    low, high = low + radius, high - radius
    counts = [max(0, math.floor(extent)) + 1 for extent in ((high - low) / cell).tolist()]
    if math.prod(counts) * len(fractions) > MOST_POINTS:
        raise SceneError(
            f"group.{index}.region: more than {MOST_POINTS:g} points of the lattice; raise spacing",
            ("group", index, "region"),
        )
    x, y, z = np.meshgrid(*(np.arange(count, dtype=np.float64) for count in counts), indexing="ij")
    corners = np.stack((x.ravel(), y.ravel(), z.ravel()), axis=1)
    points = np.concatenate([low + (corners + np.array(fraction)) * cell for fraction in fractions])
    points = points[contains(region, points, radius)]
    return points[np.lexsort((points[:, 0], points[:, 1], points[:, 2]))]
