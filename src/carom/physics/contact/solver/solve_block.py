"""Eight contacts that share no moving body, solved at once: `solve`, with a lane for each contact.

The lanes do what the loop of `solve` does, operation by operation, so they have its bits. The law is called for each
contact by itself, so a law needs no second form.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types

from carom.physics.contact.constraints import BODY_STATE, CONTACT
from carom.physics.contact.solver.friction import friction
from carom.physics.parallel.intrinsics import address_in, instruction
from carom.physics.parallel.lanes import (
    LINE,
    WIDTH,
    WORD,
    Lanes,
    computed_if,
    gathered,
    greater,
    mask_of,
    read_line,
    spread,
    write_line,
)

Fields = dict[str, Lanes]
Three = tuple[Lanes, Lanes, Lanes]

THREE_DOUBLES: Any = types.Tuple([types.float64] * 3)  # type: ignore[no-untyped-call]


@instruction
def solve_block(
    typing: Any,
    pairs: Any,  # this and the next as in `ConstraintSystem`
    held: Any,
    small_change: Any,
    contacts: Any,
    states: Any,
    bodies: Any,
    materials: Any,
    places: Any,
    first: Any,  # contact of the block
    end: Any,  # contacts of the block from here on are left out
    count: Any,  # of bodies
    alpha: Any,  # this and the next as in `SETTINGS`
    drift: Any,
    keeps_sliding: Any,
    change: Any,  # this and the next: what `solve` found before
    step_limit: Any,
    slope: Any,
    turning: Any,  # as in `solve`
) -> Any:
    """Solve a block of contacts; return what `solve` found with those of the block."""
    kind_of = {name: kind for name, kind in locals().items() if name != "typing"}

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        block = _Block(context, builder, kind_of, dict(zip(kind_of, args, strict=True)))
        return context.make_tuple(builder, signature.return_type, block.solve(turns=len(kind_of["turning"]) > 0))

    return THREE_DOUBLES(*kind_of.values()), generate


class _Block:
    """Generates the code for a block."""

    def __init__(self, context: Any, builder: Any, kinds: dict[str, Any], given: dict[str, Any]) -> None:
        self._context, self._builder, self._kinds, self._given = context, builder, kinds, given
        last = builder.sub(given["end"], WORD(1))
        places = [builder.add(given["first"], WORD(k)) for k in range(WIDTH)]
        inside = [builder.icmp_signed("<", place, given["end"]) for place in places]
        self._places = [builder.select(bit, place, last) for bit, place in zip(inside, places, strict=True)]
        marks = [builder.load(self._address("held", place)) for place in self._places]
        held = [builder.icmp_unsigned("!=", mark, mark.type(0)) for mark in marks]
        self._held = [builder.and_(*bits) for bits in zip(inside, held, strict=True)]
        zero = WORD(0)
        self._ends = [
            [builder.load(self._address("pairs", place, builder.add(zero, WORD(end)))) for place in self._places]
            for end in range(2)
        ]

    def solve(self, *, turns: bool) -> list[Any]:
        """Solve the contacts; return the largest change, the limit of the step, and the slope."""
        builder, given = self._builder, self._given
        contacts = [self._address("contacts", place) for place in self._places]
        bodies = [[self._address("bodies", body) for body in end] for end in self._ends]
        c = _read(builder, contacts, CONTACT)
        a, b = (_read(builder, addresses, BODY_STATE) for addresses in bodies)
        none, alpha = spread(builder, ir.Constant(ir.DoubleType(), 0.0)), spread(builder, given["alpha"])
        n = c["nx"], c["ny"], c["nz"]
        u = b["vx"] - a["vx"], b["vy"] - a["vy"], b["vz"] - a["vz"]
        vn = _dot(u, n)
        u = u[0] - vn * n[0], u[1] - vn * n[1], u[2] - vn * n[2]
        bias = self._bias(c, u, none)
        old = c["normal_impulse"] + alpha * c["delta_normal"]
        normal = greater(none, old - (vn + bias) * c["normal_mass"])
        more = normal - old
        c["normal_impulse"], c["delta_normal"] = normal, more
        largest = abs(more)
        J = more * n[0], more * n[1], more * n[2]
        if turns:
            d = self._friction(c, a, b, u, alpha)
            largest = greater(largest, abs(d[0]), abs(d[1]), abs(d[2]))
            J = J[0] + d[0], J[1] + d[1], J[2] + d[2]
            torque = _cross(d, n)
            _turn(a, c["arm_i"] * a["inverse_inertia"], torque, none)
            _turn(b, c["arm_j"] * b["inverse_inertia"], torque, none)
        change = largest * (a["inverse_mass"] + b["inverse_mass"])
        _push(a, J, lambda before, by: before - by)
        _push(b, J, lambda before, by: before + by)
        for body, addresses in ((a, bodies[0]), (b, bodies[1])):
            moves = body["inverse_mass"].exceeds(none)
            lanes = [builder.extract_element(moves, ir.IntType(32)(k)) for k in range(WIDTH)]
            bits = [builder.and_(*both) for both in zip(self._held, lanes, strict=True)]
            _write(builder, addresses, BODY_STATE, body, (0, 1), bits)
        _write(builder, contacts, CONTACT, c, (1,), self._held)
        return self._found(change, normal, more, more * bias)

    def _address(self, name: str, *indices: Any) -> Any:
        return address_in(self._context, self._builder, self._kinds[name], self._given[name], indices)

    def _bias(self, c: Fields, u: Three, none: Lanes) -> Lanes:
        """Return the biases c, see `bias_along_arc`; they are those along the normal at planes, and without a drift."""
        builder, given, bias = self._builder, self._given, c["velocity_bias"]
        drifts = builder.fcmp_ordered(">", given["drift"], ir.Constant(ir.DoubleType(), 0.0))
        between = mask_of(builder, [builder.icmp_signed("<", j, given["count"]) for j in self._ends[1]])

        def along_arc() -> Lanes:
            drift = spread(builder, given["drift"])
            R = (c["arm_i"] + c["arm_j"]) - bias * drift
            t2 = _dot(u, u) * drift * drift
            bends = builder.and_(t2.exceeds(none), (R * R).exceeds(t2))
            more = t2 / ((R + (R * R - t2).root()) * drift)
            return (bias + more.where(bends, none)).where(between, bias)

        return computed_if(builder, drifts, along_arc, bias)

    def _friction(self, c: Fields, a: Fields, b: Fields, u: Three, alpha: Lanes) -> Three:
        """Find the friction; return its change."""
        w = [c["arm_i"] * a[axis] + c["arm_j"] * b[axis] for axis in ("wx", "wy", "wz")]
        turning = _cross((w[0], w[1], w[2]), (c["nx"], c["ny"], c["nz"]))
        slip = [before - by for before, by in zip(u, turning, strict=True)]
        old = [c[f"friction_{axis}"] + alpha * c[f"delta_{axis}"] for axis in "xyz"]
        ending = [before - ux * c["tangent_mass"] for before, ux in zip(old, slip, strict=True)]
        friction = self._by_law(c["normal_impulse"], ending)
        x, y, z = (after - before for after, before in zip(friction, old, strict=True))
        c["friction_x"], c["friction_y"], c["friction_z"] = friction
        c["delta_x"], c["delta_y"], c["delta_z"] = x, y, z
        return x, y, z

    def _by_law(self, normal: Lanes, ending: Sequence[Lanes]) -> list[Lanes]:
        """Return the friction that the law allows in place of the one that ends the slip, contact by contact."""
        builder, context, given = self._builder, self._context, self._given
        records = [self._kinds[name].dtype for name in ("states", "materials")]
        known = [types.boolean] * 2 + [types.float64] * 4
        signature = THREE_DOUBLES(*records, *known)
        rubs = []
        for k in range(WIDTH):
            found = self._address("states", self._places[k]), self._material(self._ends[0][k], self._ends[1][k])
            numbers = [value.lane(k) for value in (normal, *ending)]
            asked = [*found, self._held[k], given["keeps_sliding"], *numbers]
            rub = context.compile_internal(builder, _friction_if_held, signature, asked)
            rubs.append([builder.extract_value(rub, axis) for axis in range(3)])
        return [gathered(builder, [rub[axis] for rub in rubs]) for axis in range(3)]

    def _material(self, i: Any, j: Any) -> Any:
        """Return the address of the coefficients of two ends, see `material_index`."""
        builder, kind = self._builder, self._kinds["places"]
        places = self._context.make_array(kind)(self._context, builder, self._given["places"])
        many = builder.icmp_signed(">", builder.extract_value(places.shape, 0), WORD(0))
        plane = builder.add(builder.sub(j, self._given["count"]), WORD(1))
        row = builder.select(builder.icmp_signed(">", plane, WORD(0)), plane, WORD(0))
        before = builder.block
        with builder.if_then(many):
            parts = [builder.load(self._address("places", *at)) for at in ((i, WORD(0)), (j, WORD(1)))]
            known = builder.add(*parts)
            looked_up = builder.block
        joined = builder.phi(WORD)
        joined.add_incoming(known, looked_up)
        joined.add_incoming(row, before)
        return self._address("materials", joined)

    def _found(self, change: Lanes, normal: Lanes, more: Lanes, slope: Lanes) -> list[Any]:
        """Add the contacts of the block to the findings, one after the other, as sums depend on the order."""
        builder = self._builder
        found = [self._given[name] for name in ("change", "step_limit", "slope")]
        pulling = -normal / more
        zero = ir.Constant(ir.DoubleType(), 0.0)
        for k, held in enumerate(self._held):
            small = builder.load(self._address("small_change", self._places[k]))
            matters = builder.and_(held, builder.fcmp_ordered(">", change.lane(k), small))
            larger = builder.fcmp_ordered(">", change.lane(k), found[0])
            found[0] = builder.select(builder.and_(matters, larger), change.lane(k), found[0])
            less = builder.and_(held, builder.fcmp_ordered("<", more.lane(k), zero))
            nearer = builder.fcmp_ordered("<", pulling.lane(k), found[1])
            found[1] = builder.select(builder.and_(less, nearer), pulling.lane(k), found[1])
            found[2] = builder.select(held, builder.fadd(found[2], slope.lane(k)), found[2])
        return found


def _friction_if_held(
    state: Any, material: Any, held: bool, keeps_sliding: bool, normal: float, tx: float, ty: float, tz: float
) -> tuple[float, ...]:
    """Return the friction of a contact, given the one that would end the slip; of one that is not held, the latter."""
    if held:
        tx, ty, tz = friction(state, material, keeps_sliding, normal, tx, ty, tz)
    return tx, ty, tz


def _read(builder: Any, addresses: Sequence[Any], kind: np.dtype[np.void]) -> Fields:
    lines = kind.itemsize // LINE
    lanes = [field for line in range(lines) for field in read_line(builder, addresses, line)]
    return dict(zip(_names(kind), lanes, strict=True))


def _write(
    builder: Any,
    addresses: Sequence[Any],
    kind: np.dtype[np.void],
    fields: Fields,
    lines: Sequence[int],
    bits: Sequence[Any],
) -> None:
    names = _names(kind)
    for line in lines:
        row = [fields[name] for name in names[line * WIDTH : (line + 1) * WIDTH]]
        write_line(builder, addresses, line, row, bits)


def _names(kind: np.dtype[np.void]) -> list[str]:
    """Return the names of a record's doubles, and of those that only fill its lines."""
    names = list(kind.names or ())
    return names + [f"unused {k}" for k in range(len(names), kind.itemsize // 8)]


def _dot(u: Three, v: Three) -> Lanes:
    return u[0] * v[0] + u[1] * v[1] + u[2] * v[2]


def _cross(u: Three, v: Three) -> Three:
    x, y, z = u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]
    return x, y, z


def _push(body: Fields, J: Three, changed: Callable[[Lanes, Lanes], Lanes]) -> None:
    """Change the velocity by an impulse, now and in the sum of the iteration; fixed bodies are not written."""
    for axis, along in zip("xyz", J, strict=True):
        by = along * body["inverse_mass"]
        body[f"v{axis}"] = changed(body[f"v{axis}"], by)
        body[f"dv{axis}"] = changed(body[f"dv{axis}"], by)


def _turn(body: Fields, lever: Lanes, torque: Three, none: Lanes) -> None:
    """Change the spin by the torque of an impulse, now and in the sum of the iteration, where there is a lever."""
    turns = lever.exceeds(none)
    for axis, about in zip("xyz", torque, strict=True):
        by = lever * about
        for name in (f"w{axis}", f"dw{axis}"):
            body[name] = (body[name] + by).where(turns, body[name])
