"""The pairs of a step that are listed as contacts: touching pairs, and pairs that may soon touch.

Pairs that touch are near. If contacts last, so are pairs that a fall from rest could close within a step. Iterations
that end early leave small gaps. If such pairs were not listed, their contacts would start without an impulse in the
next step, and a pile would never come to rest: 300 bodies kept 5 × 10⁻⁴ of their energy instead of 10⁻²².
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from carom.arrays import BoolArray, FloatArray, IntArray
from carom.physics.bodies import Bodies
from carom.physics.contact.broad_phase.pairs import search_by
from carom.physics.contact.broad_phase.planes import PlaneSearch
from carom.physics.contact.constraints import ends_of
from carom.physics.contact.geometry import SearchedSpheres, are_near
from carom.physics.contact.islands import excess_square
from carom.physics.contact.law import Materials
from carom.physics.contact.solver.prepare import TOUCHING
from carom.physics.jit.decorators import long_kernel
from carom.physics.jit.instructions import atomic_max
from carom.physics.jit.team import SOLO, Team
from carom.physics.sheared_box import ShearedBox, nearest_in_drift
from carom.physics.vector import between
from carom.scene.schema import ContactSettings
from carom.scene.start import HalfSpaces

ROUNDING = 4  # units in the last place of the largest coordinate; a smaller gap counts as a contact
LARGEST_SKIN = 0.1  # of the smallest radius
MIN_BODIES_PER_TASK = 4000  # about 10 µs of work
SQUARE, COORDINATE = range(2)  # indices into the array of largest values


@dataclass(frozen=True, slots=True)
class ContactWorld:
    """Everything besides the bodies that the contacts of a scene depend on."""

    planes: HalfSpaces
    materials: Materials  # coefficients of the contact law
    box: FloatArray  # (3,) m, size of the periodic box; zeros in open space
    field: FloatArray  # (3,) m/s², the uniform field if it accelerates everything alike; zeros if something is fixed
    bending: FloatArray  # (3,) m/s², the uniform field if something is fixed; zeros if it accelerates everything alike
    shear: ShearedBox | None  # images of a sheared box
    exact: bool  # whether impacts are resolved at their exact times

    @property
    def is_still(self) -> bool:
        """Whether no wall and no image moves."""
        return not self.planes.moves and self.shear is None

    @property
    def meets_in_drifts(self) -> bool:
        """Whether all contacts are impacts in a drift: in a sheared box, they last only without exact times."""
        return self.exact and self.shear is not None

    @property
    def solver_box(self) -> FloatArray:
        """The box for the kernels of lasting contacts, or the record of a sheared one."""
        return self.shear.at_present if self.shear and not self.exact else self.box

    def flow(self, largest: float) -> float:
        """Return the acceleration (m/s²) with which the flow of a sheared box may close contacts.

        ``largest`` is the radius of the largest body in m.
        """
        return self.shear.acceleration(2.0 * largest) if self.shear else 0.0


class NearPairs:
    """Finds the near pairs of spheres, and of spheres and planes."""

    def __init__(
        self, contact: ContactSettings, bodies: Bodies, world: ContactWorld, lasting: bool, team: Team
    ) -> None:
        self._bodies, self._field, self._lasting, self._team = bodies, world.field, lasting, team
        planes = world.planes
        self.search = search_by(contact.search, bodies.radius, world.box, team)
        self._planes = PlaneSearch(bodies.radius, bodies.ends.inverse_mass, planes, team)
        self.has_statics = len(planes) > 0 or bool((bodies.ends.inverse_mass[: len(bodies)] == 0.0).any())
        self._smallest, self._press_alone = float(bodies.radius.min()), planes.press_alone
        self.pressing = bodies.acceleration  # (n, 3) m/s², the accelerations that press contacts together
        self._lift = planes.largest_acceleration
        self._shear = world.shear
        # m/s², of a guided wall, or of contacts that a flow closes
        self._presses = abs(planes.guided.acceleration) if planes.guided else world.flow(float(bodies.radius.max()))
        self.rounding = 0.0  # m, of the coordinates
        self.loading = 1.0  # largest factor by which walls increase the acceleration that presses contacts together

    def find(self, dt: float) -> IntArray:
        """Return the near pairs of a step of dt s, (m, 2), sorted."""
        position = self._bodies.position
        scale, skin = self.margins(dt)
        if self._shear:  # the grid finds pairs that may be near their images
            stretch = self._shear.stretch(0.0)
            pairs = self.search.pairs(self._shear.carried(position), stretch * scale, stretch * skin)
            near = np.empty(len(pairs), dtype=np.bool_)
            _find_near(pairs, (position, self._bodies.radius, self._shear.at_present, scale, skin), near)
            return pairs[near]
        pairs = self.search.pairs(position, scale, skin)
        return self._planes.merged(pairs, position, scale, skin) if self.has_statics else pairs

    @property
    def lists_open(self) -> bool:
        """Whether the pairs found last may have a gap."""
        return self.rounding > 0.0

    def margins(self, dt: float) -> tuple[float, float]:
        """Return scale and skin (in m): a pair is near if its distance is at most ``(r_i + r_j) scale + skin``."""
        if not self._lasting:
            return 1.0, 0.0
        bodies = self._bodies
        square, coordinate = largest_values(self.pressing, self._field, bodies.position, self._team)
        own = max(np.sqrt(square), self._presses)
        fall = (own + self._lift) * dt * dt
        self.loading = 1.0 + self._lift / own if own > 0.0 else 1.0
        if (own == 0.0 or fall == 0.0) and not self._press_alone:  # all contacts are impacts, which need no near pairs
            self.rounding = 0.0
            return 1.0, 0.0
        self.rounding = ROUNDING * float(np.spacing(coordinate))
        return 1.0 + TOUCHING, self.rounding + min(fall, LARGEST_SKIN * self._smallest)


@long_kernel
def _find_near(pairs: IntArray, spheres: SearchedSpheres, near: BoolArray) -> None:
    """Test which pairs are near in a sheared box."""
    position, radius, box, scale, skin = spheres
    for c in range(len(pairs)):
        i, j = ends_of(pairs, c)
        dx, dy, dz = between(position, i, j)
        dx, dy, dz = nearest_in_drift(dx, dy, dz, box, 0.0)
        near[c] = are_near(dx, dy, dz, radius[i] + radius[j], (0.0, 0.0, 0.0), scale, skin)


def largest_values(
    acceleration: FloatArray, field: FloatArray, position: FloatArray, team: Team = SOLO
) -> tuple[float, float]:
    """Return the largest |a - field|² of a body, in m²/s⁴, and the largest coordinate by magnitude, in m."""
    largest = np.zeros(2)
    shared = largest.view(np.int64)
    team.divide(len(position), MIN_BODIES_PER_TASK, _update_largest, acceleration, field, position, shared)
    return float(largest[SQUARE]), float(largest[COORDINATE])


@long_kernel
def _update_largest(
    lo: int, hi: int, acceleration: FloatArray, field: FloatArray, position: FloatArray, shared: IntArray
) -> None:
    """Raise the largest values to those of the bodies [lo, hi), as bit patterns."""
    largest = np.zeros(2)
    for i in range(lo, hi):
        largest[SQUARE] = max(largest[SQUARE], excess_square(acceleration, field, i))
        for k in range(3):
            largest[COORDINATE] = max(largest[COORDINATE], abs(position[i, k]))
    bits = largest.view(np.int64)  # bit patterns of non-negative numbers sort like the numbers
    atomic_max(shared, SQUARE, bits[SQUARE])
    atomic_max(shared, COORDINATE, bits[COORDINATE])
