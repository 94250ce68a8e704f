"""Repeat the last iteration's change of a body's velocities α times; see `line_search`.

A vector holds one line of the body's record. Changing its six fields one by one took twice as long, which cost 1.4 % of
a step of `cloud-collapse`.
"""

from __future__ import annotations

from typing import Any

from numba import types

from carom.physics.aligned import CACHE_LINE
from carom.physics.contact.constraints import BODY_STATE
from carom.physics.contact.solver.block import CHANGE, VELOCITY
from carom.physics.jit.intrinsics import address_in, instruction
from carom.physics.jit.lanes import BIT, DOUBLE, WIDTH, Lanes, mask_of, spread
from carom.physics.jit.record_lanes import line_of

MOTION = 6  # fields of each line: v and ω, or p and t; after them come masses and inertias


@instruction
def repeat_change(typing: Any, bodies: Any, body: Any, alpha: Any) -> Any:
    """Add α p to v and α t to ω of a body, and clear p and t (``dvx`` to ``dwz``)."""
    assert (BODY_STATE.names or ())[MOTION] == "inverse_mass"

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        record = address_in(context, builder, bodies, args[0], args[1:2])
        lines = [line_of(builder, record, line) for line in (VELOCITY, CHANGE)]
        velocity, change = (Lanes(builder, builder.load(line, align=CACHE_LINE)) for line in lines)
        moves = mask_of(builder, [BIT(field < MOTION) for field in range(WIDTH)])
        moved = velocity + change * spread(builder, args[2])
        builder.store(moved.where(moves, velocity).value, lines[0], align=CACHE_LINE)
        builder.store(spread(builder, DOUBLE(0.0)).where(moves, change).value, lines[1], align=CACHE_LINE)
        return context.get_dummy_value()

    return types.void(bodies, types.intp, types.float64), generate
