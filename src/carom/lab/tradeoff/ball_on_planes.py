"""Exact reference for one ball and planes: flights, impacts, rolling and sliding under a uniform field, with drag.

The reference shares no code with the engine. Between events the acceleration of the ball is a - k v with a constant a.
In flight, drag gives k = 1/τ. For a rolling ball, a and k are smaller, since friction also has to spin the ball.
Flights and rolling have closed forms, whose roots are the times of impacts. A sliding ball changes its direction, so
DOP853 integrates it up to the moment at which its contact point stands still. A ball that bounces ever lower comes to
rest after infinitely many impacts; the reference keeps the ball on the plane after the first impact that leaves less
than `AT_REST` of its speed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from scipy.integrate import DOP853
from scipy.optimize import brentq

from carom.arrays import FloatArray
from carom.lab.compared_run import Trajectory
from carom.plan.features import require
from carom.scene.forces import DRAG, UNIFORM_FIELD
from carom.scene.load import Scene
from carom.scene.matter import pair_coefficients
from carom.scene.schema.contact import Coefficients
from carom.scene.start import InitialBodies, half_spaces
from carom.scene.units.dimension import TIME

AT_REST = 1e-13  # smallest rebound or slip, relative to the speed, that is not rounding
TOUCHING = 1e-12  # largest gap of a contact, relative to the radius
ROUNDINGS = 64.0  # error of a gap, in units in the last place of a coordinate
NUDGE = 4.0  # initial displacement of a check, in units of rounding
TOLERANCE = 1e-13  # relative tolerance of DOP853
ALMOST = 1e-6  # slip, relative to the speed, below which it decreases at a constant rate
MOST_IMPACTS = 20_000
EPS = float(np.finfo(np.float64).eps)
TINY, FINEST = 1e-300, 8.0 * EPS  # absolute and relative tolerances of roots
SERIES = 1e-8  # time, in relaxation times, below which two terms of the exponential function suffice


@dataclass
class BallSolution:
    """The motion of a ball, up to its end."""

    trajectory: Trajectory
    impacts: int
    ended: str = ""  # why the solution ends before the scene; empty if it is complete


def why_no_ball(scene: Scene) -> str:
    """Return why a scene is not one ball between planes at rest, in a field; empty if it is."""
    if scene.count != 1 or scene.has_fixed_bodies:
        return "more than one ball that moves"
    if not (scene.plane or scene.domain.walled) or scene.wall or scene.domain.repeating:
        return "other boundaries than planes"
    if scene.contact.allow_overlap:
        return "it may overlap a plane at the start"
    if scene.translating:
        return "planes that move"
    if scene.contact.laws or not scene.contact.enabled:
        return "another contact law than Coulomb's"
    forces = {name for name, part in require(scene).forces.items() if part.modelled}
    return "" if forces <= {UNIFORM_FIELD.name, DRAG.name} else "other forces than a uniform field and drag"


def solve_ball(scene: Scene, start: InitialBodies, times: FloatArray, *, nudge: int = 0) -> BallSolution:
    """Solve a scene with one ball at times (K,) in s; a ``nudge`` of 1 or -1 displaces the start by rounding."""
    return _Ball(scene, start, times, nudge).run()


def _grown(s: float, rate: float) -> tuple[float, float]:
    """Return the integral of exp(-k s) from 0 to s, and the integral of this integral."""
    if rate * s < SERIES:
        return s - rate * s * s / 2, s * s / 2 - rate * s**3 / 6
    first = -math.expm1(-rate * s) / rate
    return first, (s - first) / rate


@dataclass(frozen=True)
class _Path:
    """Position and velocity after s seconds with the acceleration a - k (v - v₀); also for a single coordinate."""

    x: FloatArray
    v: FloatArray
    a: FloatArray  # m/s², acceleration at the start
    rate: float  # 1/s, rate k

    def at(self, s: float) -> tuple[FloatArray, FloatArray]:
        first, second = _grown(s, self.rate)
        return self.x + s * self.v + second * self.a, self.v + first * self.a

    def along(self, normal: FloatArray, offset: float) -> _Path:
        """Return the path of the gap to a plane."""
        return _Path(normal @ self.x - offset, normal @ self.v, normal @ self.a, self.rate)

    def turns(self) -> float:
        """Return the time (s) at which the velocity of a single coordinate vanishes; infinite if never."""
        if not self.a or self.v / self.a > 0.0:
            return math.inf
        lost = -float(self.v / self.a)
        if not self.rate:
            return lost
        return -math.log1p(-self.rate * lost) / self.rate if self.rate * lost < 1.0 else math.inf

    def falls_to_zero(self, end: float) -> float:
        """Return the first time (s) up to an end at which a single coordinate falls to 0; infinite if never."""
        turn = self.turns()
        falls = (0.0, min(turn, end)) if self.v < 0.0 else (turn, end)
        if not falls[0] < falls[1] or (self.v >= 0.0 and self.a >= 0.0):
            return math.inf
        if self.at(falls[0])[0] <= 0.0:
            return falls[0]
        if self.at(falls[1])[0] > 0.0:
            return math.inf
        return float(brentq(lambda s: self.at(s)[0], *falls, xtol=TINY, rtol=FINEST))


@dataclass
class _Ball:
    scene: Scene
    start: InitialBodies
    times: FloatArray
    nudge: int
    ended: str = ""
    impacts: int = 0
    settles: bool = False  # whether the ball comes to rest after infinitely many impacts
    met: dict[int, float] = field(default_factory=dict)  # s, time of the first contact, by plane

    def __post_init__(self) -> None:
        scene, start = self.scene, self.start
        self.t, self.x, self.v, self.spin = 0.0, start.position[0], start.velocity[0], start.angular_velocity[0]
        self.m, self.r = float(start.mass[0]), float(start.radius[0])
        self.turned = self.m * self.r**2 / float(start.inertia[0])  # m r²/I
        self.field, self.drag = np.array(scene.gravity.uniform), scene.drag
        self.rate = 1.0 / self.drag.relaxation_time if self.drag else 0.0
        solids = half_spaces(scene)
        self.normal, self.offset = solids.normal, solids.offset
        table = pair_coefficients(scene)
        self.coefficients: list[Coefficients] = [table.of(0, 1 + k) for k in range(len(solids))]
        end = float(self.times[-1])
        fall = np.abs(self.field).max() * end
        self.speed = max(float(np.abs(self.v).max()), self.r * float(np.abs(self.spin).max()), fall, self.r / end)
        self.near = TOUCHING * self.r + ROUNDINGS * EPS * float(np.abs(self.x).max())
        self.at_start = {k for k in range(len(self.offset)) if self._gap(k) <= self.near}
        self.x = self.x + self.nudge * NUDGE * EPS * np.abs(self.x)
        self.v = self.v * (1.0 + self.nudge * NUDGE * EPS)
        self.samples: list[tuple[FloatArray, FloatArray]] = []

    def run(self) -> BallSolution:
        end = float(self.times[-1])
        while len(self.samples) < len(self.times) and not self.ended:
            touching = [k for k in range(len(self.offset)) if self._gap(k) <= self.near]
            struck = [k for k in touching if self.normal[k] @ self.v < -AT_REST * self.speed]
            held = [k for k in touching if k not in struck and self._is_held(k)]
            if struck:
                self._strike(struck[0])
            elif len(held) > 1:
                self.ended = f"the ball rests on several planes from {self._now} on"
            elif held:
                self._hold(held[0], end)
            else:
                self._follow(_Path(self.x, self.v, self._acceleration(), self.rate), end)
        position, velocity = (np.array([sample[k] for sample in self.samples]).reshape(-1, 1, 3) for k in (0, 1))
        met = {(0, 1 + k): time for k, time in self.met.items()}
        impacts = 0 if self.settles else self.impacts  # an infinite number of impacts is not compared
        trajectory = Trajectory.exact(self.times, position, velocity, met, impacts)
        return BallSolution(trajectory, self.impacts, self.ended)

    def _gap(self, plane: int) -> float:
        return float(self.normal[plane] @ self.x - self.offset[plane]) - self.r

    def _acceleration(self) -> FloatArray:
        wind = np.array(self.drag.medium_velocity) - self.v if self.drag else np.zeros(3)
        return np.asarray(self.field + self.rate * wind)

    def _is_held(self, plane: int) -> bool:
        """Return whether a touched plane holds the ball: nothing lifts the ball, and forces press it onto the plane."""
        n = self.normal[plane]
        return bool(n @ self.v <= AT_REST * self.speed and n @ self._acceleration() < 0.0)

    def _slip(self, n: FloatArray) -> FloatArray:
        """Return the velocity of the contact point along the plane."""
        return np.asarray(self.v - (n @ self.v) * n - self.r * np.cross(self.spin, n))

    def _push(self, n: FloatArray, impulse: FloatArray) -> None:
        """Apply an impulse per mass, (3,) m/s, at the contact point."""
        self.v = self.v + impulse
        self.spin = self.spin - self.turned / self.r * np.cross(n, impulse)

    def _strike(self, plane: int) -> None:
        n, law = self.normal[plane], self.coefficients[plane]
        if plane not in self.at_start:
            self.met.setdefault(plane, self.t)
        self.impacts += 1
        if self.impacts > MOST_IMPACTS:
            self.ended = f"the ball has had {MOST_IMPACTS} impacts at {self._now}"
        closing = float(n @ self.v)
        pressed = -(1.0 + law.restitution) * closing  # m/s, normal impulse divided by the mass
        slip = self._slip(n)
        stops = slip / (1.0 + self.turned)  # m/s, impulse per mass that ends the slip
        size = float(np.linalg.norm(stops))
        if size > law.static_friction * pressed:
            stops *= law.kinetic_friction * pressed / size
        self._push(n, pressed * n - stops)
        if -law.restitution * closing <= AT_REST * self.speed:
            self.settles = law.restitution > 0.0
            self.v = self.v - (n @ self.v) * n

    def _hold(self, plane: int, end: float) -> None:
        """Roll or slide along a plane, until the ball reaches another plane."""
        n, law = self.normal[plane], self.coefficients[plane]
        self.v = self.v - (n @ self.v) * n
        pressed, along = -float(n @ self._acceleration()), self._along(n)
        slip = float(np.linalg.norm(self._slip(n)))
        share = self.turned / (1.0 + self.turned)  # fraction of the force that accelerates a rolling ball
        if not law.static_friction:
            self._follow(_Path(self.x, self.v, along, self.rate), end, plane)
        elif slip <= AT_REST * self.speed and np.linalg.norm(along) / (1.0 + self.turned) <= (
            law.static_friction * pressed * (1.0 + TOUCHING)
        ):
            self._follow(_Path(self.x, self.v, share * along, share * self.rate), end, plane)
            self.spin = (n @ self.spin) * n + np.cross(n, self.v) / self.r
        else:
            self._slide(n, law.kinetic_friction * pressed, end, plane)

    def _follow(self, path: _Path, end: float, plane: int = -1) -> None:
        """Follow a path to the first plane that it meets; the plane that holds the ball does not count."""
        left, first = end - self.t, math.inf
        for k in range(len(self.offset)):
            if k != plane:
                gap = path.along(self.normal[k], float(self.offset[k]) + self.r)
                touches = abs(float(gap.x)) <= self.near
                first = min(first, (_Path(0.0 * gap.x, gap.v, gap.a, gap.rate) if touches else gap).falls_to_zero(left))
        lasts = min(first, left)
        while (due := self._due()) <= self.t + lasts:
            self.samples.append(path.at(due - self.t))
        self.x, self.v = path.at(lasts)
        self.t += lasts
        if first <= left and first == 0.0:
            self.ended = f"contacts follow each other without end at {self._now}"

    @property
    def _now(self) -> str:
        return f"t = {self.scene.unit_system.text(self.t, TIME, '.9g')}"

    def _due(self) -> float:
        return float(self.times[len(self.samples)]) if len(self.samples) < len(self.times) else math.inf

    def _slide(self, n: FloatArray, friction: float, end: float, plane: int) -> None:
        """Slide with a friction (m/s²) until the contact point stands still, or the ball reaches another plane."""
        along, slip = self._along(n), self._slip(n)
        speed = float(np.linalg.norm(slip))
        towards = along / np.linalg.norm(along) if speed <= AT_REST * self.speed else slip / speed
        sideways = float(np.linalg.norm(along - (along @ towards) * towards))
        if speed <= ALMOST * self.speed or sideways <= TOUCHING * friction:
            # if the slip keeps its direction, there is a closed form
            pull, began = float(along @ towards) - friction, self.t
            grinds = friction * self.turned  # m/s², change of the slip by the torque

            def remaining(s: float) -> float:
                return speed + pull * _grown(s, self.rate)[0] - grinds * s

            left = end - began
            ends = speed > AT_REST * self.speed and remaining(left) < 0.0
            stop = float(brentq(remaining, 0.0, left, xtol=TINY, rtol=FINEST)) if ends else left
            self._follow(_Path(self.x, self.v, along - friction * towards, self.rate), began + stop, plane)
            self.spin = self.spin + self.turned / self.r * friction * (self.t - began) * np.cross(n, towards)
            if ends and self.t >= began + stop:
                self._push(n, -self._slip(n) / (1.0 + self.turned))  # removes the slip that rounding left
        elif len(self.offset) > 1:
            self.ended = f"the ball slides along a curve between several planes from {self._now} on"
        else:
            most = speed / (friction * (1.0 + self.turned) + float(np.linalg.norm(along)))  # s, least duration of slip
            until = min(self._due(), end, self.t + most / 2)
            solver = DOP853(
                lambda _, y: self._sliding(y, n, friction),
                self.t,
                np.concatenate((self.x, self.v, self.spin)),
                until,
                rtol=TOLERANCE,
                atol=TOLERANCE * self.speed,
            )
            while solver.status == "running":
                solver.step()
            self.t = until
            self.x, self.v, self.spin = solver.y.reshape(3, 3)
            if self._due() == self.t:
                self.samples.append((self.x, self.v))

    def _along(self, n: FloatArray) -> FloatArray:
        force = self._acceleration()
        return np.asarray(force - (n @ force) * n)

    def _sliding(self, y: FloatArray, n: FloatArray, friction: float) -> FloatArray:
        """Return the rates of change of position, velocity and spin."""
        self.x, self.v, self.spin = y.reshape(3, 3)
        slip = self._slip(n)
        push = -friction * slip / np.linalg.norm(slip)
        return np.concatenate((self.v, self._along(n) + push, -self.turned / self.r * np.cross(n, push)))
