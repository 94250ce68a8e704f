"""What the kernels that resolve contacts work on, and the phases in which they do."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

# What is wanted at every visit of a contact stands in two cache lines, and what is not in two others.
# hot:  n, ρ_i, ρ_j, 1/(1/m_i + 1/m_j), the mass that a tangential impulse moves, how fast it may close (infinite:
#       left alone);   λ_n, λ_t, and s, what the last sweep changed of them
HOT, IMPULSE = 16, 8
# cold: overlap or minus the gap, overlap as it was found, rest speed, approach, v_n and u before the impulses;
#       its ledger, Σ δ n of the pushes, what part of an overlap a push undoes, 1 if it was found apart
COLD = 16
OVERLAP, FOUND, REST, APPROACH, BEFORE, LEDGER, PUSHES, PART, APART = 0, 1, 2, 3, 4, 8, 11, 14, 15
# motion, of a body or plane: v, ω, 1/m, 1/I;   what the last sweep changed of v and ω
MOTION = 16

# search: s, what conjugate gradients change of λ_n and λ_t; d, the direction; r, the residual;   c, how fast the
#         contact may close, 1 where λ_n is free to change, 1 where λ_t is
SEARCH = 16
STEP, DIRECTION, RESIDUAL, ALLOWED, FREE_NORMAL, FREE_TANGENT = 0, 4, 8, 12, 13, 14

BLOCK = 1024  # bodies of a piece of work

# phases: what is done with each piece
PUSH, STRIKE, BEGIN, PRESS, RELAX, BOOK, AIM, GO, MEASURE, DESCEND, SPREAD, PROJECT = range(12)
# which one, with which piece it began, after how many sweeps; 1 if bodies turn, if only impacts are resolved, and if
# conjugate gradients follow the sweeps
PHASE, FIRST, SWEEP, SPINS, IMPACTS_ONLY, REFINES = range(6)
DT, DRIFT, KICK, BIAS, ALPHA, BETA, NEGLIGIBLE, TOLERANCE = range(8)
CHANGE, FARTHEST, CLOSING = range(3)  # what was found in a piece of contacts by a sweep
PUSH_MOST, PULL_MOST = 1, 2  # N s, by conjugate gradients: the largest impulse that pushes, and that pulls
FASTEST, RESTING = 1, 2  # by the first one over impacts; in the end the sums of the columns of the ledger


class Load(NamedTuple):
    """m contacts in the order of their stages, and the n bodies and p planes at their ends."""

    pairs: IntArray  # (m, 2)
    pieces: IntArray  # (k, 2) first contact and the one after the last
    hot: FloatArray  # (m, 16)
    cold: FloatArray  # (m, 16)
    search: FloatArray  # (m, 16)
    position: FloatArray  # (n, 3) m
    velocity: FloatArray  # (n + p, 3) m/s
    spin: FloatArray  # (n + p, 3) rad/s; no rows where impulses turn nothing
    acceleration: FloatArray  # (n + p, 3) m/s²
    inverse_mass: FloatArray  # (n + p,) 1/kg
    radius: FloatArray  # (n + p,) m
    box: FloatArray  # (3,) m, zeros in open space
    surface: FloatArray  # (p, 3) normals of the planes
    offset: FloatArray  # (p,) m
    motion: FloatArray  # (n + p, 16)
    law: FloatArray  # (1 + p, 3) restitution, static and kinetic friction: between bodies, then of each plane
    island: IntArray  # (n + p,), a table to write in
    work: FloatArray  # (n + p, 2), likewise
    who: IntArray  # (b,) bodies and planes that touch anything
    found: FloatArray  # (k, 3), of each piece of contacts
    sums: FloatArray  # (b / BLOCK, 2), of each piece of bodies
    flags: IntArray  # (6,)
    numbers: FloatArray  # (8,)
