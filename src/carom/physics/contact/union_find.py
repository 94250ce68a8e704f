"""Union-find: sets of bodies, each a tree whose root is its lowest body (Galler & Fischer 1964)."""

from __future__ import annotations

from carom.arrays import FloatArray, IntArray
from carom.physics.contact.constraints import ends_of
from carom.physics.jit.atomics import atomic_replace
from carom.physics.jit.decorators import inline, inner, kernel
from carom.physics.jit.index import from_front


@inner
def root_of(parent: IntArray, i: int) -> int:
    """Return the lowest body of the set of a body; halves the path to it."""
    while parent[i] != i:
        parent[i] = parent[from_front(parent[i])]
        i = from_front(parent[i])
    return i


@inner
def join(parent: IntArray, i: int, j: int) -> None:
    """Join the sets of two bodies; the lower root becomes the parent of the higher one."""
    if parent[i] == parent[j]:  # as most are in a heap
        return
    i, j = root_of(parent, i), root_of(parent, j)
    parent[max(i, j)] = min(i, j)


@inner
def join_shared(parent: IntArray, i: int, j: int) -> None:
    """Join the sets of two bodies while other threads join sets; the roots do not depend on their order."""
    i, j = root_of(parent, i), root_of(parent, j)
    while i != j and not atomic_replace(parent, max(i, j), max(i, j), min(i, j)):
        i, j = root_of(parent, i), root_of(parent, j)  # another thread has moved one of the roots


@inline
def join_islands(pairs: IntArray, inverse_mass: FloatArray, parent: IntArray) -> None:
    """Join the sets of the bodies at the ends of each pair, unless one is fixed."""
    for c in range(len(pairs)):
        i, j = ends_of(pairs, c)
        if inverse_mass[i] > 0.0 and inverse_mass[j] > 0.0:
            join(parent, i, j)


@kernel
def number_sets(first: IntArray, second: IntArray, label: IntArray) -> int:
    """Write the number of the set of each body, where pairs join sets; return how many there are.

    Sets are numbered in the order of their lowest bodies.
    """
    for i in range(len(label)):
        label[i] = i
    for c in range(len(first)):
        join(label, first[c], second[c])
    count = 0
    for i in range(len(label)):
        if label[i] == i:
            label[i] = count
            count += 1
        else:  # the parent is lower, so it has its number
            label[i] = label[label[i]]
    return count
