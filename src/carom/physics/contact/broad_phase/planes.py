"""Planes in the broad phase."""

from __future__ import annotations

import numpy as np

from carom.arrays import FloatArray, IntArray, Records
from carom.physics.contact.broad_phase.blocks import BLOCK, close_up
from carom.physics.contact.constraint_graph import first_of
from carom.physics.jit.decorators import long_kernel
from carom.physics.jit.index import from_front
from carom.physics.jit.thread_team import Team
from carom.scene.start import HalfSpaces

BODIES_PER_BLOCK = 1024
MIN_BLOCKS_PER_TASK = 1


class PlaneSearch:
    """Adds the contacts (i, n + k) of bodies with planes k, and drops those of two fixed bodies.

    Parameters
    ----------
    radius
        (n,) m.
    inverse_mass
        (n + p,) 1/kg; two fixed ends form no contact.
    planes
        The half-spaces.
    team
        Threads that merge.
    """

    def __init__(self, radius: FloatArray, inverse_mass: FloatArray, planes: HalfSpaces, team: Team) -> None:
        self._team = team
        self._radius = radius
        self._inverse_mass = inverse_mass
        self._planes = planes

    def merged(self, pairs: IntArray, position: FloatArray, scale: float, skin: float) -> IntArray:
        """Return the pairs merged with those of bodies and planes, (m, 2) sorted by (i, j)."""
        n, p, team = len(self._radius), len(self._planes), self._team
        blocks = np.empty(-(-n // BODIES_PER_BLOCK), dtype=BLOCK)
        merged = np.empty((len(pairs) + n * p, 2), dtype=np.int64)
        spheres, planes = (position, self._radius, self._inverse_mass), (self._planes.normal, self._planes.offset)
        team.divide(len(blocks), MIN_BLOCKS_PER_TASK, _merge, pairs, *spheres, *planes, scale, skin, merged, blocks)
        return close_up(merged, blocks, team)


@long_kernel
def _merge(
    lo: int,
    hi: int,
    pairs: IntArray,
    position: FloatArray,
    radius: FloatArray,
    inverse_mass: FloatArray,
    normal: FloatArray,
    offset: FloatArray,
    scale: float,
    skin: float,
    merged: IntArray,
    blocks: Records,
) -> None:
    """Merge the pairs of the blocks [lo, hi) of bodies; each block has room for all its possible pairs."""
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
                height = -offset[k]
                for axis in range(3):
                    height += normal[k, axis] * position[i, axis]
                if height <= radius[i] * scale + skin:
                    merged[m, 0], merged[m, 1] = i, len(radius) + k
                    m += 1
        blocks[block].begin, blocks[block].count = begin, m - begin
