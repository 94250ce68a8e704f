"""Pairs that threads write block by block, each block with room of its own."""

from __future__ import annotations

import numpy as np

from carom.arrays import IntArray, Records
from carom.physics.jit.decorators import long_kernel
from carom.physics.jit.thread_team import Team

BLOCK = np.dtype([("begin", np.int64), ("count", np.int64)])  # where the pairs of a block begin; how many

MIN_BLOCKS_PER_TASK = 2


def close_up(pairs: IntArray, blocks: Records, team: Team) -> IntArray:
    """Return a copy of the pairs of all blocks, (m, 2), without the gaps between them; blocks are (k,) `BLOCK`."""
    if len(blocks) == 1:
        begin, count = blocks[0].item()
        return pairs[begin : begin + count].copy()
    ends = np.cumsum(blocks["count"])
    together = np.empty((ends[-1] if len(ends) else 0, 2), dtype=np.int64)
    team.divide(len(blocks), MIN_BLOCKS_PER_TASK, _close_up, pairs, blocks, ends, together)
    return together


@long_kernel
def _close_up(lo: int, hi: int, pairs: IntArray, blocks: Records, ends: IntArray, together: IntArray) -> None:
    """Copy the pairs of the blocks [lo, hi) to their final places."""
    for block in range(lo, hi):
        begin, count = blocks[block].begin, blocks[block].count
        for k in range(count):
            m = ends[block] - count + k
            together[m, 0], together[m, 1] = pairs[begin + k, 0], pairs[begin + k, 1]
