"""The contact table: impulses, mode and energies of the contacts of a step, one row per contact; sums over impacts.

Impulses are given for body j, which receives ``normal_impulse`` along the normal, ``friction`` and ``angular``; body i
receives the opposite impulses. docs/physics.md, section 9, defines impulses, modes and energies.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated, NamedTuple, Protocol

import numpy as np

from carom.arrays import FloatArray, IntArray, dtype_of

MODES = ("impact", "sticking", "sliding", "resting", "open")  # `mode` is an index into these names
IMPACT_MODE, STICKING, SLIDING, RESTING, OPEN = range(len(MODES))
# impact: closed faster than the rest speed; sticking, sliding: by Coulomb's law; resting: without friction in the
# model; open: touches without an impulse


class ContactRow(Protocol):
    """A row of the contact table."""

    step: int
    time: float  # s, time of the impact, or end of the step
    i: int  # i < j
    j: int  # the second body; numbers of n and above are planes, as in the collision graph
    x: float  # m, the contact point
    y: float
    z: float
    nx: float  # the normal, from i to j
    ny: float
    nz: float
    arm_i: float  # m, from each centre to the contact point; 0 for planes and walls
    arm_j: float
    approach_speed: float  # m/s, closing speed before the impulses; 0 if the bodies separate
    normal_impulse: float  # N s
    friction_x: float  # N s, the tangential impulse
    friction_y: float
    friction_z: float
    angular_x: float  # N m s, angular impulse by a law that resists rolling or twisting
    angular_y: float
    angular_z: float
    mode: Annotated[int, np.uint8]
    restitution_loss: float  # J, energy that the normal impulse dissipated
    friction_loss: float  # J, energy that the tangential impulse dissipated
    stabilisation_gain: float  # J, energy that the position correction or the bias added


CONTACT_ROW = dtype_of(ContactRow)
NO_ROWS = np.empty(0, CONTACT_ROW)
NO_ANGULAR_IMPULSES: FloatArray = np.empty((0, 0))


def turning_impulses(
    normal: FloatArray, arms: FloatArray, friction: FloatArray, angular: FloatArray = NO_ANGULAR_IMPULSES
) -> FloatArray:
    """Return the angular impulses of contacts on both bodies about their centres, (k, 2, 3) N m s: ρ λ_t × n ± Λ.

    The arguments are the normals, (k, 3), the arms ρ, (k, 2) m, the friction λ_t, (k, 3) N s, and the angular impulses
    Λ, (k, 3) N m s. If no law resists rolling, Λ has no columns.
    """
    turns = arms[:, :, None] * np.cross(friction, normal)[:, None, :]
    if angular.shape[1]:
        turns += angular[:, None, :] * np.array([-1.0, 1.0])[:, None]
    return np.asarray(turns)


ROUNDED_OVERLAP = 1e-13  # largest overlap, in radii, that rounding gives to bodies that just touch


class PairSums(NamedTuple):
    """Sums over the impacts between two groups, (k,), in the order of the pairs of groups."""

    first: IntArray  # the lower group number of each pair; pairs are in ascending order
    second: IntArray  # the higher group number; the number of groups stands for planes and walls
    impacts: FloatArray
    speed: FloatArray  # m/s, sums of the approach speeds
    restitution_loss: FloatArray  # J
    friction_loss: FloatArray  # J


class ImpactSums(NamedTuple):
    """Sums over all impacts between two frames, recorded singly or not, and over the bodies in the later frame."""

    impacts: float
    # number of collisions of movable bodies: two in an impact of two bodies, one in an impact on a plane
    collisions: float
    speed: float  # m/s, sum of the approach speeds v_n
    speed_square: float  # m²/s², Σ v_n²
    largest_speed: float  # m/s
    path: float  # m, total length of the paths of all movable bodies
    virial_square: float  # J², Σ (ℓ λ_n)²
    virial: FloatArray  # (3, 3) J, Σ ℓ ⊗ J; ℓ leads from the centre of i to the centre of j, or to a plane; J acts on j
    kinetic: FloatArray  # (3, 3) J, Σ m c ⊗ c in each frame over movable bodies; c is relative to their centre of mass
    pairs: PairSums

    def flat(self) -> FloatArray:
        """Return all numbers in one row: totals, two tensors, and six numbers for each pair of groups."""
        singles = np.array(self[:_TOTALS], dtype=np.float64), self.virial.ravel(), self.kinetic.ravel()
        return np.concatenate((*singles, np.stack(self.pairs, axis=1, dtype=np.float64).ravel()))

    @classmethod
    def of(cls, row: FloatArray) -> ImpactSums:
        """Undo `flat`; ValueError if there are too few or too many numbers."""
        pairs = row[SINGLE_SUMS:].reshape(-1, len(PairSums._fields)).T
        ends = pairs[:2].astype(np.int64)
        virial, kinetic = row[_TOTALS:SINGLE_SUMS].reshape(2, 3, 3)
        return cls._make((*row[:_TOTALS].tolist(), virial, kinetic, PairSums(*ends, *pairs[2:])))

    @classmethod
    def over(cls, parts: Iterable[ImpactSums]) -> ImpactSums:
        """Add up the sums of consecutive frames."""
        found = list(parts)
        pairs = [np.concatenate(column) for column in zip(*(part.pairs for part in found), strict=True)] or NO_PAIRS
        ends, which = np.unique(np.stack(pairs[:2], axis=1), axis=0, return_inverse=True)
        sums = [np.bincount(which.ravel(), values, len(ends)) for values in pairs[2:]]
        totals = np.array([part[:_TOTALS] for part in found], dtype=np.float64).reshape(-1, _TOTALS).sum(axis=0)
        totals[cls._fields.index("largest_speed")] = max((part.largest_speed for part in found), default=0.0)
        tensors = [sum((part[k] for part in found), np.zeros((3, 3))) for k in (_TOTALS, _TOTALS + 1)]
        return cls._make((*totals.tolist(), *tensors, PairSums(*ends.T, *sums)))


_TOTALS = ImpactSums._fields.index("virial")
TENSORS = 2 * 9  # size of the virial and the kinetic tensor, which follow the totals
SINGLE_SUMS = _TOTALS + TENSORS  # index in `ImpactSums.flat` of the first sum of a pair
NO_PAIRS = PairSums(*(np.empty(0, np.int64),) * 2, *(np.empty(0),) * 4)
