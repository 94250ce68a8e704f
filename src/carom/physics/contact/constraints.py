"""The contact constraints of a step as records, and the other arrays of the solver's kernels.

Records fill whole cache lines: fields used by the iterations are in other lines than fields used only by the phases
before and after them.
"""

from __future__ import annotations

from typing import NamedTuple, Protocol

from carom.arrays import BoolArray, FloatArray, IntArray, RecordArray, dtype_of
from carom.physics.aligned import CACHE_LINE
from carom.physics.contact.guided_walls import Guide
from carom.physics.contact.loads import LoadRecord
from carom.physics.contact.moving_walls import SurfaceVelocity
from carom.physics.contact.rolling import AngularImpulse, ContactGeometry, RollingFields
from carom.physics.diagnostics.ledger import LedgerRecord
from carom.physics.jit.decorators import inline
from carom.physics.jit.instructions import from_front
from carom.physics.sheared_box import ImageVelocity
from carom.scene.schema import Coefficients

# Overlap, relative to the sum of radii, that needs no further position correction: of contacts whose impulses converge
# to rounding, and of those whose iterations end with small changes. The remainder is pushed in the next step.
ENOUGH = 1e-9
ENOUGH_AS_NEEDED = 1e-5

BODIES_PER_BLOCK = 1024
CONTACTS_PER_BLOCK = 1024
SHARED_FROM = 2048  # contacts; with fewer, threads cost as much time as they save
# Contacts or bodies per task. Either all phases are shared or none, since sharing moves records between the caches of
# cores.
MIN_PER_TASK = SHARED_FROM // 2


class ContactRecord(ContactGeometry, Protocol):
    """The fields of a contact that the iterations use."""

    normal_mass: float  # kg, effective masses of normal and tangential impulses
    tangent_mass: float
    velocity_bias: float  # m/s, c: the contact may close at up to c; it has to separate if c is negative
    normal_impulse: float  # N s, λ_n and λ_t
    friction_x: float
    friction_y: float
    friction_z: float
    delta_normal: float  # N s, s: their change in the last iteration
    delta_x: float
    delta_y: float
    delta_z: float


class RollingContactRecord(RollingFields, ContactRecord, Protocol):
    """A contact whose law resists rolling."""


class TurningNormal(Protocol):
    """Fields of contacts in a scene with walls that may curve, and with friction."""

    turn_x: float  # m/s, q at a wall before a drift, see `body_state.half_turn`
    turn_y: float
    turn_z: float


class WallContactRecord(TurningNormal, ContactRecord, Protocol):
    """A contact in a scene with walls."""


class RollingWallContactRecord(TurningNormal, RollingContactRecord, Protocol):
    """A contact in a scene with walls, whose law resists rolling."""


class SlidingWallContactRecord(SurfaceVelocity, WallContactRecord, Protocol):
    """A contact in a scene with rotating walls."""


class RollingSlidingWallContactRecord(SurfaceVelocity, RollingWallContactRecord, Protocol):
    """A contact in a scene with rotating walls, whose law resists rolling."""


class ImageContactRecord(ImageVelocity, ContactRecord, Protocol):
    """A contact in a sheared box."""


class RollingImageContactRecord(ImageVelocity, RollingContactRecord, Protocol):
    """A contact in a sheared box, whose law resists rolling."""


class ContactStateRecord(Protocol):
    """The fields of a contact that only the phases before and after the iterations use."""

    overlap: float  # m, at present; negative for a gap
    detected_overlap: float  # m, before the position correction; 0 for a gap
    rest_speed: float  # m/s, largest approach speed of a contact at rest
    approach_speed: float  # m/s, before the impulses
    normal_before: float  # m/s, v_n and u before `hold`
    slip_x: float
    slip_y: float
    slip_z: float
    restitution_loss: float  # J, its ledger, as in `LedgerRecord`
    friction_loss: float
    stabilisation_gain: float
    push_x: float  # m, Σ δ n of the position corrections
    push_y: float
    push_z: float
    push_fraction: float  # of the overlap, removed by one position correction
    apart: bool  # whether the contact was detected with a gap
    biased: bool  # whether Baumgarte's bias makes it separate
    slides: bool  # whether it slid in the last iterations and may not stick again


class BodyStateRecord(Protocol):
    """The velocities of a body, and their changes in the last iteration."""

    vx: float  # m/s
    vy: float
    vz: float
    wx: float  # rad/s
    wy: float
    wz: float
    inverse_mass: float  # 1/kg
    inverse_inertia: float  # 1/(kg m²)
    dvx: float  # m/s, the changes
    dvy: float
    dvz: float
    dwx: float  # rad/s
    dwy: float
    dwz: float
    mass: float  # kg; 0 if fixed
    inertia: float  # kg m²; 0 if fixed


class GuidedBodyRecord(Guide, BodyStateRecord, Protocol):
    """A body in a scene with a guided wall."""


class PushedBodyRecord(Protocol):
    """A body during the position correction."""

    x: float  # m
    y: float
    z: float
    radius: float  # m
    vx: float  # m/s
    vy: float
    vz: float
    inverse_mass: float  # 1/kg


class SearchRecord(Protocol):
    """A contact in conjugate gradients."""

    step_normal: float  # N s, s: the change of the impulses
    step_x: float
    step_y: float
    step_z: float
    direction_normal: float  # N s, d
    direction_x: float
    direction_y: float
    direction_z: float
    residual_normal: float  # m/s, r
    residual_x: float
    residual_y: float
    residual_z: float
    velocity_bias: float  # m/s, c, see `bias_along_arc`
    free_normal: bool  # whether λ_n and λ_t are free to change
    free_tangent: bool


class ImpulseRecord(Protocol):
    """Impulses of a contact that is recorded."""

    normal_impulse: float  # N s, Σ of the impulses by `solver.impacts`
    friction_x: float
    friction_y: float
    friction_z: float
    correction_x: float  # N s, Σ of the changes of momentum by `solver.positions`
    correction_y: float
    correction_z: float


class RollingImpulseRecord(AngularImpulse, ImpulseRecord, Protocol):
    """Recorded impulses of a contact whose law resists rolling."""


class PieceResultsRecord(Protocol):
    """Results of a phase for one piece of contacts."""

    residual: float  # m/s, the largest change or violation; for position corrections, 1 if another iteration is needed
    residual_norm: float  # r·z, of conjugate gradients
    exact_norm: float  # the same of contacts that are to converge to rounding
    largest_push: float  # N s, the largest impulses of either sign
    largest_pull: float
    slope: float  # J, s·c of the line search
    step_limit: float  # largest α of the line search at which no impulse is attractive
    fastest: float  # m/s, the fastest approach
    restitution_loss: float  # J, the ledger of the piece
    friction_loss: float
    stabilisation_gain: float
    any_rests: bool  # whether a contact is at rest
    is_exact: bool  # whether conjugate gradients go on here when they leave meshed islands


class BlockSumsRecord(Protocol):
    """Sums of the line search over a block of bodies."""

    slope: float  # J, along the impulses
    curvature: float


class MeasuredRecord(LedgerRecord, BlockSumsRecord, Protocol):
    """A contact whose island may have to return energy, and its ledger before the audit."""


class IslandRecord(BlockSumsRecord, Protocol):
    """An island that may have to return energy."""

    scale: float  # factor on its impulses


class SettingsRecord(Protocol):
    """Settings of the phases, and values that they share."""

    independent: int  # number of leading colours whose contacts share no moving body
    iteration: int  # number of iterations before this one
    dt: float  # s, the step for which the rest speeds were found; before a drift, the previous one
    drift: float  # s, the coming drift; 0 after the last kick
    booked: float  # s, the part of the drift for which the work of the forces is already booked
    bias_rate: float  # 1/s, Baumgarte's separation speed per overlap
    alpha: float  # α, of the line search and of conjugate gradients
    beta: float  # β of conjugate gradients, weight of the last direction in the next one
    negligible: float  # m/s, slower approaches are no violation
    tolerance: float  # in multiples of `tolerated`
    fastest: float  # m/s, the fastest approach before the impulses of impacts
    any_rests: bool  # whether a contact was at rest before them
    spins: bool  # whether impulses exert torques
    impacts_only: bool  # whether resting contacts are skipped
    solved: float  # of r·z at the start of a round of conjugate gradients, at which its iterations end
    meshed_iterations: int  # of a round of conjugate gradients, after which it leaves meshed islands; 0 for no limit
    refines: bool  # whether conjugate gradients follow the iterations
    keeps_iterating: bool  # whether iterations follow conjugate gradients that did not converge
    spares_meshed: bool  # whether these iterations ignore the contacts of meshed islands
    ignores_meshed: bool  # whether they do so now
    slides_meshed: bool  # whether contacts of meshed islands that have slid keep sliding in all iterations
    is_lenient: bool  # whether contacts of meshed islands may close by their rest speed
    slides_above: float  # contacts with a larger `enough` that have slid since the kick keep sliding
    islands_known: bool  # whether the bodies' islands are found
    measures: bool  # whether the audit writes `MEASURED`
    scaled_back: bool  # whether impulses were too large for the energy bound


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
) = range(13)  # phases


class ConstraintSystem(NamedTuple):
    """m contacts in the order in which they are resolved, and the n bodies and p planes at their ends."""

    pairs: IntArray  # (m, 2)
    pieces: IntArray  # (k, 2) first contact of each, and the end of its range
    edges: IntArray  # (s + 1,) first piece of each colour, and k
    contacts: RecordArray[ContactRecord]  # (m,), or ROLLING_CONTACT if the law resists rolling
    held: BoolArray  # (m,) whether each contact is held; impacts and open gaps are not
    enough: FloatArray  # (m,) `ENOUGH`, or `ENOUGH_AS_NEEDED` where small changes end the iterations
    small_change: FloatArray  # (m,) m/s, a smaller change of a contact's velocities needs no further iteration
    states: RecordArray[ContactStateRecord]  # (m,)
    load_speed: FloatArray  # (m,) m/s, which the largest acceleration of its island causes in a step; see `islands`
    search: RecordArray[SearchRecord]  # (m,)
    measured: RecordArray[MeasuredRecord]  # (m,)
    recorded: RecordArray[ImpulseRecord]  # (m,), or ROLLING_RECORDED; no rows unless contacts are recorded
    velocity: FloatArray  # (n + p, 3) m/s
    spin: FloatArray  # (n + p, 3) rad/s; no rows without friction
    acceleration: FloatArray  # (n + p, 3) m/s²
    inverse_mass: FloatArray  # (n + p,) 1/kg
    box: FloatArray  # (3,) m, zeros in open space; or the record of a sheared box
    position: FloatArray  # (n, 3) m
    surface: FloatArray  # (p, 3) normals of the planes, or records of planes and walls: see `solids`
    offset: FloatArray  # (p,) m
    bodies: RecordArray[BodyStateRecord]  # (n + p,)
    pushed: RecordArray[PushedBodyRecord]  # (n + p,)
    pushed_in: IntArray  # (n + p,) iteration in which the position correction last moved each; `NEVER` if none did
    materials: RecordArray[Coefficients]  # (k,) MATERIAL, by `law.material_index`
    places: IntArray  # (n + p, 2) for `law.material_index`; no rows where all bodies have one material
    island: IntArray  # (n + p,) workspace, the root of each body's island
    islands: RecordArray[IslandRecord]  # (n + p,) workspace
    active: IntArray  # (b,) bodies and planes with a contact
    # (n + p,) whether contacts have pressed each body since the last step; False for fixed ends
    pressed: BoolArray
    loads: RecordArray[LoadRecord]  # (n + p,) `LOAD`, of the last kick; 0 for fixed ends
    piece_results: RecordArray[PieceResultsRecord]  # (k,)
    sums: RecordArray[BlockSumsRecord]  # (b / BODIES_PER_BLOCK,)
    settings: RecordArray[SettingsRecord]  # (1,)


@inline
def contacts_of(first: int, end: int, system: ConstraintSystem) -> tuple[int, int]:
    """Return the first contact of the pieces [first, end), and the end of their range."""
    return from_front(system.pieces[first, 0]), from_front(system.pieces[end - 1, 1])


@inline
def body_count(system: ConstraintSystem) -> int:
    """Return n; ends from n on are planes and walls."""
    return len(system.bodies) - len(system.surface)


@inline
def ends_of(pairs: IntArray, c: int) -> tuple[int, int]:
    """Return the bodies, or the body and the plane, that a contact joins."""
    return from_front(pairs[c, 0]), from_front(pairs[c, 1])
