"""What the bodies of a group may not touch: planes, walls and the spheres that are already placed."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from carom.physics.placement.neighbours import QUERY_MARGIN, size_classes, squared_distance, wrapped
from carom.scene.start import HalfSpaces

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Surroundings:
    """Planes, walls and spheres, in open space or in a periodic box."""

    spheres: tuple[tuple[FloatArray, FloatArray], ...]  # centres (n, 3) and radii (n,), in m
    solids: HalfSpaces
    box: FloatArray | None  # (3,) m

    def beside(self, centres: FloatArray, radii: FloatArray) -> Surroundings:
        """Return the same with more spheres."""
        return replace(self, spheres=(*self.spheres, (centres, radii)))

    def is_clear(self, position: FloatArray, radius: FloatArray) -> NDArray[np.bool_]:
        """Tell which spheres touch no plane and none of these spheres, (k,)."""
        from scipy.spatial import cKDTree  # noqa: PLC0415 - slow to import, and not always needed

        clear: NDArray[np.bool_] = np.all(self.solids.depth(position, radius) < 0.0, axis=1)
        if not self._trees or len(position) == 0:  # a wide lattice may have no point in a region
            return clear
        own = cKDTree(wrapped(position, self.box), boxsize=self.box)
        for tree, centres, radii in self._trees:
            reach = (radius.max() + radii.max()) * QUERY_MARGIN
            near = own.sparse_distance_matrix(tree, reach, output_type="ndarray")
            i, j = near["i"], near["j"]
            hit = squared_distance(position[i], centres[j], self.box) <= (radius[i] + radii[j]) ** 2
            clear[i[hit]] = False
        return clear

    @cached_property
    def _trees(self) -> list[tuple[cKDTree, FloatArray, FloatArray]]:
        """A tree of each size class of spheres, with its centres and radii."""
        from scipy.spatial import cKDTree  # noqa: PLC0415 - slow to import, and not always needed

        return [
            (cKDTree(wrapped(centres[same], self.box), boxsize=self.box), centres[same], radii[same])
            for centres, radii in self.spheres
            for same in size_classes(radii)
        ]
