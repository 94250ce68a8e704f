"""What the kernels that resolve contacts work on, and the phases in which they do."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

RESTITUTION, FRICTION, STABILISATION = 0, 1, 2  # columns of a contact's ledger

# What is wanted at every visit of a contact stands in two cache lines, and what is not in two others.
# hot:  n, ρ_i, ρ_j, 1/(1/m_i + 1/m_j), the mass that a tangential impulse moves, how fast it may close (infinite:
#       left alone);   λ_n, λ_t, and s, what the last sweep changed of them
HOT, IMPULSE = 16, 8
# cold: overlap or minus the gap, overlap as it was found, rest speed, approach, v_n and u before the impulses;
#       its ledger, Σ δ n of the pushes, what part of an overlap a push undoes, 1 if it was found apart
COLD = 16
OVERLAP, FOUND, REST, APPROACH, BEFORE, LEDGER, PUSHES, PART, APART = 0, 1, 2, 3, 4, 8, 11, 14, 15
# motion, of a body or plane: v, ω, 1/m, 1/I;   what the last sweep changed of v and ω
MOTION, CHANGED = 16, 8

BLOCK = 1024  # bodies of a piece of work

STRIKE, BEGIN, PRESS, RELAX, BOOK, AIM, GO = range(7)  # phases: what is done with each piece
PHASE, FIRST, SWEEP, SPINS, IMPACTS_ONLY = range(5)  # which one, with which piece it began, after how many sweeps
DT, DRIFT, KICK, BIAS, ALPHA = range(5)
CHANGE, FARTHEST, CLOSING = range(3)  # what was found in a piece of contacts


CACHE_LINE = 64  # bytes


def rows(count: int, columns: int) -> FloatArray:
    """Return zeros, (count, columns), that begin with a cache line: each row is then in as few of them as can be."""
    room = np.zeros(count * columns + CACHE_LINE // 8)
    first = -room.ctypes.data % CACHE_LINE // 8
    return room[first : first + count * columns].reshape(count, columns)


class Load(NamedTuple):
    """m contacts in the order of their stages, and the n bodies and p planes at their ends."""

    pairs: IntArray  # (m, 2)
    pieces: IntArray  # (k, 2) first contact and the one after the last
    hot: FloatArray  # (m, 16)
    cold: FloatArray  # (m, 16)
    acceleration: FloatArray  # (n + p, 3) m/s²
    motion: FloatArray  # (n + p, 16)
    law: FloatArray  # (1 + p, 3) restitution, static and kinetic friction: between bodies, then of each plane
    who: IntArray  # (b,) bodies and planes that touch anything
    found: FloatArray  # (k, 3), of each piece of contacts
    sums: FloatArray  # (b / BLOCK, 2), of each piece of bodies
    flags: IntArray  # (5,)
    numbers: FloatArray  # (5,)
