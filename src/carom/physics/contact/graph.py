"""The constraint graph: the contacts of a step, their colours, and the order in which they are solved.

carom colours *contacts* so that no two contacts of a colour share a body. The contacts of a colour can therefore be
solved in parallel. The reference engine colours *bodies* so that neighbours differ, and then resolves "all collisions
of a colour", but two contacts of one such colour can share a body. Body colouring remains available for comparison.

Contacts are solved colour by colour, and within a colour pair by pair, in pieces that threads can share. Their records
are stored in this order, so an iteration reads memory sequentially. If the records were in the order of pairs, each
colour would touch every cache line.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from carom.arrays import FloatArray, IntArray
from carom.physics.bodies import Bodies
from carom.physics.contact.constraints import ends_of
from carom.physics.jit.decorators import inline, kernel
from carom.physics.jit.instructions import from_front, lowest_bit
from carom.physics.jit.vectors import WIDTH

OVERFLOW = 64  # colour of contacts that do not fit into 64 colours; they are resolved last, one by one
CONTACTS_PER_PIECE = 256  # limit on contacts per piece; a full block may need more; an iteration over it takes some µs


@inline
def comes_before(i: float, j: float, other_i: float, other_j: float) -> bool:
    """Return whether the pair (i, j) precedes another in the order of pairs; the numbers may be floats."""
    return i < other_i or (i == other_i and j < other_j)


@kernel
def first_of(body: int, pairs: IntArray) -> int:
    """Return the index of the first sorted pair whose first body is ``body`` or a later one."""
    first, end = 0, len(pairs)
    while first < end:
        middle = (first + end) // 2
        if pairs[middle, 0] < body:
            first = middle + 1
        else:
            end = middle
    return first


def colour_contacts(pairs: IntArray, inverse_mass: FloatArray) -> IntArray:
    """Colour contacts greedily, in order, so that no two contacts of a colour share a moving body.

    A sphere touches at most 12 spheres of its size, so 23 colours suffice for equal spheres. Contacts that do not fit
    into 64 colours have the colour `OVERFLOW`.

    Parameters
    ----------
    inverse_mass
        (n + p,) 1/kg; any number of contacts of a colour may share an end whose value is 0.
    """
    return colour_rest(pairs, np.full(len(pairs), -1), np.arange(len(pairs)), inverse_mass)


def colour_rest(pairs: IntArray, colours: IntArray, order: IntArray, inverse_mass: FloatArray) -> IntArray:
    """Colour the contacts that have no colour yet (-1) in a given order; return all (m,) colours.

    Parameters
    ----------
    order
        The contacts without a colour, in the order of colouring.
    """
    colours = colours.astype(np.int64)
    _colour_contacts(pairs, order, inverse_mass, np.empty(len(inverse_mass), dtype=np.uint64), colours)
    return colours


@kernel
def _colour_contacts(
    pairs: IntArray, order: IntArray, inverse_mass: FloatArray, used: NDArray[np.uint64], colours: IntArray
) -> None:
    for c in range(len(pairs)):
        i, j = ends_of(pairs, c)
        used[i] = used[j] = np.uint64(0)
    given = len(pairs) - len(order)  # contacts that already have a colour come first
    for k in range(-len(pairs) if given > 0 else 0, len(order)):
        c = from_front(k + len(pairs) if k < 0 else order[k])
        (i, j), colour = ends_of(pairs, c), colours[c]
        if k >= 0:
            colour = lowest_bit(~(used[i] | used[j]))  # 64, which is `OVERFLOW`, if all colours are used
            colours[c] = colour
        if 0 <= colour < OVERFLOW:
            bit = np.uint64(1) << np.uint64(colour)
            if inverse_mass[i] > 0.0:
                used[i] |= bit
            if inverse_mass[j] > 0.0:
                used[j] |= bit


def colour_bodies(pairs: IntArray, n: int, given: IntArray | None = None) -> tuple[IntArray, IntArray]:
    """Colour bodies greedily, in order, so that touching bodies differ: the reference engine's rule.

    Parameters
    ----------
    given
        (n,) colours to keep; -1 for a body without a colour; two bodies with the same given colour may touch.

    Returns
    -------
    contact_colours
        (m,) the lower of the two bodies' colours: each contact belongs to one stage.
    body_colours
        (n,), -1 for a body without contacts.
    """
    met = pairs[:, 1] < n
    # neighbours of each body in ascending order, one body after another, and the index where each list begins
    ends = np.concatenate((pairs[met], pairs[met, ::-1]))
    ends = ends[np.lexsort((ends[:, 1], ends[:, 0]))]
    offsets = np.concatenate(([0], np.cumsum(np.bincount(ends[:, 0], minlength=n)))).astype(np.int64)
    neighbours = np.ascontiguousarray(ends[:, 1])
    bodies = np.full(n, -1, dtype=np.int64) if given is None else given.copy()
    _colour_bodies(offsets, neighbours, bodies)
    on_plane = pairs[~met, 0]
    # planes get no colour, so a body that touches only planes has the first colour
    bodies[on_plane] = np.maximum(bodies[on_plane], 0)
    colours = bodies[pairs[:, 0]]
    colours[met] = np.minimum(colours[met], bodies[pairs[met, 1]])
    return colours, bodies


@kernel
def _colour_bodies(offsets: IntArray, neighbours: IntArray, bodies: IntArray) -> None:
    for i in range(len(bodies)):
        first, last = offsets[i], offsets[i + 1]
        if first == last or bodies[i] >= 0:
            continue
        colour = 0
        free = False
        while not free:
            free = True
            for k in range(first, last):
                if bodies[neighbours[k]] == colour:
                    free = False
                    colour += 1
                    break
        bodies[i] = colour


@dataclass(frozen=True, slots=True)
class SolveOrder:
    """The order of m contacts, colour by colour."""

    place: IntArray  # (m,) index of each contact in this order of pieces
    pairs: IntArray  # (m, 2) pairs in the order of pieces
    pieces: IntArray  # (k, 2) first index and end of each piece's range; all contacts of a piece have one colour
    edges: IntArray  # (s + 1,) first piece of each colour, then k
    independent: int  # number of leading colours whose contacts share no moving body

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
    """Divide the colours into pieces of about equal size, and assign each contact the next free index of its colour."""
    k, end = 0, 0
    for colour in range(len(sizes)):
        lo, end = end, end + sizes[colour]
        sizes[colour] = lo
        fewest = max(1, -(-(end - lo) // CONTACTS_PER_PIECE))
        size = -(-(end - lo) // (fewest * WIDTH)) * WIDTH  # rounded up to whole blocks
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


@dataclass(frozen=True, slots=True)
class OrderedContacts:
    """The contacts of a step by pair, and their order in the solver."""

    pairs: IntArray  # (m, 2) sorted pairs; j ≥ n is plane j - n
    colours: IntArray  # (m,)
    body_colours: IntArray | None  # colours of bodies; see `CollisionGraph`
    order: SolveOrder

    @classmethod
    def of(cls, pairs: IntArray, bodies: Bodies, colouring: str) -> Self:
        """Colour contacts as `contact.colouring` requests."""
        if colouring == "bodies":
            colours, body_colours = colour_bodies(pairs, len(bodies))
            return cls(pairs, colours, body_colours, solve_order_of(pairs, colours, independent=False))
        colours = colour_contacts(pairs, bodies.ends.inverse_mass)
        return cls(pairs, colours, None, solve_order_of(pairs, colours))

    def __len__(self) -> int:
        return len(self.pairs)

    @property
    def overflows(self) -> bool:
        """Whether some contacts have the colour `OVERFLOW` and are solved one by one."""
        return self.body_colours is None and self.order.count > OVERFLOW
