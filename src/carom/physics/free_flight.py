"""Many steps of few bodies in one kernel, as long as nothing happens that Python has to see.

A step of three bodies takes 80 ns in a kernel, and ten microseconds where Python calls a kernel for each of its
parts. `KickDriftStepper` therefore hands over the steps up to the next frame or check. They choose dt, kick, drift and
turn by the same kernels in the same order, so the bits are those of single steps. A step that the flight cannot take is
left to `KickDriftStepper`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from carom.physics.contact.support import NOTHING_BORNE
from carom.physics.forces.gravity.direct import FEW, pull_few
from carom.physics.forces.uniform_field import add
from carom.physics.integrators.kick_drift import advance
from carom.physics.parallel.jit import long_kernel
from carom.physics.rotation import turn
from carom.physics.step_rule import END, FIXED, LIMIT_NAMES, chosen, ends_run
from carom.physics.time_step import Timestep
from carom.physics.world import World
from carom.plan.auto import integrator

FloatArray = NDArray[np.float64]
Records = NDArray[np.void]

MOST_STEPS = 20_000  # in one call, some milliseconds: `Space.stop` and the progress line wait for its end

PLAN = np.dtype(
    [
        ("fixed_dt", np.float64),  # s; 0 for the steps of a rule
        ("pulls", np.bool_),  # whether there is a force
        ("attracts", np.bool_),  # whether bodies pull each other
        ("constant", np.float64),  # m³/(kg s²), G
        ("softening_squared", np.float64),  # m²
        ("is_uniform", np.bool_),  # whether there is a uniform field
        ("ends_with_forces", np.bool_),
    ]
)


class Flight(NamedTuple):
    """Steps that were taken in one call."""

    steps: int
    before: float  # s, time before the last one
    time: float  # s, time after it
    dt: float  # s, its length
    limit: str  # what set it


class FreeFlight:
    """Takes many steps of a world in which no contact is possible.

    Parameters
    ----------
    world
        What is advanced.
    timestep
        Chooses the steps.
    """

    def __init__(self, world: World, timestep: Timestep) -> None:
        pull, chosen = world.forces.few, integrator(world.scene)
        assert pull is not None, "the forces are known"
        self._bodies = world.bodies
        self._timestep = timestep
        self._substeps = np.array(chosen.substeps)
        self._uniform = pull.uniform
        self._potential = np.empty(len(world.bodies))
        self._plan = np.zeros(1, PLAN)
        plan = self._plan[0]
        plan["fixed_dt"], plan["pulls"] = timestep.fixed_dt or 0.0, world.needs.pulls
        plan["attracts"], plan["constant"] = pull.attracts, pull.constant
        plan["softening_squared"] = pull.softening * pull.softening
        plan["is_uniform"], plan["ends_with_forces"] = pull.is_uniform, chosen.ends_with_forces

    def take(self, time: float, end: float, until: float, most: int) -> Flight:
        """Take steps until a time is reached, the run ends, or the number of steps is reached.

        Parameters
        ----------
        time, end, until
            s; the last step is cut to end at ``end``, but not at ``until``.
        most
            Steps; none are taken if the first one would not move the clock.
        """
        bodies, timestep = self._bodies, self._timestep
        moved = bodies.position, bodies.velocity, bodies.acceleration, bodies.orientation, bodies.angular_velocity
        kept = bodies.radius, bodies.mass, bodies.ends.inverse_mass, NOTHING_BORNE, timestep.field
        clock = time, end, until, min(most, MOST_STEPS), timestep.previous
        room = timestep.room(bodies), self._potential
        steps, before, time, dt, limit, timestep.previous = _fly(
            self._plan, self._substeps, self._uniform, timestep.rule, *clock, *moved, *kept, *room
        )
        return Flight(steps, before, time, dt, LIMIT_NAMES[limit])


def can_fly(world: World) -> bool:
    """Tell whether the steps of a world can be taken many at a time."""
    is_audited = world.scene.expect.contact_audit is not None
    return (
        len(world.bodies) <= FEW
        and world.contact is None
        and world.forces.few is not None
        and not world.is_periodic
        and not is_audited
    )


@long_kernel
def _fly(
    plan: Records,
    substeps: FloatArray,
    uniform: FloatArray,
    rule: Records,
    time: float,
    end: float,
    until: float,
    most: int,
    average: float,
    position: FloatArray,
    velocity: FloatArray,
    acceleration: FloatArray,
    orientation: FloatArray,
    angular_velocity: FloatArray,
    radius: FloatArray,
    mass: FloatArray,
    inverse_mass: FloatArray,
    borne: FloatArray,
    field: FloatArray,
    found: Records,
    potential: FloatArray,
) -> tuple[int, float, float, float, int, float]:
    """Take steps; return their number, the time before and after the last one, its length and limit, the average."""
    P, n, last = plan[0], len(mass), len(substeps) - 1
    before, dt, limit, steps = time, P.fixed_dt, FIXED, 0
    while steps < most and limit != END and (time < until or steps == 0):
        if P.fixed_dt > 0.0:
            length, why, following = P.fixed_dt, FIXED, average
            if ends_run(length, end - time):
                length, why = end - time, END
        else:
            length, why, following = chosen(
                *(rule, average, end - time, position, velocity, acceleration, radius, mass, inverse_mass, borne),
                *(field, found, False),
            )
        after = end if why == END else time + length
        if not after > time:
            break
        before, time, dt, limit, average = time, after, length, why, following
        turn(0, len(orientation), orientation, angular_velocity, dt)
        for s in range(len(substeps)):
            first_kick, last_kick = substeps[s, 0] * dt, substeps[s, 2] * dt
            if P.pulls and first_kick != 0.0:
                advance(0, n, velocity, acceleration, first_kick)
            advance(0, n, position, velocity, substeps[s, 1] * dt)
            if P.pulls and (s < last or P.ends_with_forces):
                if P.attracts:
                    pull_few(position, mass, P.constant, P.softening_squared, acceleration, potential)
                else:
                    for i in range(n):
                        for k in range(3):
                            acceleration[i, k] = 0.0
                if P.is_uniform:
                    add(0, n, acceleration, uniform)
                for i in range(n):
                    if inverse_mass[i] == 0.0:
                        for k in range(3):
                            acceleration[i, k] = 0.0
            if P.pulls and last_kick != 0.0:
                advance(0, n, velocity, acceleration, last_kick)
        steps += 1
    return steps, before, time, dt, limit, average
