"""Eight contacts that share no moving body, solved at once: `solve`, with a lane for each contact.

The lanes do what the loop of `solve` does, operation by operation, so they have its bits. The law is called for each
contact by itself, so a law needs no second form.
"""

from __future__ import annotations

from collections.abc import Sequence
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
    add_to_lines,
    computed_if,
    gathered,
    greater,
    mask_of,
    read_doubles,
    read_flags,
    read_line,
    spread,
    write_line,
)
from carom.physics.parallel.prefetch import fetch_line

Fields = dict[str, Lanes]
Three = tuple[Lanes, Lanes, Lanes]

THREE_DOUBLES: Any = types.Tuple([types.float64] * 3)  # type: ignore[no-untyped-call]
BODY_LINES = BODY_STATE.itemsize // LINE


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
    ahead: Any,  # first of the contacts whose bodies are fetched for a later block
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
        self._places = [builder.add(given["first"], WORD(k)) for k in range(WIDTH)]
        self._held = read_flags(builder, self._address("held", given["first"]))
        self._ends = self._ends_from(given["first"])
        self._zero = spread(builder, ir.Constant(ir.DoubleType(), 0.0))
        self._nothing = spread(builder, ir.Constant(ir.DoubleType(), -0.0))  # adding it keeps all bits, also of -0.0

    def solve(self, *, turns: bool) -> list[Any]:
        """Solve the contacts; return the largest change, the limit of the step, and the slope."""
        self._fetch_bodies_ahead()
        contacts = [self._address("contacts", place) for place in self._places]
        bodies = [[self._address("bodies", body) for body in end] for end in self._ends]
        c = _read(self._builder, contacts, CONTACT, CONTACT.itemsize // LINE)
        a, b = (_read(self._builder, addresses, BODY_STATE, 1) for addresses in bodies)
        alpha = spread(self._builder, self._given["alpha"])
        n = c["nx"], c["ny"], c["nz"]
        u = b["vx"] - a["vx"], b["vy"] - a["vy"], b["vz"] - a["vz"]
        vn = _dot(u, n)
        u = u[0] - vn * n[0], u[1] - vn * n[1], u[2] - vn * n[2]
        bias = self._bias(c, u)
        old = c["normal_impulse"] + alpha * c["delta_normal"]
        normal = greater(self._zero, old - (vn + bias) * c["normal_mass"])
        more = normal - old
        c["normal_impulse"], c["delta_normal"] = normal, more
        largest = abs(more)
        J, torque = (more * n[0], more * n[1], more * n[2]), None
        if turns:
            d = self._friction(c, a, b, u, alpha)
            largest = greater(largest, abs(d[0]), abs(d[1]), abs(d[2]))
            J, torque = (J[0] + d[0], J[1] + d[1], J[2] + d[2]), _cross(d, n)
        change = largest * (a["inverse_mass"] + b["inverse_mass"])
        self._apply((-J[0], -J[1], -J[2]), torque, c["arm_i"], a, bodies[0])
        self._apply(J, torque, c["arm_j"], b, bodies[1])
        write_line(self._builder, contacts, 1, [c[name] for name in _names(CONTACT)[WIDTH:]], self._held)
        return self._found(change, normal, more, more * bias)

    def _address(self, name: str, *indices: Any) -> Any:
        return address_in(self._context, self._builder, self._kinds[name], self._given[name], indices)

    def _ends_from(self, first: Any) -> list[list[Any]]:
        """Return the indices i, then j, of eight contacts."""
        places = [self._builder.add(first, WORD(k)) for k in range(WIDTH)]
        return [[self._builder.load(self._address("pairs", at, WORD(end))) for at in places] for end in range(2)]

    def _fetch_bodies_ahead(self) -> None:
        for end in self._ends_from(self._given["ahead"]):
            for body in end:
                for line in range(BODY_LINES):
                    fetch_line(self._builder, self._address("bodies", body), line, to_write=True)

    def _bias(self, c: Fields, u: Three) -> Lanes:
        """Return the biases c, see `bias_along_arc`; they are those along the normal at planes, and without a drift."""
        builder, given, bias = self._builder, self._given, c["velocity_bias"]
        drifts = builder.fcmp_ordered(">", given["drift"], ir.Constant(ir.DoubleType(), 0.0))
        between = mask_of(builder, [builder.icmp_signed("<", j, given["count"]) for j in self._ends[1]])

        def along_arc() -> Lanes:
            drift = spread(builder, given["drift"])
            R = (c["arm_i"] + c["arm_j"]) - bias * drift
            t2 = _dot(u, u) * drift * drift
            bends = builder.and_(t2.exceeds(self._zero), (R * R).exceeds(t2))
            more = t2 / ((R + (R * R - t2).root()) * drift)
            return (bias + more.where(bends, self._zero)).where(between, bias)

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
        builder, context = self._builder, self._context
        records = [self._kinds[name].dtype for name in ("states", "materials")]
        signature = THREE_DOUBLES(*records, types.boolean, *[types.float64] * 4)
        found = []
        for k, row in enumerate(self._material_rows()):
            state, material = self._address("states", self._places[k]), self._address("materials", row)
            slides = builder.and_(self._given["keeps_sliding"], self._is_held(k))  # others must not be marked
            asked = [state, material, slides, *(value.lane(k) for value in (normal, *ending))]
            allowed = context.compile_internal(builder, _friction_of_one, signature, asked)
            found.append([builder.extract_value(allowed, axis) for axis in range(3)])
        return [gathered(builder, [allowed[axis] for allowed in found]) for axis in range(3)]

    def _material_rows(self) -> list[Any]:
        """Return the row of each contact's coefficients, see `material_index`."""
        builder, kind = self._builder, self._kinds["places"]
        places = self._context.make_array(kind)(self._context, builder, self._given["places"])
        many = builder.icmp_signed(">", builder.extract_value(places.shape, 0), WORD(0))
        planes = [builder.add(builder.sub(j, self._given["count"]), WORD(1)) for j in self._ends[1]]
        rows = [builder.select(builder.icmp_signed(">", plane, WORD(0)), plane, WORD(0)) for plane in planes]
        before = builder.block
        with builder.if_then(many):
            known = []
            for i, j in zip(*self._ends, strict=True):
                parts = [builder.load(self._address("places", *at)) for at in ((i, WORD(0)), (j, WORD(1)))]
                known.append(builder.add(*parts))
            looked_up = builder.block
        joined = [builder.phi(WORD) for _ in rows]
        for phi, row, other in zip(joined, rows, known, strict=True):
            phi.add_incoming(row, before)
            phi.add_incoming(other, looked_up)
        return joined

    def _is_held(self, k: int) -> Any:
        return self._builder.extract_element(self._held, ir.IntType(32)(k))

    def _apply(self, J: Three, torque: Three | None, arm: Lanes, body: Fields, addresses: Sequence[Any]) -> None:
        """Change velocities and spins by impulses, now and in the sum of the iteration; fixed bodies are not written.

        Spins change where there is a lever.
        """
        by = [along * body["inverse_mass"] for along in J]
        if torque is not None:
            lever = arm * body["inverse_inertia"]
            turns = lever.exceeds(self._zero)
            by += [(lever * about).where(turns, self._nothing) for about in torque]
        by += [self._nothing] * (WIDTH - len(by))
        mask = self._builder.and_(self._held, body["inverse_mass"].exceeds(self._zero))
        add_to_lines(self._builder, addresses, BODY_LINES, by, mask)

    def _found(self, change: Lanes, normal: Lanes, more: Lanes, slope: Lanes) -> list[Any]:
        """Add the contacts of the block to the findings; to the slope one after the other, as its bits depend on it."""
        builder = self._builder
        largest, limit = (spread(builder, self._given[name]) for name in ("change", "step_limit"))
        small = read_doubles(builder, self._address("small_change", self._given["first"]))
        matters = builder.and_(self._held, change.exceeds(small))
        largest = change.where(builder.and_(matters, change.exceeds(largest)), largest)
        pulling = -normal / more
        nearer = builder.and_(self._zero.exceeds(more), limit.exceeds(pulling))
        limit = pulling.where(builder.and_(self._held, nearer), limit)
        total, by_held = self._given["slope"], slope.where(self._held, self._nothing)
        for k in range(WIDTH):
            total = builder.fadd(total, by_held.lane(k))
        return [largest.largest(), builder.fneg((-limit).largest()), total]


def _friction_of_one(
    state: Any, material: Any, keeps_sliding: bool, normal: float, tx: float, ty: float, tz: float
) -> tuple[float, ...]:
    """Call `friction`; Numba compiles functions of Python into generated code, but no kernels."""
    return friction(state, material, keeps_sliding, normal, tx, ty, tz)


def _read(builder: Any, addresses: Sequence[Any], kind: np.dtype[np.void], lines: int) -> Fields:
    """Read the first cache lines of records."""
    lanes = [field for line in range(lines) for field in read_line(builder, addresses, line)]
    return dict(zip(_names(kind), lanes, strict=False))


def _names(kind: np.dtype[np.void]) -> tuple[str, ...]:
    return kind.names or ()


def _dot(u: Three, v: Three) -> Lanes:
    return u[0] * v[0] + u[1] * v[1] + u[2] * v[2]


def _cross(u: Three, v: Three) -> Three:
    x, y, z = u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]
    return x, y, z
