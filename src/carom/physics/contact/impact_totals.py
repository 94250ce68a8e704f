"""Sums over all impacts between two frames, for statistics, since most impacts have no row of their own.

The impacts of a busy run do not fit into memory or into its file. Only the largest impacts keep a row, so the rows are
not a fair sample. These sums include every impact, in the order in which rows are made: by step, and within a step by
time.

The stress also needs Σ m c ⊗ c, where c is the velocity; checkpoints would give this sum at only a few moments.

A path is the polyline through a body's centres at the frames and at its impacts; see docs/statistics.md.
"""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np

from carom.arrays import BoolArray, FloatArray, IntArray, RecordArray, Records, dtype_of
from carom.contact_table import NO_ROWS, SINGLE_SUMS, TENSORS, ContactRow
from carom.physics.aligned import columns
from carom.physics.bodies import Bodies
from carom.physics.jit.decorators import kernel
from carom.physics.sheared_box import ShearedBox
from carom.physics.vector import add, nearest_image, vector, write


class ImpactTotalsRecord(Protocol):
    """The totals of `ImpactSums`."""

    impacts: float
    collisions: float
    speed: float  # m/s
    speed_square: float  # m²/s²
    largest_speed: float  # m/s
    path: float  # m
    virial_square: float  # J²


class PairTotalsRecord(Protocol):
    """The totals of `PairSums`."""

    impacts: float
    speed: float  # m/s
    restitution_loss: float  # J
    friction_loss: float  # J


TOTALS, PAIR_TOTALS = dtype_of(ImpactTotalsRecord), dtype_of(PairTotalsRecord)
PAIRS = tuple(PairTotalsRecord.__annotations__)


class _Corners(NamedTuple):
    """The bodies, and the last corner of each body's path."""

    radius: FloatArray  # (n,) m
    mass: FloatArray  # (n,) kg
    moves: BoolArray  # (n,)
    group: IntArray  # (n,) from 0 on
    groups: int  # number of groups; as a group, this number stands for planes and walls
    last: FloatArray  # (n, 3) m
    box: FloatArray  # (3,) m


class ImpactTotals:
    """Adds up the impacts of a run from one frame to the next.

    ``group``, (n,), has an arbitrary number for each body; `ImpactSums.pairs` numbers the groups in ascending order.
    """

    def __init__(self, bodies: Bodies, group: IntArray, box: FloatArray, shear: ShearedBox | None = None) -> None:
        self._bodies, self._shear = bodies, shear
        groups, number = np.unique(group, return_inverse=True)
        moves = bodies.ends.inverse_mass[: len(bodies)] > 0.0
        own = number.astype(np.int64), len(groups)
        self._corners = _Corners(bodies.radius, bodies.mass, moves, *own, np.zeros((len(bodies), 3)), box)
        self._row = np.zeros(SINGLE_SUMS)
        self._totals = self._row[:-TENSORS].view(TOTALS)
        self._virial, self._kinetic = self._row[-TENSORS:].reshape(2, 3, 3)
        self._pairs = np.zeros((len(groups) + 1) ** 2, PAIR_TOTALS)  # row after row
        self._quiet = True  # whether no impact happened since the last `pop`
        self.forget()
        self.add(NO_ROWS)  # loads the kernel now, so that the first impact does not wait for a compiler

    def forget(self) -> None:
        """Begin new paths at the present positions."""
        self.pop()

    def add(self, rows: Records) -> None:
        """Add impacts, (k,) `CONTACT_ROW`."""
        self._quiet = False
        _add_up(rows, self._corners, self._totals, self._virial, self._pairs)

    def pop(self) -> FloatArray:
        """Return `ImpactSums.flat` since the last call, and begin the next sums at the present positions."""
        bodies, shear = self._bodies, self._shear
        velocity = shear.relative(bodies.velocity, bodies.position) if shear else bodies.velocity
        _end_paths(bodies.position, velocity, self._corners, self._totals, self._kinetic)
        row = self._row.copy()
        self._row[:] = 0.0
        if self._quiet:  # saves 7 of the 30 µs for a frame with few bodies
            return row
        numbers = np.flatnonzero(self._pairs["impacts"])
        ends, met = np.stack(np.divmod(numbers, self._corners.groups + 1), axis=1), columns(self._pairs, PAIRS)[numbers]
        self._pairs[numbers], self._quiet = 0.0, True
        return np.concatenate((row, np.concatenate((ends, met), axis=1).ravel()))


@kernel
def _add_up(
    rows: RecordArray[ContactRow],
    corners: _Corners,
    totals: RecordArray[ImpactTotalsRecord],
    virial: FloatArray,
    pairs: RecordArray[PairTotalsRecord],
) -> None:
    radius, _, moves, group, groups, last, box = corners
    total, n = totals[0], len(radius)
    for k in range(len(rows)):
        row = rows[k]
        i, j, speed = row.i, row.j, row.approach_speed
        nx, ny, nz = row.nx, row.ny, row.nz
        arm, first, second = radius[i], group[i], groups
        if j < n:
            arm += radius[j]
            second = group[j]
        total.impacts += 1.0
        total.speed += speed
        total.speed_square += speed * speed
        total.largest_speed = max(total.largest_speed, speed)
        total.virial_square += arm * row.normal_impulse * (arm * row.normal_impulse)
        jx = row.normal_impulse * nx + row.friction_x
        jy = row.normal_impulse * ny + row.friction_y
        jz = row.normal_impulse * nz + row.friction_z
        for axis in range(3):
            along = arm * (nx if axis == 0 else ny if axis == 1 else nz)
            virial[axis, 0] += along * jx
            virial[axis, 1] += along * jy
            virial[axis, 2] += along * jz
        pair = pairs[min(first, second) * (groups + 1) + max(first, second)]
        pair.impacts += 1.0
        pair.speed += speed
        pair.restitution_loss += row.restitution_loss
        pair.friction_loss += row.friction_loss
        for end in range(2 if j < n else 1):
            body, reach = (i, -radius[i]) if end == 0 else (j, radius[j])
            x, y, z = row.x + reach * nx, row.y + reach * ny, row.z + reach * nz
            dx, dy, dz = nearest_image(x - last[body, 0], y - last[body, 1], z - last[body, 2], box)
            if moves[body]:
                total.collisions += 1.0
                total.path += np.sqrt(dx * dx + dy * dy + dz * dz)
            write(last, body, x, y, z)


@kernel
def _end_paths(
    position: FloatArray,
    velocity: FloatArray,
    corners: _Corners,
    totals: RecordArray[ImpactTotalsRecord],
    kinetic: FloatArray,
) -> None:
    """End the paths of all bodies at their present positions; write Σ m c ⊗ c of their present velocities."""
    _, mass, moves, _, _, last, box = corners
    total, M, px, py, pz = totals[0], 0.0, 0.0, 0.0, 0.0
    for body in range(len(position)):
        x, y, z = vector(position, body)
        if moves[body]:
            dx, dy, dz = nearest_image(x - last[body, 0], y - last[body, 1], z - last[body, 2], box)
            total.path += np.sqrt(dx * dx + dy * dy + dz * dz)
            vx, vy, vz = vector(velocity, body)
            m = mass[body]
            M, px, py, pz = M + m, px + m * vx, py + m * vy, pz + m * vz
        write(last, body, x, y, z)
    if M == 0.0:
        return
    for body in range(len(position)):
        if moves[body]:
            cx, cy, cz = velocity[body, 0] - px / M, velocity[body, 1] - py / M, velocity[body, 2] - pz / M
            add(kinetic, 0, mass[body] * cx, cx, cy, cz)
            add(kinetic, 1, mass[body] * cy, cx, cy, cz)
            add(kinetic, 2, mass[body] * cz, cx, cy, cz)
