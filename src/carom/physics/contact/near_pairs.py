"""The pairs of a step that are listed as contacts: touching pairs, and pairs that may soon touch.

Pairs that touch are near. If contacts can last, pairs that a fall from rest could close within a step are also near.
Iterations that end early leave small gaps. If such pairs were not listed, their contacts would start without an impulse
in the next step, and a pile would never come to rest: 300 bodies kept 5 × 10⁻⁴ of their energy instead of 10⁻²².
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from carom.arrays import BoolArray, FloatArray, IntArray, RecordArray
from carom.physics.bodies import Bodies
from carom.physics.contact.constraints import ends_of
from carom.physics.contact.facets import consists_of_facets, first_facet, next_facet
from carom.physics.contact.geometry import SearchedSpheres, are_near, height_above
from carom.physics.contact.graph import first_of
from carom.physics.contact.islands import excess_square
from carom.physics.contact.law import Materials
from carom.physics.contact.pair_list import BLOCK, BlockRecord, close_up, search_by
from carom.physics.contact.solids import touches_here
from carom.physics.contact.solver.prepare import TOUCHING
from carom.physics.contact.translating_walls import shift_of
from carom.physics.jit.decorators import inner, kernel, long_kernel
from carom.physics.jit.instructions import atomic_max, from_front
from carom.physics.jit.team import SOLO, Team
from carom.physics.sheared_box import ShearedBox, nearest_in_drift
from carom.physics.vector import between, vector
from carom.scene.schema import ContactSettings
from carom.scene.start import HalfSpaces

ROUNDING = 4  # units in the last place of the largest coordinate; pairs with a smaller gap touch
LARGEST_SKIN = 0.1  # largest skin, as a fraction of the smallest radius
MIN_BODIES_PER_TASK = 4000  # bodies for about 10 µs of work
SQUARE, COORDINATE = range(2)  # indices into the array of largest values
BODIES_PER_MERGE = 1024  # bodies for which pairs with planes are added at a time: 24 KiB of positions
MIN_MERGES_PER_TASK = 1
FEWEST_FACETS = 4  # space for facets near a body; doubled when it is exceeded


@dataclass(frozen=True, slots=True)
class ContactWorld:
    """The data, besides the bodies, on which the contacts of a scene depend."""

    planes: HalfSpaces
    materials: Materials  # coefficients of the contact law
    box: FloatArray  # (3,) m, size of the periodic box; zeros in open space
    field: FloatArray  # (3,) m/s², the uniform field if it accelerates everything alike; zeros if something is fixed
    bending: FloatArray  # (3,) m/s², the uniform field if something is fixed; zeros if it accelerates everything alike
    shear: ShearedBox | None  # the sheared box, whose images move; otherwise None
    exact: bool  # whether impacts are resolved at their exact times

    @property
    def is_still(self) -> bool:
        """Whether no wall and no image moves."""
        return not self.planes.moves and self.shear is None

    @property
    def meets_in_drifts(self) -> bool:
        """Whether all contacts are impacts in a drift, as in a sheared box with exact times."""
        return self.exact and self.shear is not None

    @property
    def solver_box(self) -> FloatArray:
        """The box for the kernels of lasting contacts, or the record of a sheared box."""
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
        self.pressing = bodies.acceleration  # (n, 3) m/s², accelerations that press contacts together
        self._lift = planes.largest_acceleration
        self._shear = world.shear
        self._guided = planes.guided
        self._flow = world.flow(float(bodies.radius.max()))  # m/s², acceleration with which the flow closes contacts
        self.rounding = 0.0  # m, rounding error of the coordinates
        self.loading = 1.0  # largest factor by which walls increase the acceleration that presses contacts together

    def find(self, dt: float) -> IntArray:
        """Return the near pairs of a step of dt s, (m, 2), sorted."""
        position = self._bodies.position
        scale, skin = self.margins(dt)
        if self._shear:  # the grid finds pairs whose images may be near each other
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
        own = max(np.sqrt(square), self._guided.largest_acceleration if self._guided else self._flow)
        fall = (own + self._lift) * dt * dt
        self.loading = 1.0 + self._lift / own if own > 0.0 else 1.0
        if (own == 0.0 or fall == 0.0) and not self._press_alone:  # all contacts are impacts, so no list is needed
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


@kernel
def _update_largest(
    lo: int, hi: int, acceleration: FloatArray, field: FloatArray, position: FloatArray, shared: IntArray
) -> None:
    """Raise the largest values to the values of the bodies [lo, hi), as bit patterns."""
    largest = np.zeros(2)
    for i in range(lo, hi):
        largest[SQUARE] = max(largest[SQUARE], excess_square(acceleration, field, i))
        for k in range(3):
            largest[COORDINATE] = max(largest[COORDINATE], abs(position[i, k]))
    bits = largest.view(np.int64)  # bit patterns of non-negative numbers sort like the numbers
    atomic_max(shared, SQUARE, bits[SQUARE])
    atomic_max(shared, COORDINATE, bits[COORDINATE])


class PlaneSearch:
    """Adds the contacts (i, n + k) of bodies with planes k, and drops contacts of two fixed bodies."""

    def __init__(self, radius: FloatArray, inverse_mass: FloatArray, planes: HalfSpaces, team: Team) -> None:
        self._radius, self._inverse_mass, self._planes, self._team = radius, inverse_mass, planes, team
        self._facets = FEWEST_FACETS if planes.has_facets else 0  # space for each body

    def merged(self, pairs: IntArray, position: FloatArray, scale: float, skin: float) -> IntArray:
        """Return the pairs merged with the pairs of bodies and planes, (m, 2) sorted by (i, j)."""
        n, p, team = len(self._radius), len(self._planes), self._team
        blocks = np.empty(-(-n // BODIES_PER_MERGE), dtype=BLOCK)
        spheres, planes = (position, self._radius, self._inverse_mass), (self._planes.surface, self._planes.offset)
        while True:
            space = p + self._facets
            merged = np.empty((len(pairs) + n * space, 2), dtype=np.int64)
            nearness = scale, skin, space
            team.divide(len(blocks), MIN_MERGES_PER_TASK, _merge, pairs, spheres, planes, nearness, merged, blocks)
            if self._facets == 0 or not (blocks["count"] < 0).any():
                return close_up(merged, blocks, team)
            self._facets *= 2


@long_kernel
def _merge(
    lo: int,
    hi: int,
    pairs: IntArray,
    spheres: tuple[FloatArray, FloatArray, FloatArray],
    planes: tuple[FloatArray, FloatArray],
    nearness: tuple[float, float, int],
    merged: IntArray,
    blocks: RecordArray[BlockRecord],
) -> None:
    """Merge the pairs of the blocks [lo, hi) of bodies; each body has space for its pairs with planes.

    The count of a block is -1 if the facets near a body need more space.
    """
    (position, radius, inverse_mass), (normal, offset), (scale, skin, space) = spheres, planes, nearness
    c = from_front(first_of(lo * BODIES_PER_MERGE, pairs))
    for block in range(from_front(lo), hi):
        begin = c + block * BODIES_PER_MERGE * space
        m, lacks = begin, False
        for i in range(block * BODIES_PER_MERGE, min(len(radius), (block + 1) * BODIES_PER_MERGE)):
            while c < len(pairs) and pairs[c, 0] == i:
                if inverse_mass[i] + inverse_mass[pairs[c, 1]] > 0.0:
                    merged[m, 0], merged[m, 1] = i, pairs[c, 1]
                    m += 1
                c += 1
            if inverse_mass[i] == 0.0:
                continue
            for k in range(len(offset)):
                x, y, z = vector(position, i)
                if height_above(normal, offset, k, x, y, z) <= radius[i] * scale + skin:
                    merged[m, 0], merged[m, 1] = i, len(radius) + k
                    m += 1
            last = m + space - len(offset)
            for k in range(len(offset)):
                if consists_of_facets(normal, k):
                    m = _add_facets(i, k, spheres, planes, radius[i] * scale + skin, merged, (m, last))
            lacks = lacks or m > last
            m = min(m, last)
        blocks[block].begin, blocks[block].count = begin, -1 if lacks else m - begin


@inner
def _add_facets(
    i: int,
    wall: int,
    spheres: tuple[FloatArray, FloatArray, FloatArray],
    planes: tuple[FloatArray, FloatArray],
    reach: float,
    merged: IntArray,
    rows: tuple[int, int],
) -> int:
    """Add the pairs of a body with facets of a wall within ``reach`` (m), sorted; return the row after them.

    ``rows`` are the first free row and the end of the space; a result beyond the end means that the space is too small.
    """
    (x, y, z), (surface, offset), (m, last) = vector(spheres[0], i), planes, rows
    begin, (dx, dy, dz) = m, shift_of(surface, wall)
    point = x - dx, y - dy, z - dz
    facet, walk = next_facet(surface, wall, first_facet(surface, wall), point, reach)
    while facet >= 0:
        if height_above(surface, offset, facet, x, y, z) <= reach and touches_here(surface, facet, x, y, z):
            if m >= last:
                return last + 1
            j, place = len(spheres[1]) + facet, m
            while place > begin and merged[place - 1, 1] > j:
                merged[place, 0], merged[place, 1] = i, merged[place - 1, 1]
                place -= 1
            merged[place, 0], merged[place, 1] = i, j
            m += 1
        facet, walk = next_facet(surface, wall, walk, point, reach)
    return m


@kernel
def are_present(pairs: IntArray, absent: BoolArray) -> BoolArray:
    """Return which pairs have both ends present; ``absent``, (n,), marks absent bodies; planes are always present."""
    present, n = np.empty(len(pairs), dtype=np.bool_), len(absent)
    for c in range(len(pairs)):
        i, j = pairs[c, 0], pairs[c, 1]
        present[c] = not (absent[i] or (j < n and absent[j]))
    return present
