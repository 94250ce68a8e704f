"""Many steps of few bodies in one kernel, as long as no event needs Python.

A step of three bodies takes 80 ns in a kernel. If Python calls a kernel for each part of the step, it takes 10 µs, and
nearly 200 µs with contacts. `KickDriftStepper` therefore leaves the steps up to the next frame or check to this kernel.
While nothing touches, its contact stages are the functions of `open_gaps`; while the same contacts last, they are the
functions of `contact.events.steady_contacts`. Single steps use the same kernels to choose dt, rotate, kick, drift and
resolve, in the same order, so the bits are the same.

A step that Python must process is undone and left to `KickDriftStepper`: a step in which something may begin to touch
or contacts change, or a step that is too short to change the clock.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np

from carom.arrays import FloatArray, RecordArray, dtype_of
from carom.physics.contact.reactions import NO_SUPPORT
from carom.physics.diagnostics.run_monitor import remembered
from carom.physics.forces.field import add
from carom.physics.forces.gravity.direct import MAX_IN_ONE_BLOCK, sum_few
from carom.physics.forces.kernel_forces import Parameters, add_forces
from carom.physics.integrators.kick_drift import (
    KickedBodies,
    advance,
    book_exchange,
    damped_step,
    kick_after_drift,
    kick_before_drift,
    measure_hold,
    wrap_rows,
)
from carom.physics.jit.by_address import by_address
from carom.physics.jit.decorators import entry_of, inline, inner, long_kernel
from carom.physics.open_gaps import (
    TOTALS,
    UNTESTED,
    KeptState,
    MovedState,
    Totals,
    can_drift,
    conclude,
    copy_records,
    find,
    hold,
    resolve,
    rotate,
    write_support,
)
from carom.physics.step_rule import END, FIXED, LIMIT_NAMES, LimitsRecord, RuleRecord, smooth_and_cut, target
from carom.physics.time_step import Timestep
from carom.physics.vector import is_periodic, write
from carom.physics.world import World
from carom.plan.auto import integrator

if TYPE_CHECKING:  # `physics.jit.cache` also follows these imports
    import carom.physics.contact.events.steady_contacts  # noqa: F401 - its stages are compiled into the kernel
    from carom.physics.contact.events.steady_data import SteadyContacts
    from carom.physics.forces.drag import DragLaw

MOST_STEPS = 20_000  # steps in one call, a few milliseconds: `Space.stop` and the progress line wait for its end


class PlanRecord(Protocol):
    """Constants of the steps and their forces."""

    fixed_dt: float  # s, length of fixed steps; 0 if a rule sets the steps
    accelerates: bool  # whether any force acts
    attracts: bool  # whether bodies attract each other
    constant: float  # m³/(kg s²), G
    softening_squared: float  # m²
    ends_with_forces: bool
    touches: bool  # whether contacts are possible
    field: float  # m/s², magnitude of the uniform acceleration


PLAN = dtype_of(PlanRecord)


class FlightLaws(NamedTuple):
    """The forces and rules of the steps."""

    plan: RecordArray[PlanRecord]  # (1,)
    substeps: FloatArray  # (s, 3) fractions of the step: first kick, drift, last kick
    uniform: FloatArray  # (f, 3) m/s², uniform acceleration of each force that has one
    rule: RecordArray[RuleRecord]  # (1,)
    forces: Parameters  # parameters of forces from installed packages
    damping: DragLaw | tuple[()]  # parameters of the force that depends on velocities; empty if no force does


class FlightClock(NamedTuple):
    """The start and the end of the steps."""

    time: float  # s
    end: float  # s, end of the run
    until: float  # s, time that the last step reaches or passes
    most: int  # largest number of steps
    average: float  # s, moving average of the step
    step: int  # number of the last step
    stops_before: bool  # whether to stop before the step that reaches `until`, since a schedule reads the state there


class FlightBuffers(NamedTuple):
    """Workspace of the steps."""

    limits: RecordArray[LimitsRecord]  # buffer for the limits of the step; see `Timestep.buffer`
    potential: FloatArray  # (n,)
    saved: FloatArray  # (3, n, 3) positions, velocities and accelerations before a step


class Flight(NamedTuple):
    """Steps taken in one call."""

    steps: int
    before: float  # s, time before the last step
    time: float  # s, time after the last step
    dt: float  # s, length of the last step
    limit: str  # the limit that set the length of the step
    impact_energy: float  # J, energy of recent impacts before the last step; see `Activity`


class FewBodies:
    """Takes the steps of a world in which nothing touches; `arguments` are the kernel's arguments after the clock."""

    def __init__(self, world: World, timestep: Timestep) -> None:
        forces, chosen = world.forces.laws, integrator(world.scene)
        assert forces is not None, "a kernel can sum these forces"
        bodies, planes = world.bodies, world.planes
        self._timestep = timestep
        plans = np.zeros(1, PLAN)
        plan = plans[0]
        plan["fixed_dt"], plan["accelerates"] = timestep.fixed_dt or 0.0, world.needs.accelerates
        plan["attracts"], plan["constant"] = forces.attracts, forces.constant
        plan["softening_squared"] = forces.softening * forces.softening
        plan["ends_with_forces"], plan["touches"] = chosen.ends_with_forces, world.contact is not None
        plan["field"] = np.sqrt((world.forces.uniform**2).sum())
        turning = bodies.orientation, bodies.angular_velocity
        moved = MovedState(bodies.position, bodies.velocity, bodies.acceleration, *turning)
        self.arguments = (
            FlightLaws(plans, np.array(chosen.substeps), forces.uniform, timestep.rule, forces.others, forces.damping),
            moved,
            KeptState(
                *(bodies.radius, bodies.mass, bodies.ends.inverse_mass, NO_SUPPORT, timestep.field),
                *(world.box, planes.normal, planes.offset),
            ),
            FlightBuffers(timestep.buffer(bodies), np.empty(len(bodies)), np.empty((3, len(bodies), 3))),
        )
        self._totals = np.zeros(1, TOTALS)
        clock = FlightClock(0.0, 0.0, 0.0, 0, 0.0, 0, False)
        self._fly: Callable[..., tuple[Any, ...]] = entry_of(take_steps, clock, *self.arguments, (), self._totals)

    def take(
        self,
        time: float,
        end: float,
        until: float,
        most: int,
        impact_energy: float = 0.0,
        *,
        stops_before: bool = False,
    ) -> Flight:
        """Take steps until a time or a number of steps is reached, the run ends, or something may touch.

        Times are in s. The last step is cut to end at ``end``, but not at ``until``. With ``stops_before``, the step
        that reaches ``until`` or ``end`` is not taken. ``impact_energy`` (J) is the energy of recent impacts.
        """
        timestep, totals = self._timestep, self._totals
        clock = FlightClock(time, end, until, min(most, MOST_STEPS), timestep.previous, 0, stops_before)
        totals["impact_energy"] = impact_energy
        steps, before, time, dt, limit, timestep.previous = self._fly(clock, *self.arguments, (), totals)
        return Flight(steps, before, time, dt, LIMIT_NAMES[limit], float(totals["impact_energy"][0]))


def can_fly(world: World) -> bool:
    """Return whether a world has few enough bodies, and only forces that a kernel can sum."""
    return (
        len(world.bodies) <= MAX_IN_ONE_BLOCK
        and world.forces.laws is not None
        and not any(part.needs_every_step for part in world.parts)
        and not world.planes.has_facets  # only single steps find the facets near a body
        and world.scene.expect.contact_audit is None  # the audit needs every kick
        and not (world.is_periodic and world.contact is None)  # only single steps refuse too many crossings
    )


@long_kernel
def take_steps(
    clock: FlightClock,
    laws: FlightLaws,
    moved: MovedState,
    kept: KeptState,
    buffers: FlightBuffers,
    contacts: SteadyContacts | tuple[()],
    totals: Totals,
) -> tuple[int, float, float, float, int, float]:
    """Take steps; return their number, the times before and after the last step, its length and limit, and the average.

    ``contacts`` last during all steps; an empty tuple means that nothing touches.
    """
    contacts = by_address(contacts)
    time, end, until, most, average, number, stops_before = clock
    substeps, box, saved = laws.substeps, kept.box, buffers.saved
    position, velocity, acceleration, orientation, angular_velocity = moved
    P, T, n, last = laws.plan[0], totals[0], len(position), len(substeps) - 1
    kicked = KickedBodies(position, velocity, acceleration, kept.mass, kept.inverse_mass)
    before, dt, limit, steps = time, P.fixed_dt, FIXED, 0
    energy, holds, room = T.impact_energy, T.last_kick > 0.0, UNTESTED
    while steps < most and limit != END and (time < until or steps == 0):
        write_support(contacts, totals)
        length, why, following = _choose_step(laws, moved, kept, buffers, average, end - time)
        after = end if why == END else time + length
        if not after > time or (stops_before and (why == END or after >= until)):
            break
        if P.touches:
            _copy_state(position, velocity, acceleration, saved[0], saved[1], saved[2])
            copy_records(contacts, False)
        is_done = True
        for s in range(len(substeps)):
            first_kick, drift, last_kick = substeps[s, 0] * length, substeps[s, 1] * length, substeps[s, 2] * length
            damped = damped_step(laws.damping, length, first_kick, last_kick)
            if P.accelerates and first_kick != 0.0:
                kick_before_drift(laws.damping, kicked, damped, holds)
            if P.touches:
                is_done = hold(contacts, totals, damped)
                if holds:
                    measure_hold(laws.damping, kicked, damped)
                if is_done:
                    is_done, room = can_drift(contacts, totals, damped, moved, kept, P.field, drift, room)
                if not is_done:
                    break
            advance(0, n, position, velocity, drift)
            is_done = find(contacts, totals, damped)
            if not is_done:
                break
            if is_periodic(box):
                wrap_rows(0, n, position, box)
            if P.accelerates and (s < last or P.ends_with_forces):
                _sum_accelerations(laws, moved, kept, buffers)
            if P.accelerates and last_kick != 0.0:
                kick_after_drift(laws.damping, kicked, damped)
            is_done = resolve(contacts, totals, damped)
            if not is_done:
                break
            book_exchange(laws.damping)
        if not is_done:
            _copy_state(saved[0], saved[1], saved[2], position, velocity, acceleration)
            copy_records(contacts, True)
            break
        rotate(contacts, orientation, angular_velocity, length)
        before, time, dt, limit, average = time, after, length, why, following
        if steps > 0:
            energy = remembered(energy, 0.0)
        steps += 1
        conclude(contacts, totals, length, number + steps, time)
    T.impact_energy = energy
    return steps, before, time, dt, limit, average


@inline
def _choose_step(
    laws: FlightLaws, moved: MovedState, kept: KeptState, buffers: FlightBuffers, average: float, remaining: float
) -> tuple[float, int, float]:
    """Choose a step, given the time left; return its length, its limit, and the new average. All times in s."""
    P, R = laws.plan[0], laws.rule[0]
    if P.fixed_dt > 0.0:
        length, limit, _ = smooth_and_cut(P.fixed_dt, FIXED, 1.0, 0.0, remaining)
        return length, limit, average
    x, v, a = moved.position, moved.velocity, moved.acceleration
    bodies = x, v, a, kept.radius, kept.mass, kept.inverse_mass
    length, limit = target(laws.rule, bodies, kept.supported, kept.field, buffers.limits, False)
    return smooth_and_cut(length, limit, R.smoothing, average, remaining)


@inline
def _sum_accelerations(laws: FlightLaws, moved: MovedState, kept: KeptState, buffers: FlightBuffers) -> None:
    """Write the accelerations at the present positions."""
    P, acceleration, n = laws.plan[0], moved.acceleration, len(moved.position)
    if P.attracts:
        sum_few(moved.position, kept.mass, P.constant, P.softening_squared, acceleration, buffers.potential)
    else:
        for i in range(n):
            write(acceleration, i, 0.0, 0.0, 0.0)
    for part in range(len(laws.uniform)):
        add(0, n, acceleration, laws.uniform[part])
    add_forces(laws.forces, 0, n, moved.position, kept.mass, kept.box, acceleration)
    for i in range(n):
        if kept.inverse_mass[i] == 0.0:
            write(acceleration, i, 0.0, 0.0, 0.0)


@inner
def _copy_state(
    x: FloatArray, v: FloatArray, a: FloatArray, to_x: FloatArray, to_v: FloatArray, to_a: FloatArray
) -> None:
    """Copy positions, velocities and accelerations, (n, 3) each."""
    for i in range(len(x)):
        for k in range(3):
            to_x[i, k], to_v[i, k], to_a[i, k] = x[i, k], v[i, k], a[i, k]
