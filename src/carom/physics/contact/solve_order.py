"""The contacts of a step in the order in which they are resolved, and cut into pieces that threads can share.

By colour, then by pair. Contacts are laid out in this order, so that a sweep reads memory from end to end: in the order
of pairs each colour would touch every cache line of it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carom.physics.contact.constraint_graph import OVERFLOW
from carom.physics.parallel.jit import kernel

IntArray = NDArray[np.int64]

PIECE = 512  # contacts; a few microseconds of a sweep


@dataclass(frozen=True, slots=True)
class Stages:
    """The order of resolution of m contacts."""

    place: IntArray  # (m,) of each contact
    pairs: IntArray  # (m, 2) by place
    pieces: IntArray  # (k, 2) first place and the one after the last; no piece is of two stages
    edges: IntArray  # (s + 1,) first piece of each stage, and k
    independent: int  # so many stages, from the first on, have no two contacts that share a body that moves

    @property
    def count(self) -> int:
        """How many stages there are."""
        return len(self.edges) - 1


def stages_of(pairs: IntArray, colours: IntArray, independent: bool = True) -> Stages:
    """Order contacts by their colours.

    Parameters
    ----------
    pairs
        (m, 2), sorted.
    colours
        (m,)
    independent
        Whether contacts of a colour share no body that moves, but for those of the colour `OVERFLOW`.
    """
    sizes = np.bincount(colours)
    place, staged = np.empty(len(pairs), dtype=np.int64), np.empty_like(pairs)
    edges = np.zeros(len(sizes) + 1, dtype=np.int64)
    pieces = np.empty((len(pairs) // PIECE + len(sizes), 2), dtype=np.int64)
    _lay_out(pairs, colours, sizes, place, staged, edges, pieces)
    return Stages(place, staged, pieces[: edges[-1]], edges, min(len(sizes), OVERFLOW) if independent else 0)


@kernel
def _lay_out(
    pairs: IntArray,
    colours: IntArray,
    sizes: IntArray,
    place: IntArray,
    staged: IntArray,
    edges: IntArray,
    pieces: IntArray,
) -> None:
    """Cut the stages into pieces, and give each contact the next place of its colour."""
    k, end = 0, 0
    for stage in range(len(sizes)):
        lo, end = end, end + sizes[stage]
        sizes[stage] = lo
        while lo < end:
            pieces[k, 0], pieces[k, 1] = lo, min(end, lo + PIECE)
            lo += PIECE
            k += 1
        edges[stage + 1] = k
    for c in range(len(colours)):
        p = sizes[colours[c]]
        sizes[colours[c]] = p + 1
        place[c] = p
        staged[p, 0], staged[p, 1] = pairs[c, 0], pairs[c, 1]
