"""Applied forces that an engine reports, and a damping that all free bodies share: the audit accounts for both."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from carom.arrays import BoolArray, FloatArray
from carom.engines.elastic_energy import TINY
from carom.engines.engine_contacts import EngineMoment, Near, lengths
from carom.engines.source import Setup

ALIKE = 0.02  # largest relative deviation of a free body's damping rate from the common law
SEVERAL = 6  # smallest number of losses, over several bodies or frames, that show a law
RECENT = 60  # number of recent losses that are compared
LEAST = 1e-6  # smallest measurable loss of speed in a frame, relative to the speed; smaller losses are rounding
MOVING = 0.05  # speed, relative to the largest, below which no rate is measured
BESIDE = 0.05  # largest part of a velocity change that may be across the velocity; damping acts along it


@dataclass(slots=True)
class CommonDamping:
    """The rate at which free bodies lose speed or spin, ``rate + by_speed |v|``, if it is the same for all.

    PyBullet's own damping has both terms, with the same coefficient.
    """

    rate: float = 0.0  # 1/s
    by_speed: float = 0.0  # damping rate per speed in 1/m, or 1/rad for spins
    told: tuple[float, float] = (0.0, 0.0)  # rate and `by_speed` of the last law that was reported
    losses: FloatArray = field(default_factory=lambda: np.empty((0, 2)))  # speeds and rates in the most recent losses

    def at(self, speed: FloatArray) -> FloatArray:
        """Return the rates (n, 1) in 1/s at speeds (n,)."""
        return np.asarray((self.rate + self.by_speed * speed)[:, None])

    def learn(self, start: FloatArray, change: FloatArray, free: BoolArray, dt: float, other: CommonDamping) -> None:
        """Measure the damping from the changes (n, 3) of free bodies' velocities."""
        speed = lengths(start)
        chosen = free & (speed > MOVING * speed.max())
        if not chosen.any():
            return
        speed, change, start = speed[chosen], change[chosen], start[chosen]
        rate = -np.einsum("ij,ij->i", change, start) / np.maximum(speed**2 * dt, TINY)
        beside = lengths(change + (rate * dt)[:, None] * start) > BESIDE * lengths(change)
        if beside.any() or not (rate * dt > LEAST).all():  # a force other than damping acts, or no force
            self.losses = self.losses[:0]
            if float(np.median(np.abs(rate))) * dt <= LEAST:
                self.rate = self.by_speed = 0.0
            return
        self.losses = np.concatenate((self.losses, np.stack((speed, rate), axis=1)))[-RECENT:]
        speed, rate = self.losses.T
        laws = [np.array([other.rate, other.by_speed])]
        if len(self.losses) >= SEVERAL:
            straight = np.linalg.lstsq(np.stack((np.ones_like(speed), speed), axis=1), rate, rcond=None)[0]
            laws += [np.array([rate.mean(), 0.0]), straight]
        for law in laws:
            if (np.abs(law[0] + law[1] * speed - rate) <= ALIKE * rate).all():
                self.rate, self.by_speed = self.told = (float(law[0]), float(law[1]))
                return
        if len(self.losses) < SEVERAL:
            return
        self.losses = self.losses[-len(change) :]


class KnownForces:
    """The changes of velocities that are due neither to the uniform field nor to contacts."""

    def __init__(self, setup: Setup) -> None:
        self._setup = setup
        self.measured = CommonDamping(), CommonDamping()  # the common dampings of velocities and of spins
        self.work = 0.0  # J, work on judged bodies

    def applied(self, before: EngineMoment, now: EngineMoment, near: Near) -> EngineMoment:
        """Return the earlier moment, with velocities as if the known forces had acted on its bodies until now."""
        setup, dt = self._setup, now.time - before.time
        if not dt > 0.0:
            return before
        free = setup.judged & ~setup.fixed
        moving = ~setup.fixed[:, None]
        free[near.pairs[near.pairs < len(free)]] = False
        push = setup.gravity * dt * moving
        velocity, spin = before.velocity, before.spin
        if len(now.force):
            velocity = velocity + now.force / setup.mass[:, None] * dt * moving
        if setup.damping is None:
            self.measured[0].learn(before.velocity, now.velocity - push - velocity, free, dt, self.measured[1])
        linear = self.measured[0] if setup.damping is None else CommonDamping(setup.damping)
        velocity = velocity - linear.at(lengths(before.velocity)) * dt * before.velocity * moving
        if len(spin):
            if len(now.torque):
                spin = spin + now.torque / setup.inertia[:, None] * dt * moving
            if setup.angular_damping is None:
                self.measured[1].learn(before.spin, now.spin - spin, free, dt, self.measured[0])
            angular = self.measured[1] if setup.angular_damping is None else CommonDamping(setup.angular_damping)
            spin = spin - angular.at(lengths(before.spin)) * dt * before.spin * moving
        if np.array_equal(velocity, before.velocity) and np.array_equal(spin, before.spin):
            return before
        moment = replace(before, velocity=velocity, spin=spin)
        self.work += float((moment.kinetic(setup) - before.kinetic(setup))[setup.judged].sum())
        return moment

    def go_on(self, earlier: KnownForces) -> None:
        """Take over the measurements from an earlier set of bodies of the same engine."""
        self.measured, self.work = earlier.measured, earlier.work
