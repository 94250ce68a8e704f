"""Many steps of few bodies in one kernel, as long as no event needs Python.

A step of three bodies takes 80 ns in a kernel, but ten microseconds if Python calls a kernel for each part of it.
`KickDriftStepper` therefore leaves the steps up to the next frame or check to this module. The same kernels choose dt,
kick, drift and rotate, so the bits are the same as in single steps.

Where bodies can touch, all gaps must stay larger than rounding and than a fall from rest in one step, within which
`contact.pipeline` searches for contacts. Paths are straight, so two bodies approach each other by at most
|v_j - v_i| dt; with drag, v is the mean velocity of the drift. All pairs and planes are tested
again only after the bodies may have moved by half the smallest gap. A step with a possible contact is undone and left
to `KickDriftStepper`, and so is a step too short to change the clock.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np

from carom.arrays import FloatArray, RecordArray, dtype_of
from carom.physics.contact.geometry import height_above
from carom.physics.contact.reactions import NO_SUPPORT
from carom.physics.contact.solver.prepare import TOUCHING
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
    wrap_rows,
)
from carom.physics.jit.decorators import borrowing, entry_of, inline, unowned
from carom.physics.rotation import rotate_one
from carom.physics.step_rule import END, FIXED, LIMIT_NAMES, LimitsRecord, RuleRecord, smooth_and_cut, target
from carom.physics.time_step import Timestep
from carom.physics.vector import is_periodic, minimum_image, square, write
from carom.physics.world import World
from carom.plan.auto import integrator

if TYPE_CHECKING:  # `physics.jit.cache` follows this import, too
    from carom.physics.forces.drag import DragLaw

MOST_STEPS = 20_000  # in one call, some milliseconds: `Space.stop` and the progress line wait for its end
NEAR = 2.0 * TOUCHING  # of the sum of radii; twice the largest gap of bodies that touch
ROUNDING = 2.0**-46  # of the coordinates: 64 times their last digit; the search allows for four of these
GRAIN = 2.0**-50  # of the coordinates, more than the rounding of a drift
BOX_FRACTION = 0.25  # of the smallest side: distance that bodies may move before they are tested again
FAR = 1e150  # m, the smallest gap where there are no pairs


class PlanRecord(Protocol):
    """Constants of the steps and their forces."""

    fixed_dt: float  # s; 0 if a rule sets the steps
    accelerates: bool  # whether there is a force
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
    substeps: FloatArray  # (s, 3) parts of the step: first kick, drift, last kick
    uniform: FloatArray  # (f, 3) m/s², the uniform accelerations by each force that has one
    rule: RecordArray[RuleRecord]  # (1,)
    forces: Parameters  # of installed packages
    damping: DragLaw | tuple[()]  # of the force that depends on velocities; empty without one


class FlightClock(NamedTuple):
    """Where the steps start and end."""

    time: float  # s
    end: float  # s, of the run
    until: float  # s; a step that reaches it is the last
    most: int  # steps
    average: float  # s, the moving average of the step
    impact_energy: float  # J, the energy of recent impacts
    stops_before: bool  # whether the step that reaches `until` is left out, for a schedule that reads the state before


class MovedState(NamedTuple):
    """The state that the steps update."""

    position: FloatArray  # (n, 3) m
    velocity: FloatArray  # (n, 3) m/s
    acceleration: FloatArray  # (n, 3) m/s²
    orientation: FloatArray  # (n, 4) xyzw; no rows where nothing rotates
    angular_velocity: FloatArray  # (n, 3) rad/s; no rows where nothing rotates


class KeptState(NamedTuple):
    """The constants of the steps."""

    radius: FloatArray  # (n,) m
    mass: FloatArray  # (n,) kg
    inverse_mass: FloatArray  # (n + p,) 1/kg
    supported: FloatArray  # empty, since no contact supports an acceleration
    field: FloatArray  # (3,) m/s², the uniform field if it accelerates all bodies alike; otherwise zeros
    box: FloatArray  # (3,) m, zeros in open space
    normal: FloatArray  # (p, 3) of the planes
    offset: FloatArray  # (p,) m


class FlightBuffers(NamedTuple):
    """Workspace of the steps."""

    limits: RecordArray[LimitsRecord]  # for the limits of the step, see `Timestep.buffer`
    potential: FloatArray  # (n,)
    saved: FloatArray  # (3, n, 3) positions, velocities, accelerations before a step


class Flight(NamedTuple):
    """Steps taken in one call."""

    steps: int
    before: float  # s, time before the last step
    time: float  # s, time after it
    dt: float  # s, its length
    limit: str  # what set its length
    impact_energy: float  # J, the energy of recent impacts, see `Activity`, before the last step


class FreeFlight:
    """Takes the steps of a world in which nothing touches; `arguments` are the kernel's, except for the clock."""

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
        self.arguments = (
            FlightLaws(plans, np.array(chosen.substeps), forces.uniform, timestep.rule, forces.others, forces.damping),
            MovedState(bodies.position, bodies.velocity, bodies.acceleration, *turning),
            KeptState(
                *(bodies.radius, bodies.mass, bodies.ends.inverse_mass, NO_SUPPORT, timestep.field),
                *(world.box, planes.normal, planes.offset),
            ),
            FlightBuffers(timestep.buffer(bodies), np.empty(len(bodies)), np.empty((3, len(bodies), 3))),
        )
        clock = FlightClock(0.0, 0.0, 0.0, 0, 0.0, 0.0, False)
        self._fly: Callable[..., tuple[Any, ...]] = entry_of(_fly, clock, *self.arguments)

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
        timestep = self._timestep
        clock = FlightClock(time, end, until, min(most, MOST_STEPS), timestep.previous, impact_energy, stops_before)
        steps, before, time, dt, limit, timestep.previous, impact_energy = self._fly(clock, *self.arguments)
        return Flight(steps, before, time, dt, LIMIT_NAMES[limit], impact_energy)


def can_fly(world: World) -> bool:
    """Return whether a world has few enough bodies, and only forces that a kernel can sum."""
    return (
        len(world.bodies) <= MAX_IN_ONE_BLOCK
        and world.forces.laws is not None
        and not any(part.needs_every_step for part in world.parts)
        and world.scene.expect.contact_audit is None  # the audit needs each kick
        and not (world.is_periodic and world.contact is None)  # only single steps refuse too many crossings
    )


@borrowing
def _fly(
    clock: FlightClock, laws: FlightLaws, moved: MovedState, kept: KeptState, buffers: FlightBuffers
) -> tuple[int, float, float, float, int, float, float]:
    """Take steps; return their number, the times before and after the last, its length and limit, and the averages."""
    time, end, until, most, average, impact_energy, stops_before = clock
    substeps, box, saved = laws.substeps, kept.box, buffers.saved
    position, velocity, acceleration, orientation, angular_velocity = moved
    P, n, last = laws.plan[0], len(position), len(substeps) - 1
    kicked = KickedBodies(position, velocity, acceleration, kept.mass, kept.inverse_mass)
    before, dt, limit, steps = time, P.fixed_dt, FIXED, 0
    slack, gone, grain = 0.0, 0.0, 0.0  # m: the smallest gap at the last test, and how far bodies may have moved since
    while steps < most and limit != END and (time < until or steps == 0):
        length, why, following = choose_step(laws, moved, kept, buffers, average, end - time)
        after = end if why == END else time + length
        if not after > time or (stops_before and (why == END or after >= until)):
            break
        if P.touches:
            copy_state(position, velocity, acceleration, saved[0], saved[1], saved[2])
        is_free = True
        for s in range(len(substeps)):
            first_kick, drift, last_kick = substeps[s, 0] * length, substeps[s, 1] * length, substeps[s, 2] * length
            damped = damped_step(laws.damping, length, first_kick, last_kick)
            strength = damped.path.strength
            if P.accelerates and first_kick != 0.0:
                kick_before_drift(laws.damping, kicked, damped, False)
            if P.touches:
                fastest, largest = _fastest(velocity, acceleration)
                skin = (largest + P.field) * strength * length * length
                if not 2.0 * (gone + fastest * abs(drift) + grain) + skin < slack:
                    slack, grain = _smallest_gap(position, velocity, kept, abs(drift), skin)
                    gone = 0.0
                    is_free = slack > 0.0
                    if not is_free:
                        break
                gone += fastest * abs(drift) + grain
            advance(0, n, position, velocity, drift)
            if is_periodic(box):
                wrap_rows(0, n, position, box)
            if P.accelerates and (s < last or P.ends_with_forces):
                sum_accelerations(laws, moved, kept, buffers)
            if P.accelerates and last_kick != 0.0:
                kick_after_drift(laws.damping, kicked, damped)
                book_exchange(laws.damping)
        if not is_free:
            copy_state(saved[0], saved[1], saved[2], position, velocity, acceleration)
            break
        for i in range(len(orientation)):
            rotate_one(i, orientation, angular_velocity, length)
        if steps > 0:
            impact_energy = remembered(impact_energy, 0.0)
        before, time, dt, limit, average = time, after, length, why, following
        steps += 1
    return steps, before, time, dt, limit, average, impact_energy


@inline
def choose_step(
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
def sum_accelerations(laws: FlightLaws, moved: MovedState, kept: KeptState, buffers: FlightBuffers) -> None:
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


@unowned
def copy_state(
    x: FloatArray, v: FloatArray, a: FloatArray, to_x: FloatArray, to_v: FloatArray, to_a: FloatArray
) -> None:
    """Copy positions, velocities and accelerations, (n, 3) each."""
    for i in range(len(x)):
        for k in range(3):
            to_x[i, k], to_v[i, k], to_a[i, k] = x[i, k], v[i, k], a[i, k]


@unowned
def _fastest(velocity: FloatArray, acceleration: FloatArray) -> tuple[float, float]:
    """Return the largest speed (m/s) and acceleration (m/s²); NaN if any is not finite."""
    v2_max, a2_max, rest = 0.0, 0.0, 0.0
    for i in range(len(velocity)):
        v2, a2 = square(velocity, i), square(acceleration, i)
        v2_max, a2_max = max(v2_max, v2), max(a2_max, a2)
        rest += (v2 - v2) + (a2 - a2)  # 0 or NaN
    return np.sqrt(v2_max) + rest, np.sqrt(a2_max)


@unowned
def _smallest_gap(x: FloatArray, v: FloatArray, kept: KeptState, dt: float, skin: float) -> tuple[float, float]:
    """Return the smallest gap (m), 0 if one may close to the skin in a drift of dt s, and the rounding of a drift."""
    radius, inverse_mass, box, normal, offset = kept.radius, kept.inverse_mass, kept.box, kept.normal, kept.offset
    size = 0.0  # m, of the coordinates
    for i in range(len(x)):
        size = max(size, radius[i], abs(x[i, 0]), abs(x[i, 1]), abs(x[i, 2]))
    for p in range(len(offset)):
        size = max(size, abs(offset[p]))
    smallest = BOX_FRACTION * min(box[0], box[1], box[2]) if is_periodic(box) else FAR
    for i in range(len(x)):
        for j in range(i + 1, len(x)):
            if inverse_mass[i] == 0.0 and inverse_mass[j] == 0.0:
                continue
            d2, u2 = 0.0, 0.0
            for k in range(3):
                d, u = x[j, k] - x[i, k], v[j, k] - v[i, k]
                if box[k] > 0.0:
                    d = minimum_image(d, box[k])
                d2 += d * d
                u2 += u * u
            gap = np.sqrt(d2) - (radius[i] + radius[j]) * (1.0 + NEAR) - ROUNDING * size
            if not gap > np.sqrt(u2) * dt + skin:
                return 0.0, 0.0
            smallest = min(smallest, gap)
        for p in range(len(offset)):
            if inverse_mass[i] == 0.0:
                continue
            rise = 0.0
            for k in range(3):
                rise += normal[p, k] * v[i, k]
            height = height_above(normal, offset, p, x[i, 0], x[i, 1], x[i, 2])
            gap = height - radius[i] * (1.0 + NEAR) - ROUNDING * size
            if not gap > abs(rise) * dt + skin:
                return 0.0, 0.0
            smallest = min(smallest, gap)
    return smallest, GRAIN * (size + smallest)
