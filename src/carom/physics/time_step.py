"""The adaptive step, chosen from the state at its start.

    dt_a = √(2 target_dx / |a|max)                       no acceleration moves a body from rest further than target_dx
    dt_v = min_i 2 s_i / (u_i + √(u_i² + 2 |a_i| s_i))   no body moves further than s_i = cfl · r_i
    dt_p = pull_fraction · τ                             τ, the shortest time scale of gravity, see `step_rule`
    dt   = min(dt_a, dt_v, dt_p, max_dt)                 smoothed by a moving average where it grows

    dt_h = min(√(2 held_dx / max(|a|max, b_max)), held_part · min r_i/u_i)
                                                         replaces dt_a, if it is longer, for bodies held by contacts

By default, dt_a and dt_v apply if bodies can touch, and dt_p if they cannot.

dt_v solves u dt + ½ |a| dt² = s. Speeds u_i = |v_i - V| are relative to the centre of mass, and accelerations exclude
the uniform field, so a scene that moves or falls as a whole takes the same steps. With planes, walls or fixed bodies,
speeds are relative to these, and accelerations include the field. The reference engine (docs/validation.md) ignores the
acceleration, uses absolute speeds, and uses the radius of the *fastest* body only, so a small body that is slightly
slower tunnels. Its limit is available as "fastest-body". The reference engine also smooths decreases, so that its steps
can exceed the limit. In carom a decrease takes effect at once.
"""

from __future__ import annotations

import numpy as np

from carom.arrays import FloatArray, Records
from carom.physics.bodies import Bodies
from carom.physics.contact.reactions import NO_SUPPORT
from carom.physics.diagnostics.momentum import centre_velocity
from carom.physics.jit.team import SOLO, Team
from carom.physics.step_rule import (
    BODIES_PER_BLOCK,
    FIXED,
    LIMIT_NAMES,
    LIMITS,
    RULE,
    find_limits,
    smooth_and_cut,
    target,
)
from carom.plan.auto import PAIRS_UP_TO, StepLimits
from carom.scene.load import Scene
from carom.scene.schema import Time

MIN_SHARED_BLOCKS = 10


class Timestep:
    """Chooses each step and keeps the moving average.

    Parameters
    ----------
    time, limits
        The scene's section ``time``, and the limits of its steps.
    field
        (3,) m/s², the uniform field if it accelerates all bodies alike; otherwise zeros.
    anchored
        Whether something is fixed; speeds are then relative to what is fixed.
    """

    def __init__(
        self, time: Time, limits: StepLimits, field: FloatArray, anchored: bool = False, team: Team = SOLO
    ) -> None:
        self.rule = np.zeros(1, RULE)  # record for `step_rule.target`
        rule = self.rule[0]
        rule["max_dt"], rule["cfl"], rule["target_dx"] = limits.max_dt, limits.cfl or 0.0, limits.target_dx or 0.0
        rule["by_fastest_body"] = time.velocity_limit == "fastest-body"
        rule["held_dx"], rule["held_part"] = limits.held_dx or 0.0, limits.held_part
        rule["smoothing"], rule["anchored"] = limits.smoothing, anchored
        rule["measures_bodies"] = limits.cfl is not None or limits.target_dx is not None
        self.fixed_dt = time.fixed_dt  # s, a constant step; None if limits set the step
        self._smoothing = limits.smoothing
        self.field = field
        self.spares_held = limits.held_dx is not None  # whether the step depends on accelerations that contacts support
        self.previous = 0.0  # s, moving average of the step; 0 before the first
        self._team = team
        self._found = np.empty(0, LIMITS)

    @classmethod
    def of(cls, scene: Scene, limits: StepLimits, bodies: Bodies, field: FloatArray, team: Team) -> Timestep:
        """Return the rule of a scene with these limits, including the limit by gravity."""
        timestep, gravity = cls(scene.time, limits, field, scene.anchored, team), scene.gravity
        if limits.pull_fraction is not None:
            rule, by_pairs = timestep.rule[0], len(bodies) <= PAIRS_UP_TO
            rule["gravity_fraction"], rule["examines_pairs"] = limits.pull_fraction, by_pairs
            rule["measures_bodies"] |= not by_pairs
            rule["constant"], rule["softening"] = gravity.constant, gravity.softening
            rule["mean"] = gravity.constant * float(np.mean(bodies.mass))  # fixed bodies attract others as well
        return timestep

    def choose(self, bodies: Bodies, remaining: float, supported: FloatArray = NO_SUPPORT) -> tuple[float, str]:
        """Return the next step (s), and the limit that set it, one of `LIMIT_NAMES`.

        The last step is cut to end after the remaining time (s). ``supported``, (n + p,) m/s², are the accelerations
        that lasting contacts support; it is empty if there are none.
        """
        if self.fixed_dt is not None:
            dt, limit, _ = smooth_and_cut(self.fixed_dt, FIXED, 1.0, 0.0, remaining)
        else:
            allowed, limit = self._target(bodies, supported)
            dt, limit, self.previous = smooth_and_cut(allowed, limit, self._smoothing, self.previous, remaining)
        return dt, LIMIT_NAMES[limit]

    def first(self, bodies: Bodies, supported: FloatArray = NO_SUPPORT) -> float:
        """Return the first step (s) of a run that starts at the present state."""
        return self.fixed_dt or self.target(bodies, supported)[0]

    def target(self, bodies: Bodies, supported: FloatArray = NO_SUPPORT) -> tuple[float, str]:
        """Return the step that the limits allow, before smoothing, and the limit that set it."""
        dt, limit = self._target(bodies, supported)
        return dt, LIMIT_NAMES[limit]

    def _target(self, bodies: Bodies, supported: FloatArray) -> tuple[float, int]:
        """Return the step and the number of its limit."""
        x, v, a, m = bodies.position, bodies.velocity, bodies.acceleration, bodies.mass
        state = x, v, a, bodies.radius, m, bodies.ends.inverse_mass
        limits = self.buffer(bodies)
        rule, are_known = self.rule[0], self._team.size > 1 and len(limits) >= MIN_SHARED_BLOCKS
        if are_known and rule["measures_bodies"]:
            V = (0.0, 0.0, 0.0) if rule["anchored"] else centre_velocity(v, m)
            discounted = supported, self.field
            self._team.divide(len(limits), 1, find_limits, state, discounted, float(rule["cfl"]) or 1.0, V, limits)
        return target(self.rule, state, supported, self.field, limits, are_known)

    def buffer(self, bodies: Bodies) -> Records:
        """Return an array for the limits of all blocks of bodies."""
        blocks = -(-len(bodies) // BODIES_PER_BLOCK)
        if len(self._found) != blocks:
            self._found = np.empty(blocks, LIMITS)
        return self._found
