"""A block of contacts, solved at once; see `solve`.

The law is called for each contact by itself, so a law needs no second form.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce
from typing import Any

from numba import types

from carom.physics.contact.constraints import BODY_STATE, CONTACT
from carom.physics.contact.solver.block import CHANGE, VELOCITY, Block
from carom.physics.contact.solver.body_state import torque_of
from carom.physics.contact.solver.friction import friction
from carom.physics.contact.solver.velocity import bias_along_arc, relative_velocity, slip
from carom.physics.jit.intrinsics import instruction
from carom.physics.jit.lanes import (
    Lanes,
    added_in_order,
    either,
    gathered,
    greater,
    in_lanes,
    read_doubles,
    spread,
)
from carom.physics.jit.record_lanes import RecordLanes

Vector = Sequence[Lanes]

DOUBLES: Any = types.UniTuple(types.float64, 3)  # type: ignore[no-untyped-call]


@instruction
def solve_block(typing: Any, system: Any, first: Any, found: Any, turning: Any) -> Any:
    """Solve the contacts of a block; return what `solve` ``found`` with theirs. ``turning`` is as in `solve`."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        solution = _Solution(Block(context, builder, system, *args[:2]))
        solution.solve(turns=len(turning) > 0)
        before = [builder.extract_value(args[2], k) for k in range(3)]
        return context.make_tuple(builder, signature.return_type, solution.found(*before))

    return DOUBLES(system, first, found, turning), generate


class _Solution:
    """Generates the code that solves a block."""

    def __init__(self, block: Block) -> None:
        self._block, self._builder, self._held = block, block.builder, block.held

    def solve(self, *, turns: bool) -> None:
        """Change the impulses of the contacts that are held, and the velocities of their bodies."""
        block = self._block
        block.fetch_bodies_ahead("bodies", (VELOCITY, CHANGE))
        contact = block.records("contacts", CONTACT, (0, 1))
        bodies = a, b = block.bodies("bodies", BODY_STATE, (VELOCITY,))
        alpha = block.setting("alpha")
        vn, *u = in_lanes(relative_velocity)(contact, a, b)
        bias = self._bias(contact, u)
        old = contact.normal_impulse + alpha * contact.delta_normal
        normal = greater(0.0, old - (vn + bias) * contact.normal_mass)
        more = normal - old
        contact.change(normal_impulse=normal, delta_normal=more)
        J, torque, largest = [more * contact.nx, more * contact.ny, more * contact.nz], None, abs(more)
        if turns:
            d = self._rub(contact, in_lanes(slip)(contact, a, b, *u), alpha)
            largest = reduce(greater, map(abs, d), largest)
            J = [along + rubbing for along, rubbing in zip(J, d, strict=True)]
            torque = in_lanes(torque_of)(contact, *d)
        self._change = largest * (a.inverse_mass + b.inverse_mass)
        self._normal, self._more, self._slope = normal, more, more * bias
        block.apply(contact, bodies, (VELOCITY, CHANGE), self._held, J, torque)
        contact.write(1, self._held)

    def found(self, change: Any, step_limit: Any, slope: Any) -> list[Any]:
        """Return the largest change, the limit of the step, and the slope, given those before."""
        largest, limit = spread(self._builder, change), spread(self._builder, step_limit)
        small = read_doubles(self._builder, self._block.address("small_change", self._block.places[0]))
        matters = self._held & (self._change > small) & (self._change > largest)
        largest = self._change.where(matters, largest)
        pulling = -self._normal / self._more
        nearer = self._held & (self._more < 0.0) & (pulling < limit)
        limit = pulling.where(nearer, limit)
        slope = added_in_order(self._builder, slope, self._slope.where(self._held, self._block.nothing))
        return [largest.largest(), self._builder.fneg((-limit).largest()), slope]

    def _bias(self, contact: RecordLanes, u: Vector) -> Lanes:
        """Return the biases c, see `bias_along_arc`; they are those along the normal at planes, and without a drift."""
        builder, block, bias = self._builder, self._block, contact.velocity_bias
        between = block.between_bodies

        def along_arc() -> list[Lanes]:
            arc = in_lanes(bias_along_arc)(bias, contact.arm_i + contact.arm_j, *u, block.setting("drift"))
            return [arc.where(between, bias)]

        return either(builder, block.drifts, along_arc, lambda: [bias])[0]

    def _rub(self, contact: RecordLanes, u: Vector, alpha: Lanes) -> list[Lanes]:
        """Change the friction by that which ends the slip u, as far as the law allows; return its change."""
        axes = ("x", "y", "z")
        old = [getattr(contact, f"friction_{axis}") + alpha * getattr(contact, f"delta_{axis}") for axis in axes]
        ending = [before - along * contact.tangent_mass for before, along in zip(old, u, strict=True)]
        friction = self._by_law(contact.normal_impulse, ending)
        d = [after - before for after, before in zip(friction, old, strict=True)]
        for axis, after, change in zip(axes, friction, d, strict=True):
            contact.change(**{f"friction_{axis}": after, f"delta_{axis}": change})
        return d

    def _by_law(self, normal: Lanes, ending: Vector) -> list[Lanes]:
        """Return the friction that the law allows in place of the one that ends the slip, contact by contact."""
        builder, block, context = self._builder, self._block, self._block.context
        records = [block.kind_of(name).dtype for name in ("states", "materials")]
        signature = DOUBLES(*records, types.boolean, *[types.float64] * 4)
        keeps_sliding = block.flag("keeps_sliding")
        found = []
        for k, material in enumerate(block.materials()):
            slides = builder.and_(keeps_sliding, self._held.bit(k))  # contacts that are not held are not marked
            given = [block.address("states", block.places[k]), material, slides]
            numbers = [value.lane(k) for value in (normal, *ending)]
            allowed = context.compile_internal(builder, _friction_of_one, signature, [*given, *numbers])
            found.append([builder.extract_value(allowed, axis) for axis in range(3)])
        return [gathered(builder, [allowed[axis] for allowed in found]) for axis in range(3)]


def _friction_of_one(
    state: Any, material: Any, keeps_sliding: bool, normal: float, tx: float, ty: float, tz: float
) -> tuple[float, ...]:
    """Call `friction`: ``compile_internal`` takes a plain function of Python, not a kernel."""
    return friction(state, material, keeps_sliding, normal, tx, ty, tz)
