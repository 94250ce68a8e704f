"""Planes in the broad phase: the bodies that touch them at the end of a drift."""

from __future__ import annotations

import numpy as np

from carom.arrays import FloatArray, IntArray, RecordArray
from carom.physics.contact.broad_phase.pairs import BLOCK, BlockRecord, close_up
from carom.physics.contact.geometry import height_above
from carom.physics.contact.graph import first_of
from carom.physics.jit.decorators import long_kernel
from carom.physics.jit.instructions import from_front
from carom.physics.jit.team import Team
from carom.physics.vector import vector
from carom.scene.start import HalfSpaces

BODIES_PER_BLOCK = 1024
MIN_BLOCKS_PER_TASK = 1


class PlaneSearch:
    """Adds the contacts (i, n + k) of bodies with planes k, and drops contacts of two fixed bodies."""

    def __init__(self, radius: FloatArray, inverse_mass: FloatArray, planes: HalfSpaces, team: Team) -> None:
        self._radius, self._inverse_mass, self._planes, self._team = radius, inverse_mass, planes, team

    def merged(self, pairs: IntArray, position: FloatArray, scale: float, skin: float) -> IntArray:
        """Return the pairs merged with those of bodies and planes, (m, 2) sorted by (i, j)."""
        n, p, team = len(self._radius), len(self._planes), self._team
        blocks = np.empty(-(-n // BODIES_PER_BLOCK), dtype=BLOCK)
        merged = np.empty((len(pairs) + n * p, 2), dtype=np.int64)
        spheres, planes = (position, self._radius, self._inverse_mass), (self._planes.surface, self._planes.offset)
        team.divide(len(blocks), MIN_BLOCKS_PER_TASK, _merge, pairs, spheres, planes, (scale, skin), merged, blocks)
        return close_up(merged, blocks, team)


@long_kernel
def _merge(
    lo: int,
    hi: int,
    pairs: IntArray,
    spheres: tuple[FloatArray, FloatArray, FloatArray],
    planes: tuple[FloatArray, FloatArray],
    nearness: tuple[float, float],
    merged: IntArray,
    blocks: RecordArray[BlockRecord],
) -> None:
    """Merge the pairs of the blocks [lo, hi) of bodies; each block has space for all its possible pairs."""
    (position, radius, inverse_mass), (normal, offset), (scale, skin) = spheres, planes, nearness
    c = from_front(first_of(lo * BODIES_PER_BLOCK, pairs))
    for block in range(from_front(lo), hi):
        begin = c + block * BODIES_PER_BLOCK * len(offset)
        m = begin
        for i in range(block * BODIES_PER_BLOCK, min(len(radius), (block + 1) * BODIES_PER_BLOCK)):
            while c < len(pairs) and pairs[c, 0] == i:
                if inverse_mass[i] + inverse_mass[pairs[c, 1]] > 0.0:
                    merged[m, 0], merged[m, 1] = i, pairs[c, 1]
                    m += 1
                c += 1
            if inverse_mass[i] == 0.0:
                continue
            for k in range(len(offset)):
                x, y, z = vector(position, i)
                if height_above(normal, offset, k, x, y, z) <= radius[i] * scale + skin:
                    merged[m, 0], merged[m, 1] = i, len(radius) + k
                    m += 1
        blocks[block].begin, blocks[block].count = begin, m - begin
