"""The contact constraints of a step as records, and the other arrays of the solver's kernels.

Records fill whole cache lines. Fields that only the phases before and after the iterations use have lines of their own,
apart from the fields that the iterations use.
"""

from __future__ import annotations

from typing import NamedTuple

from carom.arrays import BoolArray, FloatArray, IntArray, RecordArray, dtype_of
from carom.physics.aligned import CACHE_LINE
from carom.physics.contact.records import (
    BlockSumsRecord,
    BodyStateRecord,
    ContactRecord,
    ContactStateRecord,
    GuidedBodyRecord,
    ImageContactRecord,
    ImpulseRecord,
    IslandRecord,
    LoadRecord,
    MeasuredRecord,
    PieceResultsRecord,
    PushedBodyRecord,
    RollingContactRecord,
    RollingImageContactRecord,
    RollingImpulseRecord,
    RollingSlidingWallContactRecord,
    RollingWallContactRecord,
    SearchRecord,
    SettingsRecord,
    SlidingWallContactRecord,
    WallContactRecord,
)
from carom.physics.jit.decorators import inline
from carom.physics.jit.instructions import from_front
from carom.scene.schema import Coefficients

# Largest overlap, relative to the sum of radii, that is not corrected further. The first value applies to contacts
# whose impulses converge to rounding, the second to contacts whose iterations end with small changes. The next step
# corrects the remaining overlap.
ENOUGH = 1e-9
ENOUGH_AS_NEEDED = 1e-5

BODIES_PER_BLOCK = 1024
CONTACTS_PER_BLOCK = 1024
SHARED_FROM = 2048  # number of contacts below which threads cost as much time as they save
# Contacts or bodies per task. Either all phases are shared or none, since sharing moves records between the caches of
# cores.
MIN_PER_TASK = SHARED_FROM // 2


CONTACT = dtype_of(ContactRecord, size=2 * CACHE_LINE)
ROLLING_CONTACT = dtype_of(RollingContactRecord, size=4 * CACHE_LINE)
CONTACT_ON_WALL = dtype_of(WallContactRecord, size=3 * CACHE_LINE)
ROLLING_ON_WALL = dtype_of(RollingWallContactRecord, size=4 * CACHE_LINE)
CONTACT_ON_MOVING_WALL = dtype_of(SlidingWallContactRecord, size=3 * CACHE_LINE)
ROLLING_ON_MOVING_WALL = dtype_of(RollingSlidingWallContactRecord, size=4 * CACHE_LINE)
CONTACT_OF_IMAGE = dtype_of(ImageContactRecord, size=3 * CACHE_LINE)
ROLLING_CONTACT_OF_IMAGE = dtype_of(RollingImageContactRecord, size=4 * CACHE_LINE)
CONTACT_STATE = dtype_of(ContactStateRecord, size=2 * CACHE_LINE)
BODY_STATE = dtype_of(BodyStateRecord, size=2 * CACHE_LINE)
GUIDED_BODY = dtype_of(GuidedBodyRecord, size=4 * CACHE_LINE)
PUSHED_BODY = dtype_of(PushedBodyRecord, size=CACHE_LINE)
SEARCH = dtype_of(SearchRecord, size=2 * CACHE_LINE)
RECORDED = dtype_of(ImpulseRecord, size=CACHE_LINE)
ROLLING_RECORDED = dtype_of(RollingImpulseRecord, size=2 * CACHE_LINE)
PIECE_RESULTS = dtype_of(PieceResultsRecord, size=2 * CACHE_LINE)
MEASURED = dtype_of(MeasuredRecord)
BLOCK_SUMS = dtype_of(BlockSumsRecord)
ISLAND = dtype_of(IslandRecord)
SETTINGS = dtype_of(SettingsRecord)

(
    CORRECT_POSITIONS,
    RESOLVE_IMPACTS,
    PREPARE,
    WARM_START,
    SOLVE,
    AUDIT,
    LINE_SEARCH,
    EXTRAPOLATE,
    MEASURE_VIOLATION,
    CONJUGATE_STEP,
    CONJUGATE_DIRECTION,
    PROJECT,
    SCALE_BACK,
) = range(13)  # the phases of the solver, in order


class ConstraintSystem(NamedTuple):
    """m contacts in the order in which they are resolved, and the n bodies and p planes at their ends."""

    pairs: IntArray  # (m, 2)
    pieces: IntArray  # (k, 2) first contact of each piece, and the end of its range
    edges: IntArray  # (s + 1,) first piece of each colour, and k
    contacts: RecordArray[ContactRecord]  # (m,) contacts, or ROLLING_CONTACT if the law resists rolling
    held: BoolArray  # (m,) whether each contact is held; impacts and open gaps are not
    enough: FloatArray  # (m,) uncorrected overlap: `ENOUGH`, or `ENOUGH_AS_NEEDED` where small changes suffice
    small_change: FloatArray  # (m,) m/s, change of a contact's velocities below which it needs no further iteration
    states: RecordArray[ContactStateRecord]  # (m,)
    load_speed: FloatArray  # (m,) m/s, largest acceleration in the contact's island times the step; see `islands`
    search: RecordArray[SearchRecord]  # (m,)
    measured: RecordArray[MeasuredRecord]  # (m,)
    recorded: RecordArray[ImpulseRecord]  # (m,) impulses, or ROLLING_RECORDED; empty unless contacts are recorded
    velocity: FloatArray  # (n + p, 3) m/s, velocities
    spin: FloatArray  # (n + p, 3) rad/s, spins; empty without friction
    acceleration: FloatArray  # (n + p, 3) m/s², accelerations
    inverse_mass: FloatArray  # (n + p,) 1/kg
    box: FloatArray  # (3,) m, size of the periodic box, zeros in open space; or the record of a sheared box
    position: FloatArray  # (n, 3) m
    surface: FloatArray  # (p, 3) normals of the planes, or records of planes and walls: see `solids`
    offset: FloatArray  # (p,) m
    bodies: RecordArray[BodyStateRecord]  # (n + p,)
    pushed: RecordArray[PushedBodyRecord]  # (n + p,)
    pushed_in: IntArray  # (n + p,) iteration in which the position correction last moved each end, or `NEVER`
    materials: RecordArray[Coefficients]  # (k,) MATERIAL, by `law.material_index`
    places: IntArray  # (n + p, 2) places for `law.material_index`; empty where all bodies have one material
    island: IntArray  # (n + p,) workspace, the root of each body's island
    islands: RecordArray[IslandRecord]  # (n + p,) workspace
    active: IntArray  # (b,) bodies and planes with a contact
    # (n + p,) whether contacts have pressed each body since the last step; False for fixed ends
    pressed: BoolArray
    loads: RecordArray[LoadRecord]  # (n + p,) `LOAD` of the last kick; 0 for fixed ends
    piece_results: RecordArray[PieceResultsRecord]  # (k,)
    sums: RecordArray[BlockSumsRecord]  # (b / BODIES_PER_BLOCK,)
    settings: RecordArray[SettingsRecord]  # (1,)


@inline
def contacts_of(first: int, end: int, system: ConstraintSystem) -> tuple[int, int]:
    """Return the first contact of the pieces [first, end), and the end of their range."""
    return from_front(system.pieces[first, 0]), from_front(system.pieces[end - 1, 1])


@inline
def body_count(system: ConstraintSystem) -> int:
    """Return n; ends numbered n and above are planes and walls."""
    return len(system.bodies) - len(system.surface)


@inline
def ends_of(pairs: IntArray, c: int) -> tuple[int, int]:
    """Return the bodies, or the body and the plane, that a contact joins."""
    return from_front(pairs[c, 0]), from_front(pairs[c, 1])
