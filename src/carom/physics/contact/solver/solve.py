"""Projected Gauss-Seidel: the impulses of resting contacts.

A resting contact exerts a force, so its impulses belong to both kicks of a step, as for any other force. After
each kick of length h, iterations over the contacts find the impulses λ of all contacts such that

    v_n + c ≥ 0,   λ_n ≥ 0,   λ_n (v_n + c) = 0                                    (Signorini)
    |λ_t| ≤ μ_s λ_n where the contact sticks, λ_t = -μ_k λ_n u/|u| where it slides      (Coulomb)

(Moreau 1988; Jean 1999; Catto 2005 calls them sequential impulses). The *totals* are clamped, not the increments, so
later iterations can reduce impulses that earlier iterations made too large. The totals start from the totals of the
previous kick, scaled by the ratio of the kicks' lengths (`warm_start`), so a pile at rest needs one iteration. A line
search follows each iteration (`line_search`).

After the last kick, touching contacts must not close (c = 0; c < 0 with Baumgarte's bias), and an open contact may
close its gap in the next step (c = gap/dt). After the first kick, bodies may close by c dt, so that they touch at the
end of the drift: |d n + v dt| ≥ r_i + r_j. With v_t the tangential velocity of the centres,

    c dt = gap + R - √(R² - v_t² dt²),   R = r_i + r_j

Without the square root, two spheres that roll about each other would separate along the tangent, and lose their contact
in every other step. The scheme is RATTLE (Andersen 1983) for contacts. Friction ends u - q, the slip in the middle of
the drift (`half_turn`): as the normal turns, a body that spins about the normal begins to slip. The direction of
sliding friction is that of the slip between two steps (`friction`).

Contacts of a colour are solved eight at a time (`solve_block`), with the same bits as if solved one by one. Both forms
call the same formulas, and call the law for each contact separately, so a law needs only one form.

Impacts have been resolved before, one by one, with restitution (`impacts`). A step without resting contacts skips this
phase.

Rejected: the reference engine's stages with restitution 0 (a pile of 1000 keeps jittering at the rest speed); impulses
only at the end of the step (a body falls a dt²/2 into the ground in every step and has to be pushed back).
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce
from typing import Any

import numpy as np

from carom.physics.contact.constraints import (
    BODY_STATE,
    CONTACT,
    CONTACT_OF_IMAGE,
    CONTACT_ON_MOVING_WALL,
    CONTACT_ON_WALL,
    ROLLING_CONTACT,
    ROLLING_CONTACT_OF_IMAGE,
    ROLLING_ON_MOVING_WALL,
    ROLLING_ON_WALL,
    ConstraintSystem,
    body_count,
    ends_of,
)
from carom.physics.contact.guided_walls import is_guided
from carom.physics.contact.law import exerts_torque, material_index
from carom.physics.contact.moving_walls import along_surface_velocity, slope_on_wall
from carom.physics.contact.records import BodyStateRecord, ContactRecord
from carom.physics.contact.rolling import (
    accumulate_angular_impulse,
    angular_impulse,
    apply_angular_impulse,
    change_of_angular_impulse,
    limited,
    relative_spin,
    set_angular_impulse,
    set_change_of_angular_impulse,
)
from carom.physics.contact.solver.block import CHANGE, VELOCITY, Block, whole_blocks
from carom.physics.contact.solver.body_state import (
    accumulate_push,
    accumulate_turn,
    bias_along_arc,
    bias_of,
    half_turn,
    half_turn_of,
    prefetch_records,
    push,
    relative_velocity,
    slip,
    torque_of,
    turn,
)
from carom.physics.contact.solver.friction import against_first_slip, friction
from carom.physics.jit.decorators import inline, inner
from carom.physics.jit.instructions import Code, instruction
from carom.physics.jit.vectors import (
    DOUBLE,
    WIDTH,
    Lanes,
    RecordLanes,
    added_in_order,
    either,
    greater,
    in_lanes,
    read_doubles,
    spread,
)
from carom.physics.sheared_box import along_image, slope_of_image
from carom.scene.schema import Coefficients

# iterations end when changes are below this fraction of the largest velocity that a contact removes
HOLD_CONVERGED = 1e-8
InLanes = Sequence[Lanes]
KINDS = (
    *(CONTACT, CONTACT_ON_WALL, CONTACT_ON_MOVING_WALL, CONTACT_OF_IMAGE),
    *(ROLLING_CONTACT, ROLLING_ON_WALL, ROLLING_ON_MOVING_WALL, ROLLING_CONTACT_OF_IMAGE),
)


@inner
def solve_turning(first: int, end: int, system: ConstraintSystem) -> None:
    """Solve the contacts in some pieces once, with friction and spin."""
    for piece in range(first, end):
        solve(piece, system, (1,))


@inner
def solve_straight(first: int, end: int, system: ConstraintSystem) -> None:
    """Solve the contacts in some pieces once, without friction."""
    for piece in range(first, end):
        solve(piece, system, ())


@inner
def solve(piece: int, system: ConstraintSystem, turning: tuple[()] | tuple[int]) -> None:
    """Solve the contacts of a piece once, each with the velocities that result from the previous contacts.

    Contacts of a colour that share no moving body are solved in blocks (`solve_block`), the remaining contacts one by
    one.

    Parameters
    ----------
    turning
        One element if impulses exert torques, otherwise empty. Its type makes Numba compile a kernel for each case.
    """
    lo, hi = system.pieces[piece, 0], system.pieces[piece, 1]  # with `contacts_of`, blocks would take 3 % longer
    blocks = 0 if is_guided(system.bodies[0]) else whole_blocks(piece, system)
    totals = 0.0, np.inf, 0.0
    for block in range(blocks):
        totals = solve_block(system, lo + block * WIDTH, totals, turning)
    totals = _solve_each(lo + blocks * WIDTH, hi, totals, system, turning)
    results = system.piece_results[piece]
    results.residual, results.step_limit, results.slope = totals


@inline
def _solve_each(
    lo: int, hi: int, totals: tuple[float, float, float], system: ConstraintSystem, turning: tuple[()] | tuple[int]
) -> tuple[float, float, float]:
    """Solve the contacts [lo, hi) one by one; return the largest change, the limit of the step, and the slope.

    ``totals`` are these three values for the previous contacts.
    """
    pairs, bodies = system.pairs, system.bodies
    settings = system.settings[0]
    spins, alpha, drift, slides_above = len(turning) > 0, settings.alpha, settings.drift, settings.slides_above
    count, places = body_count(system), system.places
    change, step_limit, slope = totals
    for c in range(lo, hi):
        prefetch_records(bodies, pairs, c)
        if not system.held[c]:
            continue
        i, j = ends_of(pairs, c)
        contact, state, body_i, body_j = system.contacts[c], system.states[c], bodies[i], bodies[j]
        vn, ux, uy, uz = relative_velocity(contact, body_i, body_j)
        bias = bias_of(contact, j < count, ux, uy, uz, drift)
        old = contact.normal_impulse + alpha * contact.delta_normal
        normal = max(0.0, old - (vn + bias) * contact.normal_mass)  # clamps the total, not the increment
        more = normal - old
        contact.normal_impulse, contact.delta_normal = normal, more
        largest = abs(more)
        slope += more * bias
        if more < 0.0:
            step_limit = min(step_limit, -normal / more)
        Jx, Jy, Jz = more * contact.nx, more * contact.ny, more * contact.nz
        if spins:
            qx, qy, qz = half_turn_of(contact, body_i, body_j, j < count, ux, uy, uz, drift)
            ux, uy, uz = slip(contact, body_i, body_j, ux, uy, uz)
            ux, uy, uz = ux - qx, uy - qy, uz - qz
            mt = contact.tangent_mass
            ox = contact.friction_x + alpha * contact.delta_x
            oy = contact.friction_y + alpha * contact.delta_y
            oz = contact.friction_z + alpha * contact.delta_z
            tx, ty, tz = ox - ux * mt, oy - uy * mt, oz - uz * mt
            material = system.materials[material_index(i, j, count, places)]
            keeps_sliding = system.enough[c] > slides_above
            fx, fy, fz = friction(state, material, keeps_sliding, normal, tx, ty, tz)
            if drift > 0.0:
                fx, fy, fz = against_first_slip(state, mt, tx, ty, tz, fx, fy, fz)
            tx, ty, tz = fx, fy, fz
            dx, dy, dz = tx - ox, ty - oy, tz - oz
            slope = slope_on_wall(contact, slope, dx, dy, dz) - (dx * qx + dy * qy + dz * qz)
            contact.friction_x, contact.friction_y, contact.friction_z = tx, ty, tz
            contact.delta_x, contact.delta_y, contact.delta_z = dx, dy, dz
            largest = max(largest, abs(dx), abs(dy), abs(dz))
            Jx, Jy, Jz = Jx + dx, Jy + dy, Jz + dz
            turn(contact, body_i, body_j, dx, dy, dz)
            accumulate_turn(contact, body_i, body_j, dx, dy, dz)
        slope = slope_of_image(contact, slope, Jx, Jy, Jz)
        largest *= body_i.inverse_mass + body_j.inverse_mass
        if spins and exerts_torque(system.materials[0]):
            material = system.materials[material_index(i, j, count, places)]
            largest = max(largest, _resist_rotation(contact, material, body_i, body_j, normal, alpha))
        if largest > system.small_change[c]:
            change = max(change, largest)
        push(body_i, body_j, Jx, Jy, Jz)
        accumulate_push(body_i, body_j, Jx, Jy, Jz)
    return change, step_limit, slope


@inline
def _resist_rotation(
    contact: ContactRecord, material: Coefficients, a: BodyStateRecord, b: BodyStateRecord, normal: float, alpha: float
) -> float:
    """Change the angular impulse to end Ω, within the law's limits; return the change of the surface speed, in m/s.

    The surface speed is measured at a lever arm's distance from the centre.
    """
    wx, wy, wz = relative_spin(a, b)
    x, y, z = angular_impulse(contact)
    dx, dy, dz = change_of_angular_impulse(contact)
    ox, oy, oz = x + alpha * dx, y + alpha * dy, z + alpha * dz
    K = a.inverse_inertia + b.inverse_inertia
    if K == 0.0:
        return 0.0
    x, y, z = limited(contact, material, normal, ox - wx / K, oy - wy / K, oz - wz / K)
    dx, dy, dz = x - ox, y - oy, z - oz
    set_angular_impulse(contact, x, y, z)
    set_change_of_angular_impulse(contact, dx, dy, dz)
    apply_angular_impulse(a, b, dx, dy, dz)
    accumulate_angular_impulse(a, b, dx, dy, dz)
    return float(max(abs(dx), abs(dy), abs(dz)) * K * max(contact.arm_i, contact.arm_j))


@inline
def _solve_one_by_one(
    system: ConstraintSystem, first: int, totals: tuple[float, float, float], turning: tuple[()] | tuple[int]
) -> tuple[float, float, float]:
    return _solve_each(first, first + WIDTH, totals, system, turning)


@instruction(_solve_one_by_one, returns=("float64",) * 3, first="intp")
def solve_block(code: Code, system: Any, first: Any, totals: Any, turning: Any) -> list[Any]:
    """Solve the contacts of a block; return ``totals`` with their values included. For the arguments see `solve`."""
    solution = _Solution(Block(code, first))
    solution.solve(turns=len(code.kinds["turning"]) > 0)
    return solution.totals(*(code.builder.extract_value(totals, k) for k in range(3)))


class _Solution:
    """Generates the code that solves a block."""

    def __init__(self, block: Block) -> None:
        self._block, self._builder, self._held = block, block.builder, block.held

    def solve(self, *, turns: bool) -> None:
        """Change the impulses of the held contacts, and the velocities of their bodies."""
        block = self._block
        block.fetch_bodies_ahead("bodies", (VELOCITY, CHANGE))
        fields = block.kind_of("contacts").dtype.fields
        names = ("turn_x", "surface_x", "image_x", "angular_x")
        on_walls, on_moving_walls, of_images, self._resists = (name in fields for name in names)
        kind = next(kind for kind in KINDS if set(kind.names or ()) == set(fields))
        contact = block.records("contacts", kind, range(2 + self._resists + of_images))
        if on_moving_walls:
            contact.assume(**self._at_walls(contact, "surface"))
        bodies = a, b = block.bodies("bodies", BODY_STATE, (VELOCITY,))
        alpha = block.setting("alpha")
        vn, *u = in_lanes(relative_velocity)(contact, a, b)
        bias = self._bias(contact, u)
        old = contact.normal_impulse + alpha * contact.delta_normal
        normal = greater(0.0, old - (vn + bias) * contact.normal_mass)
        more = normal - old
        contact.change(normal_impulse=normal, delta_normal=more)
        J, torque, largest = [more * contact.nx, more * contact.ny, more * contact.nz], None, abs(more)
        slopes = [more * bias]
        if turns:
            q = self._half_turn(contact, bodies, u, on_walls)
            u = [slips - kept for slips, kept in zip(in_lanes(slip)(contact, a, b, *u), q, strict=True)]
            d = self._rub(contact, u, alpha)
            if on_moving_walls:
                slopes.append(along_surface_velocity(contact, *d))
            slopes.append(-(d[0] * q[0] + d[1] * q[1] + d[2] * q[2]))
            largest = reduce(greater, map(abs, d), largest)
            J = [along + rubbing for along, rubbing in zip(J, d, strict=True)]
            torque = in_lanes(torque_of)(contact, *d)
        if of_images:
            slopes.append(in_lanes(along_image)(contact, *J))
        self._change = largest * (a.inverse_mass + b.inverse_mass)
        self._normal, self._more, self._slopes = normal, more, slopes
        block.apply(contact, bodies, (VELOCITY, CHANGE), self._held, J, torque)
        contact.write(1, self._held)
        if torque is not None and self._resists:
            self._resist_rotation(contact, bodies, torque, alpha)
            contact.write(2, self._held)

    def _half_turn(self, contact: RecordLanes, bodies: Sequence[RecordLanes], u: InLanes, on_walls: bool) -> InLanes:
        """Return q of the contacts, see `half_turn_of`."""
        builder, block = self._builder, self._block
        nothing = [spread(builder, DOUBLE(0.0))] * 3

        def before_drift() -> list[Lanes]:
            at_walls = [*self._at_walls(contact, "turn").values()] if on_walls else nothing
            turns = in_lanes(half_turn)(contact, *bodies, *u, block.setting("drift"))
            between = block.between_bodies
            return [turn.where(between, at_wall) for turn, at_wall in zip(turns, at_walls, strict=True)]

        return either(builder, block.drifts, before_drift, lambda: nothing)

    def _at_walls(self, contact: RecordLanes, name: str) -> dict[str, Lanes]:
        """Return a vector that is 0 between bodies. Only blocks with walls read memory, which makes a drum faster."""
        block, names = self._block, [f"{name}_{axis}" for axis in "xyz"]
        zero = spread(self._builder, DOUBLE(0.0))
        at_walls = (~block.between_bodies).any
        velocity = either(self._builder, at_walls, lambda: [*map(contact.field, names)], lambda: [zero] * len(names))
        return dict(zip(names, velocity, strict=True))

    def _resist_rotation(
        self, contact: RecordLanes, bodies: Sequence[RecordLanes], torque: InLanes, alpha: Lanes
    ) -> None:
        """Change the angular impulse to end Ω after the friction ``torque``, within the law's limits."""
        block = self._block
        a, b = bodies
        spins = [
            [spin + by for spin, by in zip((body.wx, body.wy, body.wz), block.turns(body, arm, torque), strict=True)]
            for body, arm in ((a, contact.arm_i), (b, contact.arm_j))
        ]
        relative = [after - before for before, after in zip(*spins, strict=True)]
        K = a.inverse_inertia + b.inverse_inertia
        axes = ("x", "y", "z")
        old = [getattr(contact, f"angular_{axis}") + alpha * getattr(contact, f"change_{axis}") for axis in axes]
        ending = [before - along / K for before, along in zip(old, relative, strict=True)]
        allowed = self._limited(contact.normal_impulse, ending)
        rotates = K > 0.0
        d = [after - before for before, after in zip(old, allowed, strict=True)]
        for axis, after, change in zip(axes, allowed, d, strict=True):
            before = getattr(contact, f"angular_{axis}"), getattr(contact, f"change_{axis}")
            contact.change(
                **{
                    f"angular_{axis}": after.where(rotates, before[0]),
                    f"change_{axis}": change.where(rotates, before[1]),
                }
            )
        for body, change in ((a, [-along for along in d]), (b, d)):
            by = [block.nothing] * 3 + [body.inverse_inertia * along for along in change] + [block.nothing] * 2
            body.add((VELOCITY, CHANGE), by, self._held & (body.inverse_inertia > 0.0))
        surface_speed = reduce(greater, map(abs, d)) * K * greater(contact.arm_i, contact.arm_j)
        self._change = greater(self._change, surface_speed.where(rotates, block.nothing))

    def _limited(self, normal: Lanes, ending: InLanes) -> list[Lanes]:
        """Return the angular impulse that the law allows, contact by contact, given the impulse that would end Ω."""
        block = self._block
        kinds = [*(block.kind_of(name).dtype for name in ("contacts", "materials")), *["float64"] * 4]
        numbers = normal, *ending
        given = (
            [block.address("contacts", block.places[k]), material, *(v.lane(k) for v in numbers)]
            for k, material in enumerate(block.materials())
        )
        return block.one_by_one(limited, kinds, given)

    def totals(self, change: Any, step_limit: Any, slope: Any) -> list[Any]:
        """Return the largest change, the limit of the step, and the slope; all three include the previous contacts."""
        largest, limit = spread(self._builder, change), spread(self._builder, step_limit)
        small = read_doubles(self._builder, self._block.address("small_change", self._block.places[0]))
        matters = self._held & (self._change > small) & (self._change > largest)
        largest = self._change.where(matters, largest)
        pulling = -self._normal / self._more
        nearer = self._held & (self._more < 0.0) & (pulling < limit)
        limit = pulling.where(nearer, limit)
        slope = added_in_order(
            self._builder, slope, *(each.where(self._held, self._block.nothing) for each in self._slopes)
        )
        return [largest.largest(), self._builder.fneg((-limit).largest()), slope]

    def _bias(self, contact: RecordLanes, u: InLanes) -> Lanes:
        """Return the biases c: `bias_along_arc` between bodies before a drift, otherwise as `prepare` wrote them."""
        builder, block, bias = self._builder, self._block, contact.velocity_bias
        between = block.between_bodies

        def along_arc() -> list[Lanes]:
            arc = in_lanes(bias_along_arc)(bias, contact.arm_i + contact.arm_j, *u, block.setting("drift"))
            return [arc.where(between, bias)]

        return either(builder, block.drifts, along_arc, lambda: [bias])[0]

    def _rub(self, contact: RecordLanes, u: InLanes, alpha: Lanes) -> list[Lanes]:
        """Change the friction towards the impulse that ends the slip u, as far as the law allows; return its change."""
        axes = ("x", "y", "z")
        old = [getattr(contact, f"friction_{axis}") + alpha * getattr(contact, f"delta_{axis}") for axis in axes]
        ending = [before - along * contact.tangent_mass for before, along in zip(old, u, strict=True)]
        friction = self._against_first_slip(contact, ending, self._by_law(contact.normal_impulse, ending))
        d = [after - before for after, before in zip(friction, old, strict=True)]
        for axis, after, change in zip(axes, friction, d, strict=True):
            contact.change(**{f"friction_{axis}": after, f"delta_{axis}": change})
        return d

    def _by_law(self, normal: Lanes, ending: InLanes) -> list[Lanes]:
        """Return the friction that the law allows, contact by contact, given the impulse that would end the slip."""
        builder, block = self._builder, self._block
        records = [block.kind_of(name).dtype for name in ("states", "materials")]
        kinds = [*records, "boolean", *["float64"] * 4]
        enough = read_doubles(builder, block.address("enough", block.places[0]))
        # only the state of held contacts is marked as sliding
        keeps_sliding = self._held & (enough > block.setting("slides_above"))
        numbers = normal, *ending
        given = (
            [block.address("states", block.places[k]), material, keeps_sliding.bit(k), *(v.lane(k) for v in numbers)]
            for k, material in enumerate(block.materials())
        )
        return block.one_by_one(friction, kinds, given)

    def _against_first_slip(self, contact: RecordLanes, ending: InLanes, friction: InLanes) -> InLanes:
        """Turn the friction of sliding contacts before a drift; see `against_first_slip`."""
        builder, block = self._builder, self._block
        most, given = (reduce(lambda a, b: a + b, [t * t for t in impulse]) for impulse in (ending, friction))
        kinds = [block.kind_of("states").dtype, *["float64"] * 7]

        numbers = contact.tangent_mass, *ending, *friction

        def turned() -> list[Lanes]:
            given = ([block.address("states", block.places[k]), *(v.lane(k) for v in numbers)] for k in range(WIDTH))
            return block.one_by_one(against_first_slip, kinds, given)

        slides = builder.and_(block.drifts, (self._held & (given < most)).any)
        return either(builder, slides, turned, lambda: [*friction])
