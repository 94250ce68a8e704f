"""Stokes drag in a medium that moves uniformly at velocity u.

    a = -(v - u)/τ

The constant part u/τ is added to the accelerations like a uniform field. The part -v/τ is solved exactly within the
drift. With z = h/τ, E = e^{-z}, φ₁ = (1 - E)/z and φ₂ = (1 - φ₁)/z, a step of leapfrog of length h is

    v += a k₁,   v *= φ₁,    x += v h,    v *= E/φ₁,   v += a' k₂        k₁ = h φ₂/φ₁,   k₂ = h (φ₁ - E φ₂/φ₁)

Between the factors φ₁ and E/φ₁, velocities are the mean velocities of the drift. Contacts are held there, and impacts
happen on straight lines along which bodies slow down (`carom.physics.contact.events.trajectories`). The lengths of the
kicks make the step exact for a constant acceleration; for τ → ∞, both lengths are h/2. The step is its own adjoint,
hence of order 2.

The energy dissipated by the medium is the change of the energy in the step minus the work of the other forces
(docs/physics.md, 6):

    lost = Σ ½ m (v² - w²) + κ m a·w - ½ m κ (h - κ) a²                     by the kick and the factor before the drift
    lost = Σ ½ m (w² - v²) + (h - κ) m a'·w - h m (u/τ)·w + ½ m κ (h - κ) a'²    after it

where w is the velocity between the factors, and κ = ½ (h φ₂ + k₂²/(h φ₂)): with this κ, both losses of a body at rest
are zero.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

import numpy as np

from carom.arrays import FloatArray, RecordArray, dtype_of
from carom.physics.aligned import columns
from carom.physics.bodies import Bodies
from carom.physics.contact.hooks import LedgerAccount, PresentStep
from carom.physics.contact.records import ImpactRecord
from carom.physics.exponential import exponentials
from carom.physics.forces.field import MIN_BODIES_PER_TASK, add
from carom.physics.forces.force import Damping, Exchange
from carom.physics.integrators.kick_drift import (
    DampedPath,
    DampedStep,
    KickedBodies,
    book_exchange,
    damped_step,
    kick_after_drift,
    kick_before_drift,
    measure_hold,
)
from carom.physics.jit.decorators import Function, for_first, inline, kernel
from carom.physics.jit.team import Team
from carom.scene.forces import DRAG, MOST_RELAXATIONS
from carom.scene.load import Scene
from carom.scene.schema import Drag


class DragSumsRecord(Protocol):
    """Sums over a block of bodies."""

    lost: float  # J, energy dissipated by the medium
    px: float  # kg m/s, impulse of all external forces
    py: float
    pz: float
    Lx: float  # kg m²/s, angular impulse of all external forces
    Ly: float
    Lz: float


SUMS = dtype_of(DragSumsRecord)
BEFORE, AFTER = range(2)  # rows of sums, before and after the drift


class DragLaw(NamedTuple):
    """The drag for kernels; the functions of `carom.physics.integrators.kick_drift` recognise drag by this type."""

    rate: float  # 1/s
    wind: FloatArray  # (3,) m/s², u/τ
    outer: FloatArray  # (3,) m/s², u/τ plus all other accelerations that are the same for every body
    sums: RecordArray[DragSumsRecord]  # (2,) sums of a step, before and after the drift
    held: FloatArray  # (1,) J, the part of the loss in a step that is due to held contacts
    against: FloatArray  # (n + p, 3) m/s², a - v/τ at the beginning of the step; 0 for planes
    slowed: FloatArray  # (n, 3) m/s, the velocities along the drift before contacts are held
    # (7,), exchange with the medium in the run, to which kernels add: the energy (J) that left the bodies, and the
    # momentum (N s) and angular momentum (N m s) that the balance expects
    exchanged: FloatArray


class StokesDrag(Damping):
    """Slows all bodies down at one rate, relative to a medium.

    It is both a force and a part of a step with its own kicks. ``outer``, (3,) m/s², is the acceleration by other
    forces that is the same for all bodies.
    """

    kind = DRAG
    needs_every_step = False
    law: DragLaw

    def __init__(self, drag: Drag, bodies: Bodies, outer: FloatArray, team: Team) -> None:
        rate = 1.0 / drag.relaxation_time
        self.uniform = np.array(drag.medium_velocity) * rate
        step = np.zeros(2, SUMS), np.zeros(1), np.zeros_like(bodies.ends.acceleration), np.zeros_like(bodies.velocity)
        self.law = DragLaw(rate, self.uniform, outer + self.uniform, *step, np.zeros(7))
        self._bodies = bodies
        arrays = bodies.position, bodies.velocity, bodies.acceleration, bodies.mass
        self._kicked = KickedBodies(*arrays, bodies.ends.inverse_mass)
        self._team = team
        self._step, self._before = _step_of(rate, 1.0), bodies.ends.velocity.copy()
        self._exchanges: list[Exchange] = []  # exchanges of the bodies with the medium in this step

    def accelerate(self, position: FloatArray, acceleration: FloatArray, *, first: bool, potential: bool) -> float:
        """Add u/τ, the constant part; see `Force`."""
        if first:
            acceleration[:] = 0.0
        if self.uniform.any():
            self._team.divide(len(acceleration), MIN_BODIES_PER_TASK, add, acceleration, self.uniform)
        return 0.0

    def lend(self, account: LedgerAccount) -> None:
        """Copy the ledger's entry, so that kernels can add to it."""
        self.law.exchanged[:] = account.exchanged(self.kind.loss)

    def settle(self, account: LedgerAccount) -> None:
        """Book the exchanges that kernels have added."""
        account.exchange_up_to(self.kind.loss, self.law.exchanged)

    def book(self, account: LedgerAccount) -> None:
        """Book the exchanges of the step."""
        for exchange in self._exchanges:
            account.exchange(self.kind.loss, *exchange)
        self._exchanges.clear()

    def discard(self) -> None:
        """Discard the exchanges so far."""
        self._exchanges.clear()

    def kick_before(self, step: PresentStep) -> None:
        """Kick, then slow down to the mean velocity of the drift."""
        damped = self._step = _step_of(self.law.rate, step.dt)
        step.kick, step.booked, step.last_kick = damped.held_kick, damped.booked, damped.last_kick
        step.path, step.against = damped.path, self.law.against
        _write_against(self.law, self._kicked)
        _begin(self.law, self._kicked, damped)
        _write_slowed(self.law, self._kicked)
        self._exchanges.append(_exchange_of(self.law.sums, BEFORE))
        step.profile.mark(self.kind.short_name)

    def held(self, step: PresentStep) -> None:
        """Add the part of the loss that is due to held contacts."""
        loss = _lost_in_hold(self.law, self._kicked, self._step)
        self._exchanges.append(Exchange(loss, np.zeros(3), np.zeros(3)))

    def depart(self, step: PresentStep) -> None:
        """Note the velocities before impacts."""
        self._before[:] = self._bodies.ends.velocity

    def struck(self, step: PresentStep) -> None:
        """Add the exchange due to impacts; report to the audit the changes of velocity beyond the impulses."""
        sums, ends, change = np.zeros(1, SUMS), self._bodies.ends, self._before.copy()
        state = change, ends.acceleration, ends.inverse_mass, self.uniform
        _exchange_in_impacts(step.impacts.log, step.impacts.after, *state, self._step, sums)
        self._exchanges.append(_exchange_of(sums))
        if step.audit:
            step.audit.add_force(change[: len(self._bodies)])

    def kick_after(self, step: PresentStep) -> None:
        """Slow down from the mean velocity of the drift, then kick."""
        _end(self.law, self._kicked, self._step)
        self._exchanges.append(_exchange_of(self.law.sums, AFTER))
        step.profile.mark(self.kind.short_name)


def _exchange_of(sums: RecordArray[DragSumsRecord], row: int = 0) -> Exchange:
    impulse, angular_impulse = columns(sums, ("px", "py", "pz")), columns(sums, ("Lx", "Ly", "Lz"))
    return Exchange(float(sums["lost"][row]), impulse[row].copy(), angular_impulse[row].copy())


def make(scene: Scene, bodies: Bodies, team: Team) -> StokesDrag:
    """Return the drag of a scene."""
    assert scene.drag is not None, "the scene requires drag"
    return StokesDrag(scene.drag, bodies, np.array(scene.gravity.uniform), team)


def _with_drag(function: Callable[..., Any]) -> Callable[[Function], Function]:
    """Let kernels call the decorated function instead of its namesake in `kick_drift` if the law is a `DragLaw`."""
    return for_first(function, lambda kind: getattr(kind, "instance_class", None) is DragLaw)


@_with_drag(damped_step)
def _damped_step(damping: DragLaw, length: float, kick: float, last_kick: float) -> DampedStep:
    return _step_of(damping.rate, length)


@_with_drag(kick_before_drift)
def _slow_down_before(damping: DragLaw, bodies: KickedBodies, step: DampedStep, holds: bool) -> None:
    if holds:
        _write_against(damping, bodies)
    _begin(damping, bodies, step)
    if holds:
        _write_slowed(damping, bodies)
    damping.held[0] = 0.0


@_with_drag(measure_hold)
def _measure_hold(damping: DragLaw, bodies: KickedBodies, step: DampedStep) -> None:
    damping.held[0] = _lost_in_hold(damping, bodies, step)


@_with_drag(kick_after_drift)
def _slow_down_after(damping: DragLaw, bodies: KickedBodies, step: DampedStep) -> None:
    _end(damping, bodies, step)


@_with_drag(book_exchange)
def _book_exchange(damping: DragLaw) -> None:
    for row in range(2):
        part = damping.sums[row]
        terms = (part.lost, part.px, part.py, part.pz, part.Lx, part.Ly, part.Lz)
        for k in range(7):
            damping.exchanged[k] += terms[k]
        if row == BEFORE:
            damping.exchanged[0] += damping.held[0]


@kernel
def _step_of(rate: float, dt: float) -> DampedStep:
    """Return the kicks and factors of a step of dt seconds, with drag at a rate in 1/s."""
    decay, phi1, phi2 = exponentials(dt * rate)
    first, held = dt * (phi2 / phi1), dt * phi2
    last = dt * (phi1 - decay * (phi2 / phi1))
    path = DampedPath(first, rate, 1.0)
    if dt * rate > MOST_RELAXATIONS:
        _, phi1_longest, phi2_longest = exponentials(MOST_RELAXATIONS)
        damping = MOST_RELAXATIONS / dt
        path = DampedPath(dt * (phi2_longest / phi1_longest), damping, rate / damping)
    return DampedStep(dt, first, phi1, decay / phi1, last, 0.5 * (held + last * last / held), held, path)


@kernel
def _write_against(law: DragLaw, bodies: KickedBodies) -> None:
    """Write the accelerations at the beginning of a step, against which contacts are held."""
    for i in range(len(bodies.mass)):
        for k in range(3):
            law.against[i, k] = bodies.a[i, k] - bodies.v[i, k] * law.rate


@kernel
def _write_slowed(law: DragLaw, bodies: KickedBodies) -> None:
    """Write the velocities along the drift, before contacts are held."""
    for i in range(len(bodies.mass)):
        for k in range(3):
            law.slowed[i, k] = bodies.v[i, k]


@kernel
def _begin(law: DragLaw, bodies: KickedBodies, step: DampedStep) -> None:
    """Kick and slow down before the drift; write loss, impulse and angular impulse."""
    x, v, a, mass, inverse_mass = bodies
    total, h, booked, kick, factor = law.sums[BEFORE], step.length, step.booked, step.first_kick, step.before
    _clear(total)
    for i in range(len(mass)):
        if inverse_mass[i] == 0.0:
            continue
        v2, w2, work, a2 = 0.0, 0.0, 0.0, 0.0
        for k in range(3):
            kicked = v[i, k] + a[i, k] * kick
            w = kicked * factor
            v2 += v[i, k] * v[i, k]
            w2 += w * w
            work += a[i, k] * w
            a2 += a[i, k] * a[i, k]
            v[i, k] = kicked
        total.lost += mass[i] * (0.5 * (v2 - w2) + booked * work - 0.5 * booked * (h - booked) * a2)
        _slow_down(i, x, v, mass[i], law.outer, kick, factor, total)


@kernel
def _end(law: DragLaw, bodies: KickedBodies, step: DampedStep) -> None:
    """Slow down and kick after the drift; write loss, impulse and angular impulse."""
    x, v, a, mass, inverse_mass = bodies
    total, h, booked, kick, factor = law.sums[AFTER], step.length, step.booked, step.last_kick, step.after
    _clear(total)
    for i in range(len(mass)):
        if inverse_mass[i] == 0.0:
            continue
        v2, w2, work, a2, blown = 0.0, 0.0, 0.0, 0.0, 0.0
        for k in range(3):
            w2 += v[i, k] * v[i, k]
            work += a[i, k] * v[i, k]
            blown += law.wind[k] * v[i, k]
            a2 += a[i, k] * a[i, k]
        _slow_down(i, x, v, mass[i], law.outer, kick, factor, total)
        for k in range(3):
            v[i, k] += a[i, k] * kick
            v2 += v[i, k] * v[i, k]
        lost = 0.5 * (w2 - v2) + (h - booked) * work - h * blown + 0.5 * booked * (h - booked) * a2
        total.lost += mass[i] * lost


@inline
def _clear(total: DragSumsRecord) -> None:
    total.lost = total.px = total.py = total.pz = total.Lx = total.Ly = total.Lz = 0.0


@kernel
def _slow_down(
    i: int,
    x: FloatArray,
    v: FloatArray,
    mass: float,
    outer: FloatArray,
    kick: float,
    factor: float,
    total: DragSumsRecord,
) -> None:
    """Multiply a velocity by a factor; add the external impulse of factor and kick, and its moment."""
    px = mass * (v[i, 0] * (factor - 1.0) + outer[0] * kick)
    py = mass * (v[i, 1] * (factor - 1.0) + outer[1] * kick)
    pz = mass * (v[i, 2] * (factor - 1.0) + outer[2] * kick)
    for k in range(3):
        v[i, k] *= factor
    total.px += px
    total.py += py
    total.pz += pz
    total.Lx += x[i, 1] * pz - x[i, 2] * py
    total.Ly += x[i, 2] * px - x[i, 0] * pz
    total.Lz += x[i, 0] * py - x[i, 1] * px


@kernel
def _lost_in_hold(law: DragLaw, bodies: KickedBodies, step: DampedStep) -> float:
    """Sum κ m Δv·(a - against): the contacts have booked κ m Δv·against, but the kick books κ m Δv·a."""
    v, a, before, against, lost = bodies.v, bodies.a, law.slowed, law.against, 0.0
    for i in range(len(bodies.mass)):
        for k in range(3):
            lost += step.booked * bodies.mass[i] * (v[i, k] - before[i, k]) * (a[i, k] - against[i, k])
    return lost


@kernel
def _exchange_in_impacts(
    log: RecordArray[ImpactRecord],
    after: FloatArray,
    w: FloatArray,
    a: FloatArray,
    inverse_mass: FloatArray,
    wind: FloatArray,
    step: DampedStep,
    sums: RecordArray[DragSumsRecord],
) -> None:
    """Add the exchange with the medium due to impacts to ``sums``, and write the changes of velocities to ``w``.

    Summed over both bodies of each impact, with w̄ the mean of w before and after it:

        lost = Σ m Δw·((f² - 1) w̄ + f (σ - k) a + (κ - σ) a + σ u/τ),    impulse = Σ m Δw (1 - f)
    """
    (kick, damping, strength), booked, total = step.path, step.booked, sums[0]
    change = np.zeros_like(w)
    for row in range(len(log)):
        entry = log[row]
        sigma = entry.clock
        s = sigma - kick
        f = 1.0 - damping * s
        for end in range(2):
            i = entry.i if end == 0 else entry.j
            if inverse_mass[i] == 0.0:
                continue
            arm = -entry.arm_i if end == 0 else entry.arm_j
            px, py, pz = 0.0, 0.0, 0.0
            for k in range(3):
                old, new = w[i, k], (after[row, end, k] - strength * a[i, k] * s) / f
                w[i, k] = new
                lost = (f * f - 1.0) * (0.5 * (old + new)) + (strength * f * s + booked - sigma) * a[i, k]
                total.lost += (new - old) / inverse_mass[i] * (lost + sigma * wind[k])
                slowed = (new - old) * (1.0 - f)
                change[i, k] += slowed
                px, py, pz = py, pz, slowed / inverse_mass[i]
            x, y, z = entry.x + arm * entry.nx, entry.y + arm * entry.ny, entry.z + arm * entry.nz
            total.px += px
            total.py += py
            total.pz += pz
            total.Lx += y * pz - z * py
            total.Ly += z * px - x * pz
            total.Lz += x * py - y * px
    w[:] = change
