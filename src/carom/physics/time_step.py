"""The adaptive step, chosen from the state at its beginning.

    dt_a = √(2 target_dx / |a|max)                       no acceleration moves a body from rest further than target_dx
    dt_v = min_i 2 s_i / (u_i + √(u_i² + 2 |a_i| s_i))   no body moves further than s_i = cfl · r_i
    dt_p = pull_fraction · τ                             τ, the shortest time scale of gravity, see `pull_time`
    dt   = min(dt_a, dt_v, dt_p, max_dt)                 smoothed by a moving average where it grows

    dt_h = min(√(2 held_dx / b_max), 0.01 min r_i/u_i)  in place of dt_a, if longer, for bodies that contacts hold

By default the first two apply where bodies can touch, and the third where they cannot.

dt_v solves u dt + ½ |a| dt² = s. Speeds u_i = |v_i - V| are relative to the centre of mass, and accelerations exclude
the uniform field, so a scene that moves or falls as a whole gets the same steps. If there are planes, walls or fixed
bodies, speeds are relative to them and the field counts. The reference engine ignores the acceleration, uses absolute
speeds, and takes the radius of the *fastest* body only, so a small body that is a little slower tunnels; that limit is
kept as "fastest-body". The reference engine also smooths in both directions, but a smoothed decrease breaks the bound
that a limit guarantees. Here a decrease takes effect at once.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from carom.physics.bodies import Bodies
from carom.physics.contact.support import NOTHING_BORNE
from carom.physics.diagnostics.momentum import centre_velocity
from carom.physics.parallel.jit import kernel, long_kernel
from carom.physics.parallel.thread_team import SOLO, Team
from carom.physics.pull_time import PullTime
from carom.plan.step_limits import HELD_PART, StepLimits
from carom.scene.schema import Scene, Time

FloatArray = NDArray[np.float64]
Records = NDArray[np.void]

BODIES_PER_BLOCK = 1000  # about 10 µs
MIN_SHARED_BLOCKS = 10
BORNE = 0.5  # of its acceleration; a body counts as held if contacts bear at least this part
END_TOLERANCE = 1e-9  # part of a step; a last step shorter than this is merged into the one before


LIMITS = np.dtype(
    [
        (name, np.float64)
        for name in (
            "largest_acceleration",  # m/s²
            "largest_free_acceleration",  # m/s², of bodies that contacts do not hold
            "largest_borne",  # m/s², largest acceleration that contacts bear
            "velocity_step",  # s, dt_v of every body; infinite at rest
            "fastest_step",  # s, dt_v of the fastest body
            "fastest_squared",  # m²/s², its speed
            "held_time",  # s, shortest time in which a held body moves by its radius
        )
    ]
)


class Limits(NamedTuple):
    """The limits that the bodies set, as in `LIMITS`."""

    largest_acceleration: float = 0.0
    largest_free_acceleration: float = 0.0
    largest_borne: float = 0.0
    velocity_step: float = math.inf
    fastest_step: float = math.inf
    held_time: float = math.inf


NO_LIMITS = Limits()


class Timestep:
    """Chooses each step and keeps the moving average.

    Parameters
    ----------
    time
        The scene's section.
    cfl, target_dx, pull
        Limits of the step besides ``max_dt``; ``target_dx`` in m; None for no limit.
    smoothing
        Weight of the new step in the average.
    held_dx
        m, replaces ``target_dx`` for bodies that lasting contacts hold; None if it does not.
    held_part
        Of its own radius that such a body may move in a step.
    field
        (3,) m/s², the uniform field, if it accelerates all bodies alike; otherwise zeros.
    anchored
        Whether something is fixed: speeds are then relative to it.
    team
        Threads that find the limits.
    """

    def __init__(
        self,
        time: Time,
        cfl: float | None,
        target_dx: float | None,
        field: FloatArray,
        anchored: bool = False,
        team: Team = SOLO,
        *,
        pull: PullTime | None = None,
        smoothing: float = 1.0,
        held_dx: float | None = None,
        held_part: float = HELD_PART,
    ) -> None:
        self._time = time
        self._cfl = cfl
        self._target_dx = target_dx
        self._pull = pull
        self._smoothing = smoothing
        self._held_dx = held_dx
        self._held_part = held_part
        self._field = field
        self._anchored = anchored
        self._team = team
        self.previous = 0.0  # s, the average; 0 until there is one

    @classmethod
    def of(cls, scene: Scene, limits: StepLimits, bodies: Bodies, field: FloatArray, team: Team) -> Timestep:
        """Make the rule of a scene with these limits; ``field`` as above."""
        fraction = limits.pull_fraction
        return cls(
            scene.time.model_copy(update={"max_dt": limits.max_dt}),
            limits.cfl,
            limits.target_dx,
            field,
            scene.anchored,
            team,
            pull=None if fraction is None else PullTime(scene.gravity, fraction, bodies),
            smoothing=limits.smoothing,
            held_dx=limits.held_dx,
            held_part=limits.held_part,
        )

    @property
    def spares_held(self) -> bool:
        """Whether the choice depends on what contacts bear."""
        return self._held_dx is not None

    def choose(self, bodies: Bodies, remaining: float, borne: FloatArray = NOTHING_BORNE) -> tuple[float, str]:
        """Choose the next step.

        Parameters
        ----------
        remaining
            s, until the run ends; the last step is cut to end there.
        borne
            (n + p,) m/s², the part of each acceleration that lasting contacts bear; empty if none do.

        Returns
        -------
        dt, limit
            s, and the limit that set it: "acceleration", "held" (bodies that contacts hold), "velocity", "pull", "cap",
            "growth" (the average), "fixed" or "end".
        """
        if self._time.fixed_dt is not None:
            dt, limit = self._time.fixed_dt, "fixed"
        else:
            dt, limit = self._adaptive(bodies, borne)
        if remaining <= dt * (1.0 + END_TOLERANCE):
            return remaining, "end"
        return dt, limit

    def _adaptive(self, bodies: Bodies, borne: FloatArray) -> tuple[float, str]:
        target, limit = self.target(bodies, borne)
        if 0.0 < self.previous < target:
            smoothed = self.previous + self._smoothing * (target - self.previous)
            target, limit = smoothed, limit if self._smoothing == 1.0 else "growth"
        self.previous = target
        return target, limit

    def first(self, bodies: Bodies, borne: FloatArray = NOTHING_BORNE) -> float:
        """Return the first step of a run that begins with the present state, in s."""
        return self._time.fixed_dt or self.target(bodies, borne)[0]

    def target(self, bodies: Bodies, borne: FloatArray = NOTHING_BORNE) -> tuple[float, str]:
        """Return the step that the limits allow, before smoothing, and the limit that set it."""
        dt, limit = self._time.max_dt, "cap"
        idle = self._target_dx is None and self._cfl is None and (self._pull is None or self._pull.of_pairs)
        limits = NO_LIMITS if idle else self._limits(bodies, borne)
        if self._cfl is not None:
            fastest_body = self._time.velocity_limit == "fastest-body"
            dt_v = limits.fastest_step if fastest_body else limits.velocity_step
            dt, limit = (dt_v, "velocity") if dt_v < dt else (dt, limit)
        if self._target_dx is not None and limits.largest_acceleration > 0.0:
            dt_a, why = self._of_acceleration(self._target_dx, limits)
            dt, limit = (dt_a, why) if dt_a < dt else (dt, limit)
        if self._pull is not None:
            dt_p = self._pull.step(bodies, limits.largest_acceleration)
            dt, limit = (dt_p, "pull") if dt_p < dt else (dt, limit)
        return dt, limit

    def _of_acceleration(self, dx: float, limits: Limits) -> tuple[float, str]:
        """Return the step that the accelerations allow, and the name of the limit."""
        a_max, a_free = limits.largest_acceleration, limits.largest_free_acceleration
        dt_a = math.sqrt(2.0 * dx / a_max)
        if self._held_dx is None or a_free == a_max:
            return dt_a, "acceleration"
        dt_free = math.sqrt(2.0 * dx / a_free) if a_free > 0.0 else math.inf
        by_load = math.sqrt(2.0 * self._held_dx / max(a_max, limits.largest_borne))
        dt_held = max(dt_a, min(by_load, self._held_part * limits.held_time))
        return (dt_free, "acceleration") if dt_free < dt_held else (dt_held, "held")

    def _limits(self, bodies: Bodies, borne: FloatArray) -> Limits:
        """Find the limits that all bodies set."""
        blocks, velocity, anchored = -(-len(bodies) // BODIES_PER_BLOCK), bodies.velocity, self._anchored
        state = velocity, bodies.acceleration, bodies.radius, borne, self._field, self._cfl or 1.0
        if self._team.size == 1 or blocks < MIN_SHARED_BLOCKS:
            return Limits(*_limits(*state, bodies.mass, anchored))
        V = (0.0, 0.0, 0.0) if anchored else centre_velocity(velocity, bodies.mass)
        found = np.empty(blocks, LIMITS)
        self._team.divide(blocks, 1, _look, *state, *V, found)
        return Limits(*_strictest(found))


@kernel
def _limits(
    velocity: FloatArray,
    acceleration: FloatArray,
    radius: FloatArray,
    borne: FloatArray,
    field: FloatArray,
    cfl: float,
    mass: FloatArray,
    anchored: bool,
) -> tuple[float, float, float, float, float, float]:
    """Find the limits that all bodies set, in one call: with few bodies, a step spends its time on calls."""
    Vx, Vy, Vz = (0.0, 0.0, 0.0) if anchored else centre_velocity(velocity, mass)
    found = np.empty(-(-len(mass) // BODIES_PER_BLOCK), LIMITS)
    _look(0, len(found), velocity, acceleration, radius, borne, field, cfl, Vx, Vy, Vz, found)
    return _strictest(found)


@long_kernel
def _look(
    lo: int,
    hi: int,
    velocity: FloatArray,
    acceleration: FloatArray,
    radius: FloatArray,
    borne: FloatArray,
    field: FloatArray,
    cfl: float,
    Vx: float,
    Vy: float,
    Vz: float,
    found: Records,
) -> None:
    """Write the limits that the bodies of the blocks from lo to hi set."""
    for block in range(lo, hi):
        a_max, v2_max, fastest, every, a_free, turn, b_max = 0.0, 0.0, np.inf, np.inf, 0.0, np.inf, 0.0
        for i in range(block * BODIES_PER_BLOCK, min((block + 1) * BODIES_PER_BLOCK, len(radius))):
            ax, ay, az = acceleration[i, 0] - field[0], acceleration[i, 1] - field[1], acceleration[i, 2] - field[2]
            a = np.sqrt(ax * ax + ay * ay + az * az)
            a_max = max(a_max, a)
            vx, vy, vz = velocity[i, 0], velocity[i, 1], velocity[i, 2]
            ux, uy, uz = vx - Vx, vy - Vy, vz - Vz
            u = np.sqrt(ux * ux + uy * uy + uz * uz)
            if len(borne) > 0:
                b_max = max(b_max, borne[i])
            if len(borne) > 0 and borne[i] >= BORNE * a:
                turn = min(turn, radius[i] / u) if u > 0.0 else turn
            else:
                a_free = max(a_free, a)
            s = cfl * radius[i]
            every = min(every, 2.0 * s / (u + np.sqrt(u * u + 2.0 * a * s)))
            v2 = vx * vx + vy * vy + vz * vz
            if v2 > v2_max:
                v2_max, fastest = v2, s / np.sqrt(v2)
        limits = found[block]
        limits.largest_acceleration, limits.largest_free_acceleration, limits.largest_borne = a_max, a_free, b_max
        limits.velocity_step, limits.held_time = every, turn
        limits.fastest_step, limits.fastest_squared = fastest, v2_max


@kernel
def _strictest(found: Records) -> tuple[float, float, float, float, float, float]:
    """Return the fields of `Limits` over all blocks; one body sets each, so the division does not matter."""
    a_max, a_free, b_max, every, fastest, v2_max, turn = 0.0, 0.0, 0.0, np.inf, np.inf, 0.0, np.inf
    for block in range(len(found)):
        limits = found[block]
        a_max = max(a_max, limits.largest_acceleration)
        a_free, b_max = max(a_free, limits.largest_free_acceleration), max(b_max, limits.largest_borne)
        every, turn = min(every, limits.velocity_step), min(turn, limits.held_time)
        if limits.fastest_squared > v2_max:
            v2_max, fastest = limits.fastest_squared, limits.fastest_step
    return a_max, a_free, b_max, every, fastest, turn
