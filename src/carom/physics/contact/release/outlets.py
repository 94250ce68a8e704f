"""Outlets decide which bodies leave: a body whose centre is in an outlet's region, or behind its plane."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from carom.arrays import BoolArray, FloatArray, IntArray, RecordArray, dtype_of
from carom.physics.jit.decorators import long_kernel
from carom.physics.placement.region import half_extent
from carom.scene.load import Scene
from carom.scene.schema.release import Outlet
from carom.scene.wall_shapes import unit_vector

PLANE, BALL, BOX, CYLINDER = range(4)  # a shell is a ball with a cavity
_KINDS = {"ball": BALL, "shell": BALL, "box": BOX, "cylinder": CYLINDER}


class OutletRecord(Protocol):
    """An outlet."""

    kind: int
    x: float  # m, centre of the outlet, or a point of its plane
    y: float
    z: float
    a: float  # m, half of its size along x, or the radius of a ball or cylinder; a, b, c: the normal of a plane
    b: float
    c: float
    cavity: float  # m, radius of the cavity of a shell


OUTLET = dtype_of(OutletRecord)


def outlets_of(scene: Scene) -> RecordArray[OutletRecord]:
    """Return the outlets of a scene for `find_leaving`, (k,) `OUTLET`."""
    rows = np.zeros(len(scene.outlet), dtype=OUTLET)
    for row, outlet in zip(rows, scene.outlet, strict=True):
        row["kind"], centre, size, row["cavity"] = _shape_of(outlet)
        for name, value in zip("xyzabc", (*centre, *size), strict=True):
            row[name] = value
    return rows


def _shape_of(outlet: Outlet) -> tuple[int, tuple[float, ...], tuple[float, ...], float]:
    region = outlet.region
    if region is None:
        return PLANE, outlet.point or (0.0, 0.0, 0.0), tuple(unit_vector(outlet.normal)), 0.0
    return _KINDS[region.shape], region.centre, tuple(half_extent(region).tolist()), region.inner_radius or 0.0


@long_kernel
def find_leaving(position: FloatArray, stays: BoolArray, outlets: RecordArray[OutletRecord], through: IntArray) -> int:
    """Write the outlet through which each body leaves, (n,), or -1; return the number of bodies that leave."""
    count = 0
    for i in range(len(position)):
        through[i] = -1
        if stays[i]:
            continue
        for k in range(len(outlets)):
            outlet = outlets[k]
            dx, dy, dz = position[i, 0] - outlet.x, position[i, 1] - outlet.y, position[i, 2] - outlet.z
            if outlet.kind == PLANE:
                is_out = dx * outlet.a + dy * outlet.b + dz * outlet.c < 0.0
            elif outlet.kind == BOX:
                is_out = abs(dx) <= outlet.a and abs(dy) <= outlet.b and abs(dz) <= outlet.c
            elif outlet.kind == CYLINDER:
                is_out = dx * dx + dy * dy <= outlet.a * outlet.a and abs(dz) <= outlet.c
            else:
                r2 = dx * dx + dy * dy + dz * dz
                is_out = outlet.cavity * outlet.cavity <= r2 <= outlet.a * outlet.a
            if is_out:
                through[i], count = k, count + 1
                break
    return count
