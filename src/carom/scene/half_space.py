"""Static half-spaces: the planes of a scene, and the six walls of its box."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from carom.arrays import FloatArray
from carom.scene.schema import Scene

WALLS = (
    ("wall at -x", (1.0, 0.0, 0.0)),
    ("wall at +x", (-1.0, 0.0, 0.0)),
    ("wall at -y", (0.0, 1.0, 0.0)),
    ("wall at +y", (0.0, -1.0, 0.0)),
    ("wall at -z", (0.0, 0.0, 1.0)),
    ("wall at +z", (0.0, 0.0, -1.0)),
)


@dataclass(frozen=True)
class HalfSpaces:
    """p solid half-spaces; bodies are where ``normal · x > offset``."""

    name: list[str]
    normal: FloatArray  # (p, 3) unit vectors, out of the solid
    offset: FloatArray  # (p,) m

    def __len__(self) -> int:
        return len(self.offset)

    def depth(self, position: FloatArray, radius: FloatArray) -> FloatArray:
        """Return how deep spheres reach into each half-space, (n, p) m; negative if they do not."""
        return np.asarray(radius[:, None] - ((position[:, None] * self.normal).sum(axis=2) - self.offset))


def planes_of(scene: Scene) -> HalfSpaces:
    """Gather the scene's planes, in their order."""
    normals = [_unit(plane.normal) for plane in scene.plane]
    return HalfSpaces(
        name=[plane.name or f"plane {index}" for index, plane in enumerate(scene.plane)],
        normal=np.array(normals).reshape(-1, 3),
        offset=np.array([(n * np.array(plane.point)).sum() for n, plane in zip(normals, scene.plane, strict=True)]),
    )


def half_spaces(scene: Scene) -> HalfSpaces:
    """Gather all half-spaces of a scene: its planes, then the walls."""
    planes, size = planes_of(scene), scene.domain.size
    if scene.domain.boundary != "walls" or size is None:
        return planes
    return HalfSpaces(
        name=[*planes.name, *(name for name, _ in WALLS)],
        normal=np.vstack((planes.normal, [inward for _, inward in WALLS])),
        offset=np.concatenate((planes.offset, -0.5 * np.repeat(size, 2))),
    )


def _unit(direction: tuple[float, float, float]) -> FloatArray:
    """Scale to length 1; dividing by the largest component first avoids overflow."""
    scaled = np.array(direction) / np.max(np.abs(direction))
    return np.asarray(scaled / np.sqrt((scaled * scaled).sum()))
