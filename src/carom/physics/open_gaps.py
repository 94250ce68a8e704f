"""The contact stages of the kernel for few bodies while nothing touches: they test whether all gaps stay open.

`carom.physics.few_bodies` calls these functions in each step, with the contacts of the step as the first argument.
Here this argument is an empty tuple. `carom.physics.contact.events.steady_contacts` has forms of the functions for
contacts that last.

All gaps must stay larger than rounding, and larger than the distance that a body falls from rest in one step, since
`contact.pipeline` searches for contacts within that distance. Paths are straight, so two bodies approach each other by
at most |v_j - v_i| dt; with drag, v is the mean velocity of the drift. All pairs and planes are tested again only after
the bodies may have moved by half the smallest gap.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

import numpy as np

from carom.arrays import FloatArray, RecordArray, dtype_of
from carom.physics.contact.geometry import height_above
from carom.physics.contact.solver.prepare import TOUCHING
from carom.physics.integrators.kick_drift import DampedStep
from carom.physics.jit.decorators import Function, for_first, inner
from carom.physics.rotation import rotate_one
from carom.physics.vector import is_periodic, minimum_image, square

NEAR = 2.0 * TOUCHING  # gap relative to the sum of radii; twice the largest gap of touching bodies
# rounding relative to the coordinates: 64 units in the last place; the search for contacts allows for four
ROUNDING = 2.0**-46
GRAIN = 2.0**-50  # relative to the coordinates: more than the rounding of a drift
BOX_FRACTION = 0.25  # bodies are tested again after they may have moved by this fraction of the box's smallest side
FAR = 1e150  # m, smallest gap if there are no pairs


class MovedState(NamedTuple):
    """The state that the steps update."""

    position: FloatArray  # (n, 3) m
    velocity: FloatArray  # (n, 3) m/s
    acceleration: FloatArray  # (n, 3) m/s²
    orientation: FloatArray  # (n, 4) xyzw, orientations; empty where nothing rotates
    angular_velocity: FloatArray  # (n, 3) rad/s, spins; empty where nothing rotates


class KeptState(NamedTuple):
    """The constants of the steps."""

    radius: FloatArray  # (n,) m
    mass: FloatArray  # (n,) kg
    inverse_mass: FloatArray  # (n + p,) 1/kg
    supported: FloatArray  # (n + p,) m/s², accelerations that contacts support; empty if no step depends on them
    field: FloatArray  # (3,) m/s², the uniform field if it accelerates all bodies alike; otherwise zeros
    box: FloatArray  # (3,) m, size of the periodic box; zeros in open space
    normal: FloatArray  # (p, 3) unit normals of the planes
    offset: FloatArray  # (p,) m


class TotalsRecord(Protocol):
    """Totals of the steps, to be added to the books, and values of the last step that the next step needs."""

    restitution: float  # J, terms of the `Ledger`: this field and the next two
    friction: float
    stabilisation: float
    held_restitution: float  # J, terms of the first kick of the step: this field and the next two
    held_friction: float
    held_stabilisation: float
    impact_energy: float  # J, energy of recent impacts before the last step; see `Activity`
    deepest: float  # largest overlap in the run, relative to the smaller radius
    deepest_i: int
    deepest_j: int
    deepest_step: int  # step of the deepest overlap; 0 if it was before these steps
    deepest_time: float  # s, time of the deepest overlap
    most: int  # largest number of contacts in a step of the run
    most_step: int  # step with the most contacts; 0 if it was before these steps
    most_time: float  # s, time of the step with the most contacts
    contacts: int  # sum of the numbers of contacts in these steps
    last_kick: float  # s, length of the last kick in which contacts were held; 0 if they carry no impulses
    last_dt: float  # s
    sweeps: int  # number of sweeps in the last step


Room = tuple[float, float, float]
"""Lengths in m: smallest gap at the last test, largest possible motion of a body since then, rounding of a drift."""

UNTESTED: Room = (0.0, 0.0, 0.0)
TOTALS = dtype_of(TotalsRecord)
Totals = RecordArray[TotalsRecord]  # (1,)


def _without_contacts(function: Function) -> Function:
    """Let kernels call a function if the first argument is an empty tuple."""
    return for_first(function, lambda contacts: not hasattr(contacts, "fields"))(function)


def with_contacts(function: Callable[..., Any]) -> Callable[[Function], Function]:
    """Let kernels call the decorated function in place of a function of this module if there are contacts."""
    return for_first(function, lambda contacts: hasattr(contacts, "fields"))


@_without_contacts
def write_support(contacts: Any, totals: Totals) -> None:
    """Write the accelerations that contacts supported in the last kick."""


@_without_contacts
def copy_records(contacts: Any, back: bool) -> None:
    """Copy the records of contacts as a step begins, or copy them back."""


@_without_contacts
def hold(contacts: Any, totals: Totals, damped: DampedStep) -> bool:
    """Hold the contacts of the last step after the first kick; return whether the step can continue."""
    return True


@_without_contacts
def can_drift(
    contacts: Any,
    totals: Totals,
    damped: DampedStep,
    moved: MovedState,
    kept: KeptState,
    field: float,
    drift: float,
    room: Room,
) -> tuple[bool, Room]:
    """Return whether all bodies stay apart in a drift of ``drift`` s, and the room after it.

    ``field`` (m/s²) is the magnitude of the uniform acceleration.
    """
    (gap, gone, grain), length = room, damped.length
    fastest, largest = _fastest(moved.velocity, moved.acceleration)
    skin = (largest + field) * damped.path.strength * length * length
    if not 2.0 * (gone + fastest * abs(drift) + grain) + skin < gap:
        gap, grain = _smallest_gap(moved.position, moved.velocity, kept, abs(drift), skin)
        gone = 0.0
    return gap > 0.0, (gap, gone + fastest * abs(drift) + grain, grain)


@_without_contacts
def find(contacts: Any, totals: Totals, damped: DampedStep) -> bool:
    """Find contacts after the drift of a step, and correct overlaps; return whether the step can continue."""
    return True


@_without_contacts
def resolve(contacts: Any, totals: Totals, damped: DampedStep) -> bool:
    """Resolve the contacts after the last kick; return whether the step is complete without Python."""
    return True


@_without_contacts
def rotate(contacts: Any, orientation: FloatArray, spins: FloatArray, dt: float) -> None:
    """Rotate the bodies by ``spins``, (n, 3) rad/s, over a step of dt s; with contacts, by spins before the step."""
    for i in range(len(orientation)):
        rotate_one(i, orientation, spins, dt)


@_without_contacts
def conclude(contacts: Any, totals: Totals, dt: float, step: int, time: float) -> None:
    """Write torques and add to the totals at the end of a step of dt s."""


@inner
def _fastest(velocity: FloatArray, acceleration: FloatArray) -> tuple[float, float]:
    """Return the largest speed (m/s) and acceleration (m/s²); NaN if any is not finite."""
    v2_max, a2_max, rest = 0.0, 0.0, 0.0
    for i in range(len(velocity)):
        v2, a2 = square(velocity, i), square(acceleration, i)
        v2_max, a2_max = max(v2_max, v2), max(a2_max, a2)
        rest += (v2 - v2) + (a2 - a2)  # adds 0, or NaN if an input is not finite
    return np.sqrt(v2_max) + rest, np.sqrt(a2_max)


@inner
def _smallest_gap(x: FloatArray, v: FloatArray, kept: KeptState, dt: float, skin: float) -> tuple[float, float]:
    """Return the smallest gap and the drift's rounding, both in m; zeros if a gap may close to the skin in dt s."""
    radius, inverse_mass, box, normal, offset = kept.radius, kept.inverse_mass, kept.box, kept.normal, kept.offset
    size = 0.0  # m, size of the coordinates
    for i in range(len(x)):
        size = max(size, radius[i], abs(x[i, 0]), abs(x[i, 1]), abs(x[i, 2]))
    for p in range(len(offset)):
        size = max(size, abs(offset[p]))
    smallest = BOX_FRACTION * min(box[0], box[1], box[2]) if is_periodic(box) else FAR
    for i in range(len(x)):
        for j in range(i + 1, len(x)):
            if inverse_mass[i] == 0.0 and inverse_mass[j] == 0.0:
                continue
            d2, u2 = 0.0, 0.0
            for k in range(3):
                d, u = x[j, k] - x[i, k], v[j, k] - v[i, k]
                if box[k] > 0.0:
                    d = minimum_image(d, box[k])
                d2 += d * d
                u2 += u * u
            gap = np.sqrt(d2) - (radius[i] + radius[j]) * (1.0 + NEAR) - ROUNDING * size
            if not gap > np.sqrt(u2) * dt + skin:
                return 0.0, 0.0
            smallest = min(smallest, gap)
        for p in range(len(offset)):
            if inverse_mass[i] == 0.0:
                continue
            rise = 0.0
            for k in range(3):
                rise += normal[p, k] * v[i, k]
            height = height_above(normal, offset, p, x[i, 0], x[i, 1], x[i, 2])
            gap = height - radius[i] * (1.0 + NEAR) - ROUNDING * size
            if not gap > abs(rise) * dt + skin:
                return 0.0, 0.0
            smallest = min(smallest, gap)
    return smallest, GRAIN * (size + smallest)
