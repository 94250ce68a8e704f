"""The contact constraints of a step as records, and the other arrays of the solver's kernels.

`CONTACT` has the fields that iterations need, in two cache lines, and `ROLLING_CONTACT` those of a law that resists
rolling in two more; `CONTACT_STATE` has those that only the phases before
and after need. `BODY_STATE` has the velocities of a body, in two cache lines, and `PUSHED_BODY` its position and
velocity, in one.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from carom.arrays import BoolArray, FloatArray, IntArray, Records
from carom.physics.aligned import CACHE_LINE, record
from carom.physics.contact.rolling import ANGULAR_IMPULSE, FIELDS
from carom.physics.diagnostics.ledger import TERMS
from carom.physics.jit.decorators import inline
from carom.physics.jit.instructions import from_front

BODIES_PER_BLOCK = 1024
CONTACTS_PER_BLOCK = 1024
SHARED_FROM = 2048  # contacts; with fewer, sharing them takes as long as it saves
# contacts or bodies: all phases are shared or none, since sharing moves records from one core's cache to the other's
MIN_PER_TASK = SHARED_FROM // 2
LEDGER_TERMS = " ".join(TERMS)

_CONTACT = (
    "nx ny nz arm_i arm_j"  # normal from i to j; m, from each centre to the contact point
    " normal_mass tangent_mass"  # kg, effective masses of normal and tangential impulses
    " velocity_bias"  # m/s, c: the contact may close at up to c; it has to separate if c is negative
    " normal_impulse friction_x friction_y friction_z"  # N s, λ_n and λ_t
    " delta_normal delta_x delta_y delta_z"  # N s, s: their change in the last iteration
)
CONTACT = record(_CONTACT, size=2 * CACHE_LINE)
ROLLING_CONTACT = record(" ".join((_CONTACT, *FIELDS)), size=4 * CACHE_LINE)  # where the law resists rolling

CONTACT_STATE = record(
    "overlap detected_overlap"  # m: now (negative for a gap); before the position correction (0 for a gap)
    " rest_speed approach_speed"  # m/s, largest approach speed at rest; approach before the impulses
    " normal_before slip_x slip_y slip_z"  # m/s, v_n and u before `hold`
    f" {LEDGER_TERMS}"  # J, its ledger
    " push_x push_y push_z push_fraction",  # m, Σ δ n of the position corrections; part of the overlap that one removes
    flags="apart biased"  # whether it was found with a gap; whether Baumgarte's bias makes it separate
    " slides",  # whether it slid in the last iterations and may not stick again
    size=2 * CACHE_LINE,
)

BODY_STATE = record(
    "vx vy vz wx wy wz inverse_mass inverse_inertia"  # m/s, rad/s, 1/kg, 1/(kg m²)
    " dvx dvy dvz dwx dwy dwz"  # their change in the last iteration
    " mass inertia",  # kg, kg m²; 0 if fixed
    size=2 * CACHE_LINE,
)

PUSHED_BODY = record(  # during the position correction
    "x y z radius vx vy vz inverse_mass",  # m, m/s, 1/kg
    size=CACHE_LINE,
)

SEARCH = record(  # of the conjugate gradients
    "step_normal step_x step_y step_z"  # N s, s: the change of the impulses
    " direction_normal direction_x direction_y direction_z"  # N s, d
    " residual_normal residual_x residual_y residual_z"  # m/s, r
    " velocity_bias",  # m/s, c, see `bias_along_arc`
    flags="free_normal free_tangent",  # whether λ_n and λ_t are free to change
    size=2 * CACHE_LINE,
)

_RECORDED = (  # only for recorded contacts
    "normal_impulse friction_x friction_y friction_z"  # N s, Σ of the impulses by `solver.impacts`
    " correction_x correction_y correction_z"  # N s, Σ of the changes of momentum by `solver.positions`
)
RECORDED = record(_RECORDED, size=CACHE_LINE)
ROLLING_RECORDED = record(" ".join((_RECORDED, *ANGULAR_IMPULSE)), size=2 * CACHE_LINE)

PIECE_RESULTS = record(  # results of a phase for a piece of contacts
    "residual"  # m/s, the largest change or violation; of position corrections 1 if another iteration is needed
    " residual_norm largest_push largest_pull"  # of conjugate gradients: r·z; N s, the largest impulses of either sign
    " slope step_limit"  # of the line search: J, s·c; the largest α that lets no contact pull
    " fastest"  # m/s, the fastest approach
    f" {LEDGER_TERMS}",  # J
    flags="any_rests",  # whether a contact is at rest
    size=2 * CACHE_LINE,
)

MEASURED = record(  # of a contact whose island may have to give back energy
    "slope curvature"  # J, along its impulses
    f" {LEDGER_TERMS}"  # J, its ledger before the audit
)

BLOCK_SUMS = record("slope curvature")  # J, of the line search, over a block of bodies
ISLAND = record("slope curvature scale")  # J, along the impulses of an island; factor of these impulses

SETTINGS = np.dtype(
    [
        ("independent", "i8"),  # number of colours, from the first on, whose contacts share no moving body
        ("iteration", "i8"),  # number of iterations before this one
        ("dt", "f8"),  # s, the step for which the rest speeds were found; before a drift, the previous one
        ("drift", "f8"),  # s, the drift to come; 0 after the last kick
        ("booked", "f8"),  # s, part of the drift for which the work of the forces is already booked
        ("bias_rate", "f8"),  # 1/s, Baumgarte: separation speed for each metre of overlap
        ("alpha", "f8"),  # α, of the line search and of conjugate gradients
        ("beta", "f8"),  # β of conjugate gradients, weight of the last direction in the next one
        ("negligible", "f8"),  # m/s, slower approaches are no violation
        ("tolerance", "f8"),  # in multiples of `tolerated`
        ("fastest", "f8"),  # m/s, the fastest approach before the impulses of impacts
        ("any_rests", "?"),  # whether a contact was at rest then
        ("spins", "?"),  # whether impulses turn bodies
        ("impacts_only", "?"),  # whether resting contacts are skipped
        ("refines", "?"),  # whether conjugate gradients follow the iterations
        ("as_needed", "?"),  # whether small changes and small overlaps end the iterations
        ("keeps_iterating", "?"),  # whether more iterations follow conjugate gradients that did not converge
        ("keeps_sliding", "?"),  # whether contacts that slid may not stick again
        ("islands_known", "?"),  # whether the bodies' islands are found
        ("measures", "?"),  # whether the audit writes `MEASURED`
        ("scaled_back", "?"),  # whether impulses were too large for the energy bound
    ],
    align=True,
)

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
    pieces: IntArray  # (k, 2) first contact, and the one after the last
    edges: IntArray  # (s + 1,) first piece of each colour, and k
    contacts: Records  # (m,) CONTACT, or ROLLING_CONTACT if the law resists rolling
    held: BoolArray  # (m,) whether each contact is held; impacts and open gaps are not
    small_change: FloatArray  # (m,) m/s, a smaller change of a contact's velocities needs no further iteration
    states: Records  # (m,) CONTACT_STATE
    search: Records  # (m,) SEARCH
    measured: Records  # (m,) MEASURED
    recorded: Records  # (m,) RECORDED, or ROLLING_RECORDED; no rows unless contacts are recorded
    velocity: FloatArray  # (n + p, 3) m/s
    spin: FloatArray  # (n + p, 3) rad/s; no rows without friction
    acceleration: FloatArray  # (n + p, 3) m/s²
    inverse_mass: FloatArray  # (n + p,) 1/kg
    box: FloatArray  # (3,) m, zeros in open space
    surface: FloatArray  # (p, 3) normals of the planes
    offset: FloatArray  # (p,) m
    bodies: Records  # (n + p,) BODY_STATE
    pushed: Records  # (n + p,) PUSHED_BODY
    pushed_in: IntArray  # (n + p,) iteration in which the position correction last pushed each; `NEVER` if none did
    materials: Records  # (k,) MATERIAL, coefficients by `law.material_index`
    places: IntArray  # (n + p, 2) for `law.material_index`; no rows where all bodies have one material
    island: IntArray  # (n + p,) workspace, the root of each one's island
    islands: Records  # (n + p,) ISLAND, workspace
    active: IntArray  # (b,) bodies and planes with a contact
    pressed: BoolArray  # (n + p,) whether contacts have pressed each since the last step; False for fixed ends
    piece_results: Records  # (k,) PIECE_RESULTS
    sums: Records  # (b / BODIES_PER_BLOCK,) BLOCK_SUMS
    settings: Records  # (1,) SETTINGS


@inline
def contacts_of(first: int, end: int, system: ConstraintSystem) -> tuple[int, int]:
    """Return the first contact of the pieces [first, end), and the one after the last."""
    return from_front(system.pieces[first, 0]), from_front(system.pieces[end - 1, 1])


@inline
def body_count(system: ConstraintSystem) -> int:
    """Return n; ends from n on are planes."""
    return len(system.bodies) - len(system.surface)


@inline
def ends_of(pairs: IntArray, c: int) -> tuple[int, int]:
    """Return the bodies, or the body and the plane, that a contact joins."""
    return from_front(pairs[c, 0]), from_front(pairs[c, 1])
