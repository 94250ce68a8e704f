"""Position correction: overlapping bodies at rest are pushed apart, without a velocity along the normal.

A pair is pushed apart by δ along n. Each body moves in proportion to its inverse mass, so the centre of mass stays
where it is. The push alone would change the angular momentum by μ δ n × v_t (μ the reduced mass, v_t the tangential
relative velocity of the centres). Scaling v_t by d/(d + δ) conserves the angular momentum:

    (d + δ) n × (v_t d/(d + δ)) = d n × v_t

This method is `contact.stabilisation = "split"`. With `"baumgarte"`, the pipeline instead requests a velocity bias from
`impacts` and `prepare`: `BAUMGARTE` times the overlap per step.

Only resting contacts are pushed. Bodies in an impact separate by their rebound, and pushing them would take tangential
energy from a gas at every collision.

The ledger books the change of the energy. The change by the scaling is exact, at the velocities after the first kick;
in the kick of h that follows, the accelerations a do the work μ (a_j - a_i)·(σ v_t) h on the change σ v_t, with
σ = d/(d + δ) - 1. The change of the potential is booked as the work against gravity at the new positions, with an error
of (δ/d)² times the pair's potential. Both terms together are -μ (a_j - a_i)·(δ n - h σ v_t).

Rejected: the mean of the forces at the start and the end of the step, although its error is of the next order. In the
collapse of 500 boulders, both have errors of 10⁻⁶ of the energy scale.

Contacts of a colour are corrected eight at a time (`correct_block`), with the same bits as if corrected one by one.
Both forms call the same formulas, which accept doubles or lanes.
"""

from __future__ import annotations

from typing import Any

from carom.arrays import FloatArray, IntArray, RecordArray
from carom.physics.contact.constraints import (
    CONTACT_STATE,
    PUSHED_BODY,
    RECORDED,
    ConstraintSystem,
    body_count,
    contacts_of,
    ends_of,
)
from carom.physics.contact.geometry import normal_and_distance
from carom.physics.contact.guided_walls import pushed_rise
from carom.physics.contact.law import material_index, restitution
from carom.physics.contact.records import ContactStateRecord, PushedBodyRecord
from carom.physics.contact.solids import tangent_plane
from carom.physics.contact.solver.block import Block, whole_blocks
from carom.physics.contact.solver.body_state import along_and_across, prefetch_ends, velocity_along
from carom.physics.jit.decorators import inline, inner, kernel, long_kernel
from carom.physics.jit.instructions import Code, from_front, instruction
from carom.physics.jit.vectors import DOUBLE, WIDTH, WORD, Lanes, Mask, at_least, gathered, in_lanes, read_doubles
from carom.physics.sheared_box import nearest_in_drift, periods, relative_to_image
from carom.physics.vector import is_periodic, vector, write
from carom.scene.schema import Coefficients

BAUMGARTE = 0.2  # fraction of the overlap that the bias removes in a step

# Fraction of the rest speed; contacts that separate faster than this are not pushed. With 1, slow rebounds would be
# pushed (10 times the energy error in the worst step). With 0, a pile would keep overlaps (a quarter of a radius while
# it forms).
MAX_SEPARATION = 0.1

NEVER = -2  # iteration noted for a body that was never pushed; less than any iteration minus 1
AMOUNTS = 1  # line of `CONTACT_STATE` with the energies, the pushes and the flags


@kernel
def count_contacts(pairs: IntArray, counts: IntArray) -> None:
    """Count the contacts of each body and plane.

    One thread takes 40 µs for 40 000 contacts, two threads with atomic additions take 250 µs.
    """
    counts[:] = 0
    for c in range(len(pairs)):
        i, j = ends_of(pairs, c)
        counts[i] += 1
        counts[j] += 1


@long_kernel
def find_push_fractions(
    lo: int, hi: int, pairs: IntArray, counts: IntArray, states: RecordArray[ContactStateRecord]
) -> None:
    """Compute the fraction of each overlap that an iteration removes: 1 / (smaller number of contacts of its ends).

    Removing the whole overlap would push each body into the next one. A compressed pile would then never come to rest.
    In a falling stack of 500 balls, every other contact would keep an overlap of 0.24 r instead of 0.06 r.
    """
    for c in range(from_front(lo), hi):
        i, j = ends_of(pairs, c)
        states[c].push_fraction = 1.0 / min(counts[i], counts[j])


@inner
def correct_positions(first: int, end: int, system: ConstraintSystem) -> None:
    """Push the resting contacts of some pieces apart once; record whether an overlap needs another iteration.

    Here a contact is at rest if it separates no faster than a tenth of the rest speed, or approaches without a rebound.
    Later iterations visit only contacts with an end that the previous iteration pushed. All other contacts have not
    changed since an iteration found that they need no push: they do not overlap, or are not at rest.
    """
    n = body_count(system)
    for piece in range(first, end):
        lo, hi = contacts_of(piece, piece + 1, system)
        blocks = whole_blocks(piece, system) if not is_periodic(periods(system.box)) else 0
        c, one_by_one, again = lo, lo + blocks * WIDTH, 0.0
        while c < hi:
            if c < one_by_one and (c - lo) % WIDTH == 0:
                again = correct_block(system, c, again)  # contacts between bodies
                if len(system.surface) == 0:
                    c += WIDTH
                    continue
            if c >= one_by_one or ends_of(system.pairs, c)[1] >= n:
                again = max(again, _push_apart(c, system))
            c += 1
        system.piece_results[piece].residual = again


@inline
def _push_apart(c: int, system: ConstraintSystem) -> float:
    """Push a contact apart if it is at rest; return 1 if its overlap needs another iteration, otherwise 0."""
    i, j = ends_of(system.pairs, c)
    iteration, pushed_in, n = system.settings[0].iteration, system.pushed_in, body_count(system)
    if iteration > 0 and max(pushed_in[i], pushed_in[j]) < iteration - 1:
        return 0.0
    prefetch_ends(system.pushed, system.pairs, c)
    state, a, b = system.states[c], system.pushed[i], system.pushed[j]
    nx, ny, nz, d, radii = _geometry(a, b, j - n, system)
    overlap = radii - d
    if overlap <= 0.0:
        return 0.0
    ux, uy, uz = relative_to_image(system.contacts[c], b.vx - a.vx, b.vy - a.vy, b.vz - a.vz)
    vn, tx, ty, tz = along_and_across(nx, ny, nz, ux, uy, uz)
    material = system.materials[material_index(i, j, n, system.places)]
    if separates(vn, system.load_speed[c], restitution(material, -vn, system.load_speed[c])):
        return 0.0
    delta, mi, mj, reduced = push_of(state.push_fraction, overlap, a, b)
    if mi > 0.0:
        pushed_in[i] = iteration
        _move(a, -mi * delta, nx, ny, nz)
    if mj > 0.0:
        pushed_in[j] = iteration
        _move(b, mj * delta, nx, ny, nz)
    sigma = relative_change_of_vt(d, delta) if j < n else 0.0  # a plane absorbs any angular momentum
    later = system.settings[0].next_kick * sigma
    state.push_x += effective_push(delta, nx, later, tx)
    state.push_y += effective_push(delta, ny, later, ty)
    state.push_z += effective_push(delta, nz, later, tz)
    if j < n:
        if mi > 0.0:
            _accelerate(a, -mi * sigma, tx, ty, tz)
        if mj > 0.0:
            _accelerate(b, mj * sigma, tx, ty, tz)
        _book(c, reduced, sigma, tx, ty, tz, system)
    return 1.0 if overlap > system.enough[c] * radii else 0.0


@inline
def _book(c: int, reduced: float, sigma: float, tx: float, ty: float, tz: float, system: ConstraintSystem) -> None:
    """Book the energy and, if contacts are recorded, the momentum that scaling v_t transfers."""
    system.states[c].stabilisation_gain += gain_of(reduced, tx, ty, tz, sigma)
    if len(system.recorded) > 0:
        given = system.recorded[c]
        given.correction_x += reduced * sigma * tx
        given.correction_y += reduced * sigma * ty
        given.correction_z += reduced * sigma * tz


@inline
def _move(body: PushedBodyRecord, s: float, nx: float, ny: float, nz: float) -> None:
    body.x, body.y, body.z = body.x + s * nx, body.y + s * ny, body.z + s * nz


@inline
def _accelerate(body: PushedBodyRecord, s: float, tx: float, ty: float, tz: float) -> None:
    body.vx, body.vy, body.vz = body.vx + s * tx, body.vy + s * ty, body.vz + s * tz


@inline
def _geometry(
    a: PushedBodyRecord, b: PushedBodyRecord, plane: int, system: ConstraintSystem
) -> tuple[float, float, float, float, float]:
    """Return the normal, the distance between the centres or from the plane, and the distance at contact, in m.

    ``plane`` is negative between two bodies.
    """
    box = system.box
    if plane >= 0:
        sx, sy, sz, offset = tangent_plane(system.surface, system.offset, plane, a.x, a.y, a.z)
        rise = pushed_rise(system.bodies[body_count(system) + plane], b, (sx, sy, sz))
        return -sx, -sy, -sz, sx * a.x + sy * a.y + sz * a.z - offset - rise, a.radius
    dx, dy, dz = b.x - a.x, b.y - a.y, b.z - a.z
    dx, dy, dz = nearest_in_drift(dx, dy, dz, box, 0.0)
    nx, ny, nz, d = normal_and_distance(dx, dy, dz)
    return nx, ny, nz, d, a.radius + b.radius


@long_kernel
def audit_corrections(
    lo: int,
    hi: int,
    pairs: IntArray,
    acceleration: FloatArray,
    inverse_mass: FloatArray,
    states: RecordArray[ContactStateRecord],
) -> None:
    """Book the change of the energy by the pushes, -μ (a_j - a_i)·Σ (δ n - h σ v_t), in J."""
    a = acceleration
    for c in range(from_front(lo), hi):
        (i, j), state = ends_of(pairs, c), states[c]
        reduced = 1.0 / (inverse_mass[i] + inverse_mass[j])
        ax, ay, az = a[j, 0] - a[i, 0], a[j, 1] - a[i, 1], a[j, 2] - a[i, 2]
        work = ax * state.push_x + ay * state.push_y + az * state.push_z
        state.stabilisation_gain -= reduced * work


@inline
def separates(vn: float, load_speed: float, e: float) -> bool:
    """Return whether a contact opens without a push, because it separates or rebounds with e.

    Parameters
    ----------
    vn, load_speed
        m/s
    """
    return (vn > MAX_SEPARATION * load_speed) | (e > 0.0)


@inline
def push_of(
    fraction: float, overlap: float, a: PushedBodyRecord, b: PushedBodyRecord
) -> tuple[float, float, float, float]:
    """Return δ in m, the fractions of δ by which the bodies move, and the reduced mass μ in kg."""
    total = a.inverse_mass + b.inverse_mass
    return fraction * overlap, a.inverse_mass / total, b.inverse_mass / total, 1.0 / total


@inline
def relative_change_of_vt(d: float, delta: float) -> float:
    """Return σ = d/(d + δ) - 1, the relative change of v_t."""
    return d / (d + delta) - 1.0


@inline
def effective_push(delta: float, along: float, later: float, across: float) -> float:
    """Return a component of δ n - h σ v_t in m, given δ, the component of n, h σ in s, and that of v_t."""
    return delta * along - later * across


@inline
def gain_of(reduced: float, tx: float, ty: float, tz: float, sigma: float) -> float:
    """Return ½ μ v_t² σ (2 + σ), the energy in J that scaling v_t by 1 + σ adds."""
    return 0.5 * reduced * (tx * tx + ty * ty + tz * tz) * sigma * (2.0 + sigma)


@long_kernel
def gather_positions(
    lo: int,
    hi: int,
    active: IntArray,
    moving: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
    bodies: RecordArray[PushedBodyRecord],
    pushed_in: IntArray,
) -> None:
    """Copy the active bodies and planes [lo, hi) into `PUSHED_BODY`, as not yet pushed."""
    x, v, radius, inverse_mass = moving
    for k in range(lo, hi):
        b = from_front(active[k])
        body = bodies[b]
        if b < len(x):  # planes have no position
            body.x, body.y, body.z = vector(x, b)
        body.vx, body.vy, body.vz = vector(v, b)
        body.radius, body.inverse_mass = radius[b], inverse_mass[b]
        pushed_in[b] = NEVER


@long_kernel
def scatter_positions(
    lo: int,
    hi: int,
    active: IntArray,
    bodies: RecordArray[PushedBodyRecord],
    pushed_in: IntArray,
    x: FloatArray,
    v: FloatArray,
) -> None:
    """Copy positions and velocities back into the arrays, for those active bodies [lo, hi) that were pushed."""
    for k in range(lo, hi):
        b = from_front(active[k])
        if pushed_in[b] != NEVER:
            body = bodies[b]
            write(x, b, body.x, body.y, body.z)
            write(v, b, body.vx, body.vy, body.vz)


@inline
def _correct_one_by_one(system: ConstraintSystem, first: int, again: float) -> float:
    for c in range(first, first + WIDTH):
        if ends_of(system.pairs, c)[1] < body_count(system):
            again = max(again, _push_apart(c, system))
    return again


@instruction(_correct_one_by_one, returns="float64", first="intp", again="float64")
def correct_block(code: Code, system: Any, first: Any, again: Any) -> Any:
    """Push apart, once, the contacts between bodies in a block; return 1 if an overlap needs another iteration.

    If no overlap does, return ``again``. Contacts with planes are skipped.
    """
    result = code.variable(again)
    _Correction(Block(code, first)).correct(result)
    return code.load(result)


class _Correction:
    """Generates the code that corrects a block."""

    def __init__(self, block: Block) -> None:
        self._block, self._builder = block, block.builder

    def correct(self, result: Any) -> None:
        """Push apart the contacts that overlap, are at rest, and have an end that the previous iteration pushed.

        Store 1 at the address ``result`` if one of these contacts needs another iteration.
        """
        visited = self._visited()
        with self._builder.if_then(visited.any):
            self._block.fetch_bodies_ahead("pushed", (0,))
            self._a, self._b = a, b = self._block.bodies("pushed", PUSHED_BODY, (0,))
            *self._n, self._d = in_lanes(normal_and_distance)(b.x - a.x, b.y - a.y, b.z - a.z)
            radii = a.radius + b.radius
            overlap = radii - self._d
            overlaps = visited & (overlap > 0.0)
            with self._builder.if_then(overlaps.any):
                pushed = self._push(overlap, overlaps)
                with self._builder.if_then((pushed & (overlap > self._enough * radii)).any):
                    self._builder.store(DOUBLE(1.0), result)

    def _visited(self) -> Mask:
        """Return the contacts between bodies with an end that the previous iteration pushed; at first, all contacts."""
        builder, block = self._builder, self._block
        iteration = block.number("iteration")
        is_first = builder.icmp_signed("==", iteration, WORD(0))
        since = builder.select(is_first, WORD(NEVER), builder.sub(iteration, WORD(1)))
        last = [[builder.load(block.address("pushed_in", body)) for body in end] for end in block.ends]
        i, j = (at_least(builder, end, since) for end in last)
        return (i | j) & block.between_bodies

    def _push(self, overlap: Lanes, overlaps: Mask) -> Mask:
        """Push apart the overlapping contacts that are at rest; return them.

        Contacts that are not pushed are written with unchanged bits, because a branch for each contact would often be
        mispredicted. Fixed bodies are not written, since other threads' pieces may share them.
        """
        a, b, block, n, d = self._a, self._b, self._block, self._n, self._d
        states = block.records("states", CONTACT_STATE, (AMOUNTS,))
        load_speed = read_doubles(self._builder, block.address("load_speed", block.places[0]))
        vn, *t = in_lanes(velocity_along)(*n, a, b)
        pushed: Mask = overlaps & ~in_lanes(separates)(vn, load_speed, self._restitution(-vn, load_speed))

        def of_pushed(amount: Lanes) -> Lanes:
            return amount.where(pushed, block.nothing)

        delta, mi, mj, reduced = in_lanes(push_of)(states.push_fraction, overlap, a, b)
        sigma = in_lanes(relative_change_of_vt)(d, delta)
        for body, ends, part, by in ((a, block.ends[0], mi, -mi), (b, block.ends[1], mj, mj)):
            moves = part > 0.0
            x, y, z = (of_pushed(by * delta * along) for along in n)
            vx, vy, vz = (of_pushed(by * sigma * along) for along in t)
            body.add_to(moves, x=x, y=y, z=z, vx=vx, vy=vy, vz=vz)
            self._note(ends, pushed, moves)
        later = block.setting("next_kick") * sigma
        push = [in_lanes(effective_push)(delta, along, later, across) for along, across in zip(n, t, strict=True)]
        states.change(
            push_x=states.push_x + of_pushed(push[0]),
            push_y=states.push_y + of_pushed(push[1]),
            push_z=states.push_z + of_pushed(push[2]),
            stabilisation_gain=states.stabilisation_gain + of_pushed(in_lanes(gain_of)(reduced, *t, sigma)),
        )
        states.write(AMOUNTS)
        with self._builder.if_then(self._builder.icmp_signed(">", block.count("recorded"), WORD(0))):
            x, y, z = (reduced * sigma * along for along in t)
            recorded = block.records("recorded", RECORDED, ())
            recorded.add_to(pushed, correction_x=x, correction_y=y, correction_z=z)
        return pushed

    def _restitution(self, approach: Lanes, load_speed: Lanes) -> Lanes:
        """Return the coefficient of restitution that the law gives each contact."""
        block, coefficients = self._block, []
        kinds = [block.kind_of("materials").dtype, "float64", "float64"]
        for k, material in enumerate(block.materials()):
            given = [material, approach.lane(k), load_speed.lane(k)]
            coefficients.append(block.code.call(_restitution_of_one, "float64", *zip(kinds, given, strict=True)))
        return gathered(self._builder, coefficients)

    def _note(self, ends: list[Any], pushed: Mask, moving: Mask) -> None:
        """Record the iteration in which free ends were pushed."""
        builder, block = self._builder, self._block
        iteration = block.number("iteration")
        places = [block.address("pushed_in", end) for end in ends]
        notes = [builder.select(pushed.bit(k), iteration, builder.load(place)) for k, place in enumerate(places)]
        moving.in_each(lambda k: builder.store(notes[k], places[k]))

    @property
    def _enough(self) -> Lanes:
        """The overlap that needs no further iteration, relative to the sum of radii."""
        return read_doubles(self._builder, self._block.address("enough", self._block.places[0]))


def _restitution_of_one(material: Coefficients, approach: float, load_speed: float) -> float:
    """Call the law: `Code.call` accepts a plain function of Python, not a kernel."""
    return restitution(material, approach, load_speed)
