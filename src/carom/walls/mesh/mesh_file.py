"""Meshes in files, and as text in a scene."""

from __future__ import annotations

import base64
import binascii
import zlib
from functools import lru_cache
from pathlib import Path

import numpy as np

from carom.arrays import FloatArray, IntArray
from carom.errors import SceneError, install_extra

FORMATS = (".stl", ".obj", ".ply")
LARGEST_FILE = 200_000_000  # largest number of bytes of a file
MOST_TRIANGLES = 200_000  # largest number of triangles whose text fits into a scene
THINNEST = 1e-7  # height of a triangle, divided by its longest side; coordinates in single precision resolve no less
_COUNTS = np.dtype("<i8")
_CORNERS, _TRIANGLES = np.dtype("<f8"), np.dtype("<i4")


def read(path: Path, called: str) -> str:
    """Return the corners and the triangles of a file as text; raises SceneError if the file has no usable triangle."""
    if path.suffix.lower() not in FORMATS:
        raise SceneError(f"{called}: not a mesh in STL, OBJ or PLY; convert it, for example with Blender or MeshLab")
    try:
        size = path.stat().st_size if path.is_file() else None
    except (OSError, ValueError) as error:  # a name with a zero byte raises ValueError
        raise SceneError(f"{path}: cannot be read: {getattr(error, 'strerror', None) or error}") from None
    if size is None:
        raise SceneError(f"{path}: cannot be read: {'it is a folder' if path.is_dir() else 'no such file'}")
    if size > LARGEST_FILE:
        raise SceneError(f"{called}: {size} bytes are too many; at most {LARGEST_FILE}")
    try:
        import trimesh  # noqa: PLC0415 - an extra
    except ModuleNotFoundError:
        raise SceneError(f"{called}: a mesh needs trimesh: {install_extra('mesh')}") from None
    try:
        loaded = trimesh.load_mesh(path, process=False)
        corners, triangles = np.array(loaded.vertices, dtype=np.float64), np.array(loaded.faces, dtype=np.int64)
    except Exception as error:
        raise SceneError(f"{called}: not a mesh in {path.suffix[1:].upper()}: {str(error)[:200]}") from None
    corners, number = np.unique(corners + 0.0, axis=0, return_inverse=True)  # STL repeats corners; -0 becomes 0
    triangles = number.reshape(-1)[triangles]
    if problem := _problem(corners, triangles):
        raise SceneError(f"{called}: {problem}")
    return _packed(corners, triangles)


def _problem(corners: FloatArray, triangles: IntArray) -> str:
    """Return the reason why triangles form no wall; empty if they form a wall."""
    if len(triangles) == 0:
        return "no triangles in it; is it a mesh in this format?"
    if len(triangles) > MOST_TRIANGLES:
        return f"{len(triangles)} triangles are too many; simplify it to at most {MOST_TRIANGLES}"
    if not np.isfinite(corners).all():
        return "a coordinate that is not finite; export it again"
    if triangles.min() < 0 or triangles.max() >= len(corners):
        return "a triangle refers to a corner that is missing; export it again"
    points = corners[triangles]
    sides = np.roll(points, -1, axis=1) - points
    longest = np.sqrt((sides * sides).sum(axis=2)).max(axis=1)
    normal = np.cross(sides[:, 0], sides[:, 1])
    thin = np.flatnonzero(~(np.sqrt((normal * normal).sum(axis=1)) > THINNEST * longest * longest))
    if len(thin):
        return (
            f"{len(thin)} of {len(triangles)} triangles have no area, the first at {points[thin[0], 0].tolist()}; "
            "remove degenerate faces, for example with MeshLab"
        )
    twice = len(triangles) - len(np.unique(np.sort(triangles, axis=1), axis=0))
    if twice:
        return f"{twice} of {len(triangles)} triangles are there twice; remove duplicates, for example with MeshLab"
    ends = np.sort(np.stack((triangles, np.roll(triangles, -1, axis=1)), axis=2), axis=2).reshape(-1, 2)
    edges, count = np.unique(ends, axis=0, return_counts=True)
    if count.max() > 2:
        where = corners[edges[int(count.argmax())]].mean(axis=0)
        return (
            f"not manifold: {count.max()} triangles share the edge about {where.tolist()}, of at most 2; repair it, "
            "for example with MeshLab, or make it two walls"
        )
    return ""


def _packed(corners: FloatArray, triangles: IntArray) -> str:
    """Return a mesh as text."""
    counts = np.array([len(corners), len(triangles)], dtype=_COUNTS)
    parts = counts.tobytes(), corners.astype(_CORNERS).tobytes(), triangles.astype(_TRIANGLES).tobytes()
    return base64.b64encode(zlib.compress(b"".join(parts), 9)).decode()


@lru_cache(maxsize=16)
def unpacked(content: str) -> tuple[FloatArray, IntArray]:
    """Return corners and triangles from a text; raises ValueError if it is damaged."""
    most = _COUNTS.itemsize * 2 + MOST_TRIANGLES * 3 * (3 * _CORNERS.itemsize + _TRIANGLES.itemsize)
    try:
        data = zlib.decompressobj().decompress(base64.b64decode(content, validate=True), most)
        (many, number), body = np.frombuffer(data[:16], _COUNTS).tolist(), data[16:]
        split = 3 * many * _CORNERS.itemsize
        corners = np.frombuffer(body[:split], _CORNERS).reshape(many, 3)
        triangles = np.frombuffer(body[split:], _TRIANGLES).reshape(number, 3).astype(np.int64)
    except (binascii.Error, zlib.error, ValueError):
        raise ValueError("content is damaged; remove it, and name the file") from None
    if problem := _problem(corners, triangles):
        raise ValueError(f"content has {problem}")
    return corners.astype(np.float64), triangles


def enclosed(corners: FloatArray, triangles: IntArray) -> float | None:
    """Return the volume within a mesh in m³, negative if its normals point inwards; None if it is open."""
    directed = np.stack((triangles, np.roll(triangles, -1, axis=1)), axis=2).reshape(-1, 2)
    forth, back = directed[np.lexsort(directed.T)], directed[np.lexsort(directed[:, ::-1].T)][:, ::-1]
    if not np.array_equal(forth, back):  # a closed mesh has each edge once in both directions
        return None
    a, b, c = (corners[triangles[:, k]] - corners[0] for k in range(3))
    return float((a * np.cross(b, c)).sum() / 6.0)
