"""The fields of the records of contacts, impacts and bodies; `constraints` lays most of them out in memory.

Optional parts add fields: a law that resists rolling, walls, moving walls, guided walls, and a sheared box. This module
imports no other module of contacts, so each part can name the fields that it needs.
"""

from __future__ import annotations

from typing import Protocol

from carom.physics.diagnostics.ledger import LedgerRecord


class ContactGeometry(Protocol):
    """The geometry of a contact or an impact."""

    nx: float  # components of the normal from i to j
    ny: float
    nz: float
    arm_i: float  # m, distance from each centre to the contact point
    arm_j: float


class AngularImpulse(Protocol):
    """Fields of records whose law resists rolling or twisting."""

    angular_x: float  # N m s, Λ
    angular_y: float
    angular_z: float


class RollingFields(AngularImpulse, Protocol):
    """Further fields of a contact whose law resists rolling or twisting."""

    change_x: float  # N m s, change of Λ in the last iteration
    change_y: float
    change_z: float
    spin_x: float  # rad/s, Ω before `hold`
    spin_y: float
    spin_z: float


class ContactRecord(ContactGeometry, Protocol):
    """The fields of a contact that the iterations use."""

    normal_mass: float  # kg, effective masses for normal and tangential impulses
    tangent_mass: float
    velocity_bias: float  # m/s, c: largest speed at which the contact may close; if negative, it must separate
    normal_impulse: float  # N s, components λ_n and λ_t of the impulse
    friction_x: float
    friction_y: float
    friction_z: float
    delta_normal: float  # N s, s: changes of λ_n and λ_t in the last iteration
    delta_x: float
    delta_y: float
    delta_z: float


class RollingContactRecord(RollingFields, ContactRecord, Protocol):
    """A contact whose law resists rolling."""


class TurningNormal(Protocol):
    """Fields of contacts in a scene with walls that may curve, and with friction."""

    turn_x: float  # m/s, q at a wall before a drift; see `body_state.half_turn`
    turn_y: float
    turn_z: float


class WallContactRecord(TurningNormal, ContactRecord, Protocol):
    """A contact in a scene with walls."""


class RollingWallContactRecord(TurningNormal, RollingContactRecord, Protocol):
    """A contact in a scene with walls, whose law resists rolling."""


class SurfaceVelocity(Protocol):
    """Fields of contacts in a scene with moving walls."""

    surface_x: float  # m/s, velocity s of the wall's surface; 0 between bodies
    surface_y: float
    surface_z: float


class SlidingWallContactRecord(SurfaceVelocity, WallContactRecord, Protocol):
    """A contact in a scene with rotating walls."""


class RollingSlidingWallContactRecord(SurfaceVelocity, RollingWallContactRecord, Protocol):
    """A contact in a scene with rotating walls, whose law resists rolling."""


class ImageVelocity(Protocol):
    """Fields of lasting contacts in a sheared box."""

    image_x: float  # m/s, w: velocity, relative to j, of the image of j that touches i
    image_y: float
    image_z: float


class ImageContactRecord(ImageVelocity, ContactRecord, Protocol):
    """A contact in a sheared box."""


class RollingImageContactRecord(ImageVelocity, RollingContactRecord, Protocol):
    """A contact in a sheared box, whose law resists rolling."""


class ContactStateRecord(Protocol):
    """The fields of a contact that only the phases before and after the iterations use."""

    overlap: float  # m, present overlap; negative for a gap
    detected_overlap: float  # m, overlap before the position correction; 0 for a gap
    rest_speed: float  # m/s, largest approach speed of a contact at rest
    approach_speed: float  # m/s, closing speed before the impulses
    normal_before: float  # m/s, normal velocity v_n before `hold`
    slip_x: float  # m/s, slip before `hold`; before a drift, the slip before the kick
    slip_y: float
    slip_z: float
    restitution_loss: float  # J, energies that the contact lost, as in `LedgerRecord`
    friction_loss: float
    stabilisation_gain: float
    push_x: float  # m, Σ (δ n - h σ v_t) over the position corrections; see `solver.positions`
    push_y: float
    push_z: float
    push_fraction: float  # fraction of the overlap that one position correction removes
    apart: bool  # whether the contact was detected as a gap
    biased: bool  # whether Baumgarte's bias makes the contact separate
    slides: bool  # whether the contact slid in the last iterations and may not stick again


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
    dvx: float  # m/s, changes of the velocities
    dvy: float
    dvz: float
    dwx: float  # rad/s
    dwy: float
    dwz: float
    mass: float  # kg; 0 if fixed
    inertia: float  # kg m², moment of inertia; 0 if fixed


class Guide(Protocol):
    """Fields of bodies in a scene with a guided wall."""

    axis_x: float  # axis along which a wall moves; 0 for bodies, which move freely
    axis_y: float
    axis_z: float


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


class LoadRecord(Protocol):
    """The impulses of contacts on a body in the last kick, divided by its mass and the length of the kick."""

    x: float  # m/s², acceleration Σ J/(m h) by the body's contacts
    y: float
    z: float
    xx: float  # m/s², symmetric load Σ λ n nᵀ/(m h)
    yy: float
    zz: float
    xy: float
    xz: float
    yz: float


class SearchRecord(Protocol):
    """A contact in conjugate gradients."""

    step_normal: float  # N s, s: change of the impulses so far
    step_x: float
    step_y: float
    step_z: float
    direction_normal: float  # N s, d: direction of the search
    direction_x: float
    direction_y: float
    direction_z: float
    residual_normal: float  # m/s, r: residual
    residual_x: float
    residual_y: float
    residual_z: float
    velocity_bias: float  # m/s, c, see `bias_along_arc`
    free_normal: bool  # whether λ_n and λ_t are free to change
    free_tangent: bool


class HasImpulse(Protocol):
    """A record with an impulse in N s."""

    normal_impulse: float
    friction_x: float
    friction_y: float
    friction_z: float


class ImpulseRecord(Protocol):
    """Impulses of a contact that is recorded."""

    normal_impulse: float  # N s, sum of the impulses by `solver.impacts`
    friction_x: float
    friction_y: float
    friction_z: float
    correction_x: float  # N s, sum of the changes of momentum by `solver.positions`
    correction_y: float
    correction_z: float


class RollingImpulseRecord(AngularImpulse, ImpulseRecord, Protocol):
    """Recorded impulses of a contact whose law resists rolling."""


class PieceResultsRecord(Protocol):
    """Results of a phase for one piece of contacts."""

    residual: float  # m/s, largest change or violation; for position corrections, 1 if another iteration is needed
    residual_norm: float  # r·z of conjugate gradients
    exact_norm: float  # r·z over the contacts that are to converge to rounding
    largest_push: float  # N s, largest impulses of either sign
    largest_pull: float
    slope: float  # J, s·c for the line search
    step_limit: float  # largest α in the line search at which no impulse is attractive
    fastest: float  # m/s, the fastest approach
    restitution_loss: float  # J, energies that the contacts of the piece lost
    friction_loss: float
    stabilisation_gain: float
    any_rests: bool  # whether any contact is at rest
    is_exact: bool  # whether conjugate gradients continue in this piece when they leave meshed islands


class BlockSumsRecord(Protocol):
    """Sums of the line search over a block of bodies."""

    slope: float  # J, slope along the change of the impulses
    curvature: float


class MeasuredRecord(LedgerRecord, BlockSumsRecord, Protocol):
    """A contact whose impulses may be scaled back, and the contact's losses before the audit."""


class IslandRecord(BlockSumsRecord, Protocol):
    """An island whose impulses may be scaled back."""

    scale: float  # factor on its impulses


class SettingsRecord(Protocol):
    """Settings of the phases, and values that they share."""

    independent: int  # number of leading colours whose contacts share no moving body
    iteration: int  # number of iterations before the present one
    dt: float  # s, step for which the rest speeds were found; before a drift, the previous step
    drift: float  # s, length of the coming drift; 0 after the last kick
    booked: float  # s, the part of the drift for which the work of the forces is already booked
    bias_rate: float  # 1/s, Baumgarte's separation speed per overlap
    next_kick: float  # s, h: length of the kick after the position correction
    alpha: float  # α of the line search and of conjugate gradients
    beta: float  # β of conjugate gradients, the weight of the last direction in the next direction
    negligible: float  # m/s; a slower approach is not a violation
    tolerance: float  # residual at which iterations end, in multiples of `tolerated`
    fastest: float  # m/s, fastest approach before the impulses of impacts
    any_rests: bool  # whether any contact was at rest before the impulses of impacts
    spins: bool  # whether impulses exert torques
    impacts_only: bool  # whether resting contacts are skipped
    solved: float  # a round of conjugate gradients ends when r·z falls to this fraction of its first value
    meshed_iterations: int  # limit on iterations of conjugate gradients in a round with meshed islands; 0 for no limit
    refines: bool  # whether conjugate gradients follow the iterations
    keeps_iterating: bool  # whether iterations follow conjugate gradients that did not converge
    spares_meshed: bool  # whether iterations after conjugate gradients ignore contacts of meshed islands
    ignores_meshed: bool  # whether contacts of meshed islands are ignored now
    slides_meshed: bool  # whether contacts of meshed islands that have slid keep sliding in all iterations
    is_lenient: bool  # whether contacts of meshed islands may close at up to their load speed
    slides_above: float  # contacts with a larger `enough` that have slid since the kick keep sliding
    islands_known: bool  # whether the bodies' islands are found
    measures: bool  # whether the audit writes `MEASURED`
    scaled_back: bool  # whether impulses were too large for the energy bound, and were scaled back


class ImpactRecord(ContactGeometry, LedgerRecord, Protocol):
    """An impact at its exact time."""

    i: int  # i < j
    j: int
    time: float  # time of the impact, s from the beginning of the drift
    clock: float  # s, clock σ of the straight paths; see `events.trajectories`
    approach: float  # m/s, closing speed
    rest_speed: float  # m/s, closing speed up to which a contact is at rest
    vix: float  # m/s, velocities of both ends right after the impact
    viy: float
    viz: float
    vjx: float
    vjy: float
    vjz: float
    normal_impulse: float  # N s
    friction_x: float  # N s, tangential impulse that acts on j
    friction_y: float
    friction_z: float
    x: float  # m, the contact point
    y: float
    z: float


class RollingImpactRecord(AngularImpulse, ImpactRecord, Protocol):
    """An impact whose law resists rolling or twisting."""
