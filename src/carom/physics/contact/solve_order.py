"""The order in which the contacts of a step are solved, cut into pieces that threads can share.

Contacts are ordered by colour, then by pair. Their records lie in memory in this order, so an iteration reads memory
from end to end. In the order of pairs each colour would touch every cache line.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from carom.arrays import IntArray
from carom.physics.contact.constraint_graph import OVERFLOW
from carom.physics.jit.decorators import kernel
from carom.physics.jit.lanes import WIDTH

CONTACTS_PER_PIECE = 256  # contacts at most, except to fill a block; a few microseconds of an iteration


@dataclass(frozen=True, slots=True)
class SolveOrder:
    """The order of m contacts, colour by colour."""

    place: IntArray  # (m,) place of each contact in this order
    pairs: IntArray  # (m, 2) by place
    pieces: IntArray  # (k, 2) first place and the one after the last; a piece has one colour
    edges: IntArray  # (s + 1,) first piece of each colour, and k
    independent: int  # number of colours, from the first on, whose contacts share no moving body

    @property
    def count(self) -> int:
        """Number of colours."""
        return len(self.edges) - 1


def solve_order_of(pairs: IntArray, colours: IntArray, independent: bool = True) -> SolveOrder:
    """Order contacts by their colours.

    Parameters
    ----------
    pairs
        (m, 2), sorted.
    colours
        (m,)
    independent
        Whether contacts of a colour share no moving body, except for the colour `OVERFLOW`.
    """
    sizes = np.bincount(colours)
    place, ordered = np.empty(len(pairs), dtype=np.int64), np.empty((len(pairs), 2), dtype=np.int64)
    edges = np.zeros(len(sizes) + 1, dtype=np.int64)
    pieces = np.empty((len(pairs) // CONTACTS_PER_PIECE + len(sizes), 2), dtype=np.int64)
    _lay_out(pairs, colours, sizes, place, ordered, edges, pieces)
    return SolveOrder(place, ordered, pieces[: edges[-1]], edges, min(len(sizes), OVERFLOW) if independent else 0)


@kernel
def _lay_out(
    pairs: IntArray,
    colours: IntArray,
    sizes: IntArray,
    place: IntArray,
    ordered: IntArray,
    edges: IntArray,
    pieces: IntArray,
) -> None:
    """Cut the colours into pieces of about equal size, and assign each contact the next place of its colour."""
    k, end = 0, 0
    for colour in range(len(sizes)):
        lo, end = end, end + sizes[colour]
        sizes[colour] = lo
        fewest = max(1, -(-(end - lo) // CONTACTS_PER_PIECE))
        size = -(-(end - lo) // (fewest * WIDTH)) * WIDTH  # whole blocks
        while lo < end:
            pieces[k, 0], pieces[k, 1] = lo, min(end, lo + size)
            lo += size
            k += 1
        edges[colour + 1] = k
    for c in range(len(colours)):
        p = sizes[colours[c]]
        sizes[colours[c]] = p + 1
        place[c] = p
        ordered[p, 0], ordered[p, 1] = pairs[c, 0], pairs[c, 1]
