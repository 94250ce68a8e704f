"""Contact geometry: distances, normals, lever arms and overlaps.

Both bodies share one contact point on the line of centres, at a distance of d r_i/(r_i + r_j) from i and d r_j/(r_i +
r_j) from j. At a plane, the arm of the body is its radius, and the plane has no arm. A plane absorbs any angular
momentum, so the arm need not equal the distance. An impact that is detected late then changes the spin as it would have
at the surface.
"""

from __future__ import annotations

import numpy as np

from carom.arrays import FloatArray, IntArray, RecordArray
from carom.physics.contact.constraints import ends_of
from carom.physics.contact.moving_walls import set_surface_velocity
from carom.physics.contact.records import ContactRecord, ContactStateRecord
from carom.physics.contact.solids import tangent_plane
from carom.physics.jit.decorators import inline, long_kernel
from carom.physics.jit.instructions import from_front
from carom.physics.jit.vectors import where
from carom.physics.sheared_box import nearest_in_drift, set_image_velocity
from carom.physics.vector import Vector, between, nearest_image, vector

# Kernel arguments that belong together. These arguments are plain tuples for kernels that Python calls in each step:
# Numba takes 5 µs for a named tuple, 0.5 µs for a plain one. With named tuples, a step of `heap` took 1.09 times as
# long.
Shapes = tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]
"""Positions (n, 3) m and radii (n,) m; box, as in `ConstraintSystem`; normals (p, 3) and offsets (p,) m of planes."""

SearchedSpheres = tuple[FloatArray, FloatArray, FloatArray, float, float]
"""Positions (n, 3) m and radii (n,) m; box (3,) m; scale and skin (m) of the largest distance, see `are_near`."""


@inline
def normal_and_distance(dx: float, dy: float, dz: float) -> tuple[float, float, float, float]:
    """Return the normal of two spheres, (1, 0, 0) if their centres coincide, and the distance of their centres in m."""
    d = np.sqrt(dx * dx + dy * dy + dz * dz)
    apart = d > 0.0
    return where(apart, dx / d, 1.0), where(apart, dy / d, 0.0), where(apart, dz / d, 0.0), d


@inline
def height_above(normal: FloatArray, offset: FloatArray, plane: int, x: float, y: float, z: float) -> float:
    """Return the height of a point above a plane or a wall, in m; negative behind it."""
    nx, ny, nz, distance = tangent_plane(normal, offset, plane, x, y, z)
    height: float = -distance + nx * x + ny * y + nz * z
    return height


@inline
def are_near(dx: float, dy: float, dz: float, radii: float, box: Vector, scale: float, skin: float) -> bool:
    """Return whether two spheres are no farther apart than ``radii scale + skin``; all searches use this test.

    ``radii`` is the sum of the radii, (dx, dy, dz) points from one centre to the other, and ``box`` is the result of
    `sizes`; all are in m.
    """
    dx, dy, dz = nearest_image(dx, dy, dz, box)
    limit = radii * scale + skin
    return dx * dx + dy * dy + dz * dz <= limit * limit


@inline
def smaller_arm(contact: ContactRecord) -> float:
    """Return the lever arm of the smaller body, or of the body that touches a plane, in m."""
    arm: float = min(contact.arm_i, contact.arm_j) if contact.arm_j > 0.0 else contact.arm_i
    return arm


@long_kernel
def update_geometry(
    lo: int,
    hi: int,
    pairs: IntArray,
    shapes: Shapes,
    contacts: RecordArray[ContactRecord],
    states: RecordArray[ContactStateRecord],
) -> None:
    """Write normals from i to j, lever arms and overlaps of the contacts [lo, hi)."""
    x, radius, box, surface, offset = shapes
    n = len(x)
    for c in range(from_front(lo), hi):
        (i, j), contact, state = ends_of(pairs, c), contacts[c], states[c]
        if j >= n:
            p, (px, py, pz) = j - n, vector(x, i)
            nx, ny, nz, distance = tangent_plane(surface, offset, p, px, py, pz)
            contact.nx, contact.ny, contact.nz = -nx, -ny, -nz
            contact.arm_i, contact.arm_j = radius[i], 0.0
            height = -distance + nx * px + ny * py + nz * pz
            state.overlap = radius[i] - height
            set_surface_velocity(contact, surface, p, (px - height * nx, py - height * ny, pz - height * nz))
            continue
        dx, dy, dz = between(x, i, j)
        set_image_velocity(contact, dx, dy, dz, box)
        dx, dy, dz = nearest_in_drift(dx, dy, dz, box, 0.0)
        contact.nx, contact.ny, contact.nz, d = normal_and_distance(dx, dy, dz)
        ratio = d / (radius[i] + radius[j])
        contact.arm_i, contact.arm_j = ratio * radius[i], ratio * radius[j]
        state.overlap = radius[i] + radius[j] - d
