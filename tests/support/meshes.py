"""Meshes of triangles as text in STL, and some whose contacts are known."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from carom.arrays import FloatArray


def stl(path: Path, triangles: FloatArray) -> Path:
    """Write triangles, (f, 3, 3), as an STL file; return its path."""
    lines = ["solid mesh"]
    for corners in np.asarray(triangles, dtype=np.float64).tolist():
        lines += ["facet normal 0 0 0", "outer loop", *(f"vertex {x!r} {y!r} {z!r}" for x, y, z in corners)]
        lines += ["endloop", "endfacet"]
    path.write_text("\n".join([*lines, "endsolid mesh", ""]))
    return path


def sheet(one: FloatArray, other: FloatArray, corner: FloatArray, pieces: int) -> FloatArray:
    """Return a parallelogram of 2 `pieces`² triangles, given its corner and both sides."""
    at = np.linspace(0.0, 1.0, pieces + 1)
    points = corner + at[:, None, None] * one + at[None, :, None] * other
    a, b, c, d = points[:-1, :-1], points[1:, :-1], points[1:, 1:], points[:-1, 1:]
    return np.concatenate([np.stack(each, axis=2).reshape(-1, 3, 3) for each in ((a, b, c), (a, c, d))])


def floor(half: float, pieces: int) -> FloatArray:
    """Return a square of 2 `pieces`² triangles in the plane z = 0."""
    side = 2.0 * half
    return sheet(np.array([side, 0.0, 0.0]), np.array([0.0, side, 0.0]), np.array([-half, -half, 0.0]), pieces)


def box(half: float, pieces: int) -> FloatArray:
    """Return a cube about the origin of 12 `pieces`² triangles, closed."""
    x, y, z = 2.0 * half * np.eye(3)
    low, high = -half * np.ones(3), half * np.ones(3)
    sides = [(y, x, low), (z, y, low), (x, z, low), (-x, -y, high), (-y, -z, high), (-z, -x, high)]
    return np.concatenate([sheet(*side, pieces) for side in sides])


def tube(radius: float, half: float, sides: int) -> FloatArray:
    """Return a prism about the z axis of 2 `sides` triangles; its faces touch the cylinder from within."""
    angle = 2.0 * np.pi * np.arange(sides + 1) / sides
    rim = radius * np.stack((np.cos(angle), np.sin(angle), np.zeros(sides + 1)), axis=1)
    rim[-1] = rim[0]
    up = np.array([0.0, 0.0, half])
    a, b, c, d = rim[:-1] - up, rim[1:] - up, rim[1:] + up, rim[:-1] + up
    return np.concatenate((np.stack((a, b, c), axis=1), np.stack((a, c, d), axis=1)))
