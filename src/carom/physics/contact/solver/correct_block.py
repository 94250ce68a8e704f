"""The position correction of a block of contacts between bodies; see `position_correction`."""

from __future__ import annotations

from typing import Any

from numba import types
from numba.core import cgutils

from carom.physics.contact.constraints import CONTACT_STATE, PUSHED_BODY, RECORDED
from carom.physics.contact.geometry import normal_and_distance
from carom.physics.contact.law import restitution
from carom.physics.contact.solver.block import Block
from carom.physics.contact.solver.overlap_push import (
    ENOUGH,
    ENOUGH_AS_NEEDED,
    gain_of,
    push_of,
    relative_change_of_vt,
    separates,
)
from carom.physics.contact.solver.pushed_body import NEVER
from carom.physics.contact.solver.velocity import velocity_along
from carom.physics.jit.intrinsics import instruction
from carom.physics.jit.lanes import DOUBLE, WORD, Lanes, Mask, at_least, gathered, in_lanes, spread

AMOUNTS = 1  # line of `CONTACT_STATE` that has the ledger, the pushes and the flags


@instruction
def correct_block(typing: Any, system: Any, first: Any, again: Any) -> Any:
    """Push the contacts between bodies of a block apart once; return 1 if an overlap needs another iteration.

    Otherwise return ``again``. Contacts with planes are left out.
    """

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        result = cgutils.alloca_once_value(builder, args[2])  # type: ignore[no-untyped-call]
        _Correction(Block(context, builder, system, *args[:2])).correct(result)
        return builder.load(result)

    return types.float64(system, types.intp, types.float64), generate


class _Correction:
    """Generates the code that corrects a block."""

    def __init__(self, block: Block) -> None:
        self._block, self._builder = block, block.builder

    def correct(self, result: Any) -> None:
        """Push apart the contacts that overlap, are at rest, and have an end that the last iteration pushed.

        Store 1 at the address ``result`` if one of them needs another iteration.
        """
        visited = self._visited()
        with self._builder.if_then(visited.any):
            self._block.fetch_bodies_ahead("pushed", (0,))
            self._a, self._b = a, b = self._block.bodies("pushed", PUSHED_BODY, (0,))
            *self._n, self._d = in_lanes(normal_and_distance)(b.x - a.x, b.y - a.y, b.z - a.z)
            reach = a.radius + b.radius
            overlap = reach - self._d
            overlaps = visited & (overlap > 0.0)
            with self._builder.if_then(overlaps.any):
                pushed = self._push(overlap, overlaps)
                with self._builder.if_then((pushed & (overlap > self._enough * reach)).any):
                    self._builder.store(DOUBLE(1.0), result)

    def _visited(self) -> Mask:
        """Return the contacts between bodies of which the last iteration pushed an end; all of them in the first."""
        builder, block = self._builder, self._block
        iteration = block.number("iteration")
        is_first = builder.icmp_signed("==", iteration, WORD(0))
        since = builder.select(is_first, WORD(NEVER), builder.sub(iteration, WORD(1)))
        last = [[builder.load(block.address("pushed_in", body)) for body in end] for end in block.ends]
        i, j = (at_least(builder, end, since) for end in last)
        return (i | j) & block.between_bodies

    def _push(self, overlap: Lanes, overlaps: Mask) -> Mask:
        """Push apart the contacts at rest among those that overlap; return them.

        Contacts that are not pushed are written, too, with unchanged bits: a branch for each would often be
        mispredicted. Fixed bodies are not written, since pieces of other threads may share them.
        """
        a, b, block, n, d = self._a, self._b, self._block, self._n, self._d
        states = block.records("states", CONTACT_STATE, (AMOUNTS,))
        rest_speed = states.field("rest_speed")
        vn, *t = in_lanes(velocity_along)(*n, a, b)
        pushed: Mask = overlaps & ~in_lanes(separates)(vn, rest_speed, self._restitution(-vn, rest_speed))

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
        states.change(
            push_x=states.push_x + of_pushed(delta * n[0]),
            push_y=states.push_y + of_pushed(delta * n[1]),
            push_z=states.push_z + of_pushed(delta * n[2]),
            stabilisation_gain=states.stabilisation_gain + of_pushed(in_lanes(gain_of)(reduced, *t, sigma)),
        )
        states.write(AMOUNTS)
        with self._builder.if_then(self._builder.icmp_signed(">", block.count("recorded"), WORD(0))):
            x, y, z = (reduced * sigma * along for along in t)
            recorded = block.records("recorded", RECORDED, ())
            recorded.add_to(pushed, correction_x=x, correction_y=y, correction_z=z)
        return pushed

    def _restitution(self, approach: Lanes, rest_speed: Lanes) -> Lanes:
        """Return the restitution of each contact by the law."""
        builder, context, block = self._builder, self._block.context, self._block
        signature: Any = types.float64(block.kind_of("materials").dtype, types.float64, types.float64)
        found = []
        for k, material in enumerate(block.materials()):
            given = [material, approach.lane(k), rest_speed.lane(k)]
            found.append(context.compile_internal(builder, _restitution_of_one, signature, given))
        return gathered(builder, found)

    def _note(self, ends: list[Any], pushed: Mask, moving: Mask) -> None:
        """Note the iteration in which moving ends were pushed."""
        builder, block = self._builder, self._block
        iteration = block.number("iteration")
        places = [block.address("pushed_in", end) for end in ends]
        notes = [builder.select(pushed.bit(k), iteration, builder.load(place)) for k, place in enumerate(places)]
        moving.in_each(lambda k: builder.store(notes[k], places[k]))

    @property
    def _enough(self) -> Lanes:
        """The overlap that needs no further iteration, over the sum of radii."""
        builder = self._builder
        as_needed, by_rounding = (DOUBLE(part) for part in (ENOUGH_AS_NEEDED, ENOUGH))
        return spread(builder, builder.select(self._block.flag("as_needed"), as_needed, by_rounding))


def _restitution_of_one(material: Any, approach: float, rest_speed: float) -> float:
    """Call the law: ``compile_internal`` takes a plain function of Python, not a kernel."""
    return restitution(material, approach, rest_speed)
