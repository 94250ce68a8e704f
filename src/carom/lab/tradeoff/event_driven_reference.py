"""Event-driven reference for a few bodies: an adaptive method of order eight between contacts, each contact an event.

SciPy's DOP853 integrates the forces with tolerances near round-off, from contact to contact. If two bodies may meet in
a step, conservative advancement finds their first contact. The bodies cannot meet in less time than the gap divided by
an upper bound of the closing speed, so no contact is missed. The time of contact is then refined with steps from the
same initial state, and `physics/reference_api.py` resolves the contact. Samples do not shorten the steps. Each sample
is a separate, shorter step, which is more accurate than DOP853's interpolation.

Bodies may stay in contact without force, as after a plastic impact; the next impact on one of these bodies acts on all
of them. The solution ends where a force presses touching bodies together or where contacts accumulate, because lasting
contacts are not events.

The tolerance bounds only the error of flights. A *twin* measures how contacts amplify rounding: it is the same scene,
displaced by rounding errors, with simultaneous contacts resolved in another order. Each order of the impacts obeys the
impulse law of a pair, but in a row of touching bodies the velocities depend on the order: no law of pairs determines
these velocities. The solution resolves all closing pairs at once, and then the pairs that close again. The twins
resolve one pair at a time: one twin begins with the last closing pair, the other with the first.
"""

from __future__ import annotations

import math
import time as clock
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.integrate import DOP853, OdeSolution

from carom.arrays import FloatArray
from carom.lab.compared_run import Trajectory
from carom.physics.contact.law import LAW
from carom.physics.forces.kernel_forces import forces_of_packages
from carom.physics.reference_api import BodyProxy, CollisionContext
from carom.physics.space import Space
from carom.scene.load import Scene
from carom.scene.matter import pair_coefficients
from carom.scene.units.dimension import TIME
from carom.scene.wording import bodies_called

MOST_BODIES = 20  # largest number of bodies; Python examines the pairs one by one
MOST_CONTACTS = 10_000
TIGHTEST = 1e-13  # relative tolerance of DOP853, near the smallest accepted value
SPEED_MARGIN = 1.5  # bound of a step's closing speed, relative to the largest value at its ends and middle
TOUCHING = 1e-12  # largest gap of a contact, relative to the sum of radii, if rounding is smaller
ROUNDINGS = 8.0  # tolerance of contact, in units in the last place of speeds and positions
LOWEST_FLIGHT = 10.0  # largest bounce of bodies that stay in contact, in multiples of the largest gap of a contact
BISECTIONS = 30  # number of bisections of a step in which a force begins to press
NEWTON = 12  # largest number of iterations; each iteration squares the error
NUDGE = 4.0  # initial displacement of a twin in units of rounding: more than the error of some hundred steps
LONGER = 1.25  # longest step of a twin, relative to the solution's: at order eight, its error is six times as large
EPS = float(np.finfo(np.float64).eps)


@dataclass
class EventDrivenSolution:
    """The event-driven solution of a scene, up to its end."""

    trajectory: Trajectory
    ended: str = ""  # why the solution ends before the scene; empty if it is complete
    time: list[float] = field(default_factory=list)  # s, time of every contact
    together: list[float] = field(default_factory=list)  # s, times at which one body strikes several others at once


def why_not(scene: Scene) -> str:
    """Return why a scene cannot be solved exactly; empty if it can."""
    if scene.count > MOST_BODIES:
        return f"{scene.count} bodies, more than {MOST_BODIES}"
    if scene.domain.boundary != "open" or scene.plane or scene.wall:
        return "no exact solution with planes, walls or periodic boxes"
    if scene.has_fixed_bodies:
        return "no exact solution with fixed bodies"
    if scene.contact.allow_overlap:
        return "bodies may overlap at the start"
    if scene.contact.enabled and scene.contact.laws:
        return f"no exact solution with {scene.contact.law_key}"
    return ""


def solve(
    space: Space, times: FloatArray, tolerance: float = TIGHTEST, *, twin: int = 0, budget: float = math.inf
) -> EventDrivenSolution:
    """Solve a scene from the start of its space, which does not change; keep the solution at times (K,) in s.

    ``tolerance`` is DOP853's relative tolerance; the absolute tolerance is ``tolerance`` times the largest coordinate
    and speed at the start. With a ``twin`` of 1 or 2, the start is displaced by rounding, and simultaneous contacts are
    resolved in another order. The solution ends after a ``budget`` of CPU time in s.
    """
    return _Solver(space, times, tolerance, twin, budget).run()


class _Solver:
    def __init__(self, space: Space, times: FloatArray, tolerance: float, twin: int, budget: float) -> None:
        scene, start = space.scene, space.state
        self._scene, self._tolerance, self._times, self._twin = scene, tolerance, times, twin
        self._coefficients = pair_coefficients(scene)
        self._budget, self._deadline = budget, clock.thread_time() + budget
        # the part of the state that contacts change
        velocity, spin = start.velocity.copy(), start.angular_velocity.copy()
        ends = replace(start.ends, velocity=velocity, angular_velocity=spin)
        self._bodies = replace(
            start, position=start.position.copy(), velocity=velocity, angular_velocity=spin, ends=ends
        )
        self._n, self._names, self._units = len(start), space.names, scene.unit_system
        self._constant = scene.gravity.constant if space.requirements.gravity.modelled else 0.0
        self._field = np.array(scene.gravity.uniform)
        self._forces = forces_of_packages(scene, self._bodies)
        self._contacts = space.requirements.contact.modelled
        self._i, self._j = np.triu_indices(self._n, 1)
        if twin:  # displace bodies by the rounding of their coordinates, of their speeds and of the clock
            position, velocity = self._bodies.position, self._bodies.velocity
            signs = np.random.default_rng(twin).choice([-1.0, 1.0], (2, self._n, 3))
            position += NUDGE * EPS * signs[0] * (np.abs(position) + np.abs(velocity) * scene.time.duration)
            velocity *= 1.0 + NUDGE * EPS * signs[1]
        self._max_step = (LONGER if twin else 1.0) * float(np.median(np.diff(times, prepend=0.0)))
        self._reach = start.radius[self._i] + start.radius[self._j]
        self._near = TOUCHING * self._reach  # (pairs,) m, largest gap of a contact
        # (pairs,) whether a pair touches at the start; such a pair has no first contact
        self._touched = self._gaps(self._state()) <= self._near
        self._time = 0.0
        self._position: list[FloatArray] = []  # (n, 3) m, positions at each sample so far
        self._velocity: list[FloatArray] = []  # (n, 3) m/s, velocities at each sample so far
        self._met: dict[tuple[int, int], float] = {}
        self._struck: list[float] = []  # s, time of every impact
        self._ends: list[tuple[int, int]] = []  # both bodies of each impact
        self._ended = ""
        size = np.concatenate((start.position - start.position.mean(axis=0), start.position)).ravel()
        length = max(float(np.abs(size).max()), float(start.radius.max()))
        self._speed = max(float(np.abs(start.velocity).max()), length / scene.time.duration)
        self._absolute = tolerance * np.repeat([length, self._speed], 3 * self._n)

    def run(self) -> EventDrivenSolution:
        end = float(self._times[-1])
        touching = self._touching() if self._contacts else []
        while True:
            longest = self._resolve(touching) if touching else math.inf
            self._sample_now()
            if self._time >= end or self._ended:
                break
            touching = self._advance(end, longest)
        position, velocity = self._position, self._velocity
        shape = (len(position), self._n, 3)
        trajectory = Trajectory.exact(
            self._times,
            np.array(position).reshape(shape),
            np.array(velocity).reshape(shape),
            self._met,
            len(self._struck),
            struck=np.array(self._ends, dtype=np.int64).reshape(-1, 2),
            struck_at=np.array(self._struck),
        )
        return EventDrivenSolution(trajectory, self._ended, self._struck, self._together())

    def _together(self) -> list[float]:
        """Return the times (s) at which one body has impacts with several others."""
        pairs: dict[float, set[tuple[int, int]]] = {}
        for time, ends in zip(self._struck, self._ends, strict=True):
            pairs.setdefault(time, set()).add(ends)
        return [
            time for time, found in pairs.items() if len({body for ends in found for body in ends}) < 2 * len(found)
        ]

    def _advance(self, end: float, longest: float) -> list[int]:
        """Advance to a time or to the first contacts before it; return the pairs in contact.

        The first step is at most ``longest``, because bodies that bounce must separate before they fall back.
        """
        solver = self._solver(self._time, self._state(), min(end, self._time + longest))
        while not self._ended:
            if solver.status != "running":
                if solver.t >= end:
                    break
                solver = self._solver(solver.t, solver.y, end)
            before, y = solver.t, solver.y.copy()
            message = solver.step()
            if solver.status == "failed":
                self._end(f"DOP853 stopped at t = {self._units.text(solver.t, TIME)}: {message}")
                break
            if self._contacts:
                # gaps below the rounding of coordinates and clock count as contacts; such gaps matter for fast bodies
                ends = np.stack((y, solver.y))
                largest = np.abs(ends[:, : 3 * self._n]).max(axis=0).reshape(-1, 3).max(axis=1)
                speed = np.max([self._speeds(end) for end in ends], axis=0)
                unseen = np.spacing(np.maximum(largest[self._i], largest[self._j])) + speed * np.spacing(solver.t)
                self._near = np.maximum(self._near, TOUCHING * self._reach + ROUNDINGS * unseen)
            found = self._first_contact(solver, before, y) if self._contacts else None
            after, state = found or (solver.t, solver.y)
            pressed = self._pressed(y, state) if self._contacts else None
            if pressed is not None:
                # bisects for the last state in which no pair is pressed, even if a pair that separates meets again
                # within the step
                found, late, (after, state) = None, after, (before, y)
                for _ in range(BISECTIONS):
                    time = (after + late) / 2
                    at = self._at(before, y, time)
                    if self._pressed(y, at) is None:
                        after, state = time, at
                    else:
                        late = time
                solver = self._solver(after, state, end)
            self._sample(before, y, after)
            self._time = after
            self._bodies.position[:], self._bodies.velocity[:] = state.reshape(2, self._n, 3)
            if pressed is not None and self._gap(state, pressed) <= self._near[pressed]:
                self._end_in_contact(pressed)
            if clock.thread_time() > self._deadline:
                self._end(f"after {self._budget:.3g} s of computing it had reached t = {self._units.text(after, TIME)}")
            if found is not None:
                return self._touching()
            self._sample_now()
        return []

    def _sample(self, before: float, y: FloatArray, after: float) -> None:
        """Store the samples within the step from the state ``before``."""
        while (time := self._next_sample()) < after:
            x, v = self._at(before, y, time).reshape(2, self._n, 3)
            self._position.append(x.copy())
            self._velocity.append(v.copy())

    def _sample_now(self) -> None:
        """Store a sample of the present time if a sample is due; colliding bodies already have their new velocities."""
        if self._next_sample() == self._time:
            self._position.append(self._bodies.position.copy())
            self._velocity.append(self._bodies.velocity.copy())

    def _next_sample(self) -> float:
        """Return the time (s) of the next sample; infinite after the last sample."""
        return float(self._times[len(self._position)]) if len(self._position) < len(self._times) else math.inf

    def _at(self, before: float, y: FloatArray, time: float) -> FloatArray:
        """Return the state at a time within the step from the state ``before`` to ``y``."""
        if time == before:
            return y
        solver = self._solver(before, y, time, first_step=time - before)
        while solver.status == "running":
            solver.step()
        return np.asarray(solver.y)

    def _solver(self, time: float, y: FloatArray, end: float, first_step: float | None = None) -> DOP853:
        return DOP853(
            self._rates,
            time,
            y,
            end,
            rtol=self._tolerance,
            atol=self._absolute,
            first_step=first_step,
            max_step=self._max_step,
        )

    def _rates(self, time: float, y: FloatArray) -> FloatArray:
        x = y[: 3 * self._n].reshape(-1, 3)
        d = x[None, :, :] - x[:, None, :]
        r2 = np.sum(d * d, axis=2) + self._scene.gravity.softening**2
        np.fill_diagonal(r2, 1.0)
        gm_r3 = self._constant * self._bodies.mass / (r2 * np.sqrt(r2)) if self._constant else np.zeros_like(r2)
        acceleration = np.einsum("ij,ijk->ik", gm_r3, d) + self._field
        if drag := self._scene.drag:
            slip = y[3 * self._n :].reshape(-1, 3) - drag.medium_velocity
            acceleration -= slip / drag.relaxation_time
        for force in self._forces:
            force.accelerate(x, acceleration, first=False, potential=False)
        return np.concatenate((y[3 * self._n :], acceleration.ravel()))

    def _first_contact(self, solver: DOP853, before: float, y: FloatArray) -> tuple[float, FloatArray] | None:
        """Return time and state of the first contact in the last step, if any."""
        dense = OdeSolution([before, solver.t], [solver.dense_output()])
        end = solver.t
        looks = [dense(before), dense((before + end) / 2), dense(end)]
        bound = SPEED_MARGIN * np.max([self._speeds(look) for look in looks], axis=0)
        gap = self._gaps(y)
        apart = gap > self._near
        earliest, which = math.inf, -1
        for pair in np.flatnonzero(apart & (gap < bound * (end - before))):
            time = self._first_touch(dense, int(pair), before, min(end, earliest), float(bound[pair]))
            if time < earliest:
                earliest, which = time, int(pair)
        return None if which < 0 else self._refined(before, y, earliest, which)

    def _first_touch(self, dense: OdeSolution, pair: int, time: float, end: float, bound: float) -> float:
        """Return the time of a pair's first contact, by conservative advancement; infinite if there is none."""
        near = self._near[pair]
        while time < end:
            gap = self._gap(dense(time), pair)
            if gap <= near:
                return time
            later = time + gap / bound
            if later == time:
                return time
            time = later
        return time if self._gap(dense(end), pair) <= near else math.inf

    def _refined(self, before: float, y: FloatArray, time: float, pair: int) -> tuple[float, FloatArray]:
        """Refine the time of a contact by Newton's iteration with steps that end at this time."""
        at = y
        for _ in range(NEWTON):
            at = self._at(before, y, time)
            rate = self._closing(at, pair)
            if rate >= 0.0:
                break
            change = self._gap(at, pair) / rate
            if time - change <= before or abs(change) <= 2 * np.spacing(time):
                break
            time -= change
        return time, at

    def _resolve(self, touching: list[int]) -> float:
        """Resolve contacts; return the longest allowed next step, in s."""
        rounds = 0
        while touching and not self._ended:
            chosen = touching if not self._twin else touching[-1:] if self._twin == 1 else touching[:1]
            for pair in chosen:
                self._strike(pair)
            rounds += 1
            if len(self._struck) > MOST_CONTACTS or rounds > MOST_CONTACTS:
                self._end(f"an endless sequence of contacts begins at t = {self._units.text(self._time, TIME, '.9g')}")
            touching = self._touching()
        return self._flight()

    def _strike(self, pair: int) -> None:
        i, j = int(self._i[pair]), int(self._j[pair])
        state = self._state()
        rate = self._closing(state, pair)
        if rate >= -self._rate_noise(state, pair, ROUNDINGS * EPS):
            return
        b1, b2 = BodyProxy(self._bodies, i), BodyProxy(self._bodies, j)
        normal = (b2.position - b1.position) / np.linalg.norm(b2.position - b1.position)
        r1_vec, r2_vec = normal * b1.radius, -normal * b2.radius
        v1 = b1.velocity + np.cross(b1.angular_velocity, r1_vec)
        v2 = b2.velocity + np.cross(b2.angular_velocity, r2_vec)
        material = self._coefficients.of(i, j)
        e = LAW.restitution(material, -float((v2 - v1) @ normal), 0.0)
        impact = CollisionContext(b1, b2, normal, r1_vec, r2_vec, v2 - v1, 0.0)
        impact.resolve(e, material.static_friction, material.kinetic_friction)
        if not self._touched[pair]:
            self._met.setdefault((i, j), self._time)
        if rate < -self._rate_noise(state, pair, self._tolerance):
            self._struck.append(float(self._time))
            self._ends.append((i, j))

    def _flight(self) -> float:
        """Return the shortest time in s after which a touching pair reaches its largest separation."""
        state = self._state()
        longest = math.inf
        for pair in np.flatnonzero(np.abs(self._gaps(state)) <= self._near):
            rate = self._closing(state, int(pair))
            if rate <= self._rate_noise(state, int(pair), self._tolerance):
                continue  # the pair stays in touch; `_pressed` checks for a pressing force
            opening = self._gap_acceleration(state, int(pair))
            if opening >= 0.0:
                continue
            flight = rate / -opening
            if rate * flight / 2 < LOWEST_FLIGHT * self._near[pair]:
                self._end_in_contact(int(pair))
            longest = min(longest, flight)
        return longest

    def _pressed(self, before: FloatArray, after: FloatArray) -> int | None:
        """Return a pair that touches before a step and closes after it, beyond the step's error; otherwise None."""
        for pair in np.flatnonzero((self._gaps(before) <= self._near) & (self._gaps(after) <= 0.0)):
            if self._closing(after, int(pair)) < -self._rate_noise(after, int(pair), self._tolerance):
                return int(pair)
        return None

    def _end_in_contact(self, pair: int) -> None:
        since = self._units.text(self._time, TIME, ".9g")
        called = bodies_called((self._i[pair], self._j[pair]), self._names)
        self._end(f"{called} stay in contact from t = {since} on")

    def _rate_noise(self, state: FloatArray, pair: int, relative: float) -> float:
        """Return the error in m/s of the rate of a gap, from the relative error of speeds."""
        v = state[3 * self._n :].reshape(-1, 3)
        speeds = np.linalg.norm(v[self._i[pair]]) + np.linalg.norm(v[self._j[pair]])
        return relative * float(self._speed + speeds)

    def _gap_acceleration(self, state: FloatArray, pair: int) -> float:
        """Return the second derivative of the gap of a pair, in m/s²."""
        acceleration = self._rates(self._time, state)[3 * self._n :].reshape(-1, 3)
        x, v = state.reshape(2, -1, 3)
        i, j = self._i[pair], self._j[pair]
        d, u = x[j] - x[i], v[j] - v[i]
        distance = float(np.linalg.norm(d))
        sideways = float(u @ u) - (float(u @ d) / distance) ** 2
        return float((acceleration[j] - acceleration[i]) @ d + sideways) / distance

    def _touching(self) -> list[int]:
        """Return the pairs that touch and close."""
        state = self._state()
        near = np.flatnonzero(self._gaps(state) <= self._near)
        return [
            int(pair)
            for pair in near
            if self._closing(state, int(pair)) < -self._rate_noise(state, int(pair), ROUNDINGS * EPS)
        ]

    def _end(self, why: str) -> None:
        self._ended = self._ended or why

    def _state(self) -> FloatArray:
        return np.concatenate((self._bodies.position.ravel(), self._bodies.velocity.ravel()))

    def _gaps(self, y: FloatArray) -> FloatArray:
        x = y[: 3 * self._n].reshape(-1, 3)
        return np.asarray(np.linalg.norm(x[self._j] - x[self._i], axis=1) - self._reach)

    def _gap(self, y: FloatArray, pair: int) -> float:
        i, j = 3 * self._i[pair], 3 * self._j[pair]
        return math.dist(y[i : i + 3], y[j : j + 3]) - float(self._reach[pair])

    def _speeds(self, y: FloatArray) -> FloatArray:
        v = y[3 * self._n :].reshape(-1, 3)
        return np.asarray(np.linalg.norm(v[self._j] - v[self._i], axis=1))

    def _closing(self, y: FloatArray, pair: int) -> float:
        """Return the rate at which a pair's gap changes; negative while the pair closes."""
        x, v = y.reshape(2, -1, 3)
        i, j = self._i[pair], self._j[pair]
        normal = (x[j] - x[i]) / np.linalg.norm(x[j] - x[i])
        return float((v[j] - v[i]) @ normal)
