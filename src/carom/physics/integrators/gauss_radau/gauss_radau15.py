"""Gauss–Radau integration of order 15 with steps chosen by its error estimate, for forces that depend on positions.

Within a step of length T the acceleration of a coordinate is a polynomial in h = t/T, 0 ≤ h ≤ 1 (Everhart 1985):

    a(h) = a₀ + b₀ h + b₁ h² + … + b₆ h⁷
    x(h) = x₀ + h T v₀ + (h T)² (a₀/2 + Σ b_k h^{k+1} / ((k+2)(k+3)))
    v(h) = v₀ + h T (a₀ + Σ b_k h^{k+1} / (k+2))

The polynomial interpolates the accelerations at the eight Gauss–Radau nodes h₀ = 0, …, h₇. The accelerations depend on
the positions, so the coefficients are determined by iteration, starting from the extrapolated polynomial of the
previous step. Newton's form

    a(h) = a₀ + g₀ h + g₁ h (h - h₁) + g₂ h (h - h₁)(h - h₂) + …

lets each node determine one g. All terms after g_{s-1} vanish at h_s, so the residual of the polynomial there is the
error of g_{s-1} times h_s (h_s - h₁) … (h_s - h_{s-1}). With compensated summation, the energy error of a planetary
system is a random walk in the last bit (Rein & Spiegel 2015).

The next step is a fraction η of the shortest time in which the acceleration of a body changes. This time follows from
the acceleration's first three derivatives at the end of the step (Pham, Rein & Spiegel 2024; Aarseth 1985):

    T' = η min_i max(τ_i, τ'_i / 4),        η = (5040 ε)^{1/7}, ε = 10⁻⁹
    τ_i = √(2 a² / (ȧ² + a ä)),             τ'_i = √((a ä + ȧ²) / (ȧ a⃛ + ä²))

τ vanishes where an acceleration passes through 0, as on the figure-eight orbit. With τ alone, this orbit would take
five times as many steps.

The estimate uses only sums, products, quotients and square roots, so the bits are the same on any processor.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from carom.arrays import FloatArray, RecordArray
from carom.physics.bodies import Bodies
from carom.physics.forces.kernel_forces import parameters_of_all
from carom.physics.integrators.batch_integrator import Batch, Meeting
from carom.physics.integrators.gauss_radau.radau_impacts import (
    AT_REST,
    NONE,
    Solids,
    first_impact,
    max_displacement,
    time_to_touch,
)
from carom.physics.integrators.gauss_radau.radau_step import (
    CONVERGED,
    LARGEST_CHANGE,
    PROGRESS,
    TERMS,
    WIDTH,
    Motion,
    ProgressRecord,
    accelerate,
    attempt,
    motion_of,
    move,
    shorten,
    tolerance,
)
from carom.physics.jit.decorators import entry_of, inner, long_kernel
from carom.physics.step_rule import END_TOLERANCE
from carom.plan.auto import largest_step
from carom.plan.features import Requirements
from carom.scene.load import Scene
from carom.scene.start import half_spaces
from carom.state.checkpoint import IntegratorCheckpoint

STEP_FRACTION = 0.17506702932189996  # η
# the step after an impact is repeated if it is too long by more than this factor, since velocities have changed
LARGEST_CHANGE_AFTER_IMPACT = 1.5
# largest number of corrections to the length of a step that ends at an impact; two are enough to reach rounding
MOST_CORRECTIONS = 4
IMPACT_ROUNDING = 2.0**-51  # relative rounding of the length of a step that ends at an impact
LIMITS = ("error", "cap", "fixed", "end", "impact")  # limits that shorten a step
ERROR, CAP, FIXED, END, IMPACT = range(len(LIMITS))


class GaussRadau15:
    """Integrates bodies that attract each other, many steps per call.

    Without a ``fixed_dt`` (s), the error estimate sets the steps, to a fraction η of the shortest time in which an
    acceleration changes. The iterations of a step end once the residuals at the nodes are below ``tolerance`` times the
    largest acceleration. ``solids`` are the bodies and planes that may touch; None if nothing can touch.
    """

    def __init__(
        self,
        motion: Motion,
        max_dt: float,
        fixed_dt: float | None,
        fraction: float = STEP_FRACTION,
        solids: Solids | None = None,
        tolerance: float = CONVERGED,
    ) -> None:
        self._motion = motion
        self._max_dt = float(max_dt if fixed_dt is None else fixed_dt)
        self._adapts = fixed_dt is None
        self._fraction, self._tolerance = fraction, tolerance
        self._solids = solids
        self._progress = np.zeros(1, PROGRESS)
        kinds = self._motion, solids, self._progress, 0.0, 0.0, 0, self._max_dt, self._adapts
        self._advance: Callable[..., None] = entry_of(advance, *kinds)
        self._arrival = motion.velocity  # velocities at the end of the last step, before its impacts

    @property
    def next_dt(self) -> float:
        """The length of the next step in seconds."""
        return float(self._progress["next_dt"][0])

    @property
    def last_dt(self) -> float:
        """The length of the last step in seconds."""
        return float(self._progress["last_dt"][0])

    @property
    def iterations(self) -> int:
        """Number of iterations of all steps so far."""
        return int(self._progress["iterations"][0])

    def begin(self, dt: float) -> None:
        """Start anew at the present positions and velocities, with a first step of about dt seconds."""
        motion = self._motion
        for array in (motion.position_compensation, motion.velocity_compensation, motion.accepted, motion.correction):
            array[:] = 0.0
        self._progress[0] = np.zeros(1, PROGRESS)[0]
        self._progress["next_dt"], self._progress["after_impact"] = dt, self._solids is not None
        self._progress["fraction"], self._progress["tolerance"] = self._fraction, self._tolerance

    def advance(self, time: float, end: float, until: float, steps: int) -> Batch:
        """Take steps until a time, the end of the run, or a number of steps is reached; see `BatchIntegrator`."""
        last = self._progress[0]
        last["time"], last["steps"] = time, 0
        rule = self._max_dt, self._adapts
        self._advance(self._motion, self._solids, self._progress, end, until, steps, *rule)
        times = float(last["before"]), float(last["time"]), float(last["last_dt"])
        meeting = Meeting((int(last["i"]), int(last["j"])), bool(last["rests"])) if last["meets"] else None
        self._arrival = self._motion.velocity.copy() if meeting else self._motion.velocity
        return Batch(int(last["steps"]), *times, LIMITS[last["limit"]], meeting)

    def at(self, earlier: float) -> tuple[FloatArray, FloatArray]:
        """Return positions and velocities, (n, 3) m and m/s, at a time (s) before the end of the last step."""
        motion, dt = self._motion, self.last_dt
        h = (dt - earlier) / dt
        a = motion.start + motion.field * motion.moves[:, np.newaxis]
        b = motion.accepted.reshape(*a.shape, WIDTH)[..., :TERMS]
        k = np.arange(TERMS)
        # powers h, h²…; written out, since the bits of matrix products and `pow` differ between processors
        powers = np.cumprod(np.full(TERMS + 2, h))
        turned = dt * ((1.0 - h) * a + (b * ((1.0 - powers[1:-1]) / (k + 2))).sum(axis=-1))
        v = self._arrival - turned
        begin = self._arrival - dt * (a + (b / (k + 2)).sum(axis=-1))
        bent = 0.5 * (1.0 - h * h) * a + (b * ((1.0 - powers[2:]) / ((k + 2) * (k + 3)))).sum(axis=-1)
        return motion.position - (earlier * begin + dt * dt * bent), v

    @property
    def checkpoint(self) -> IntegratorCheckpoint:
        """A copy of the state that the next step needs."""
        motion, last = self._motion, self._progress[0]
        compensations = motion.position_compensation.copy(), motion.velocity_compensation.copy()
        last_dt = 0.0 if last["after_impact"] else float(last["last_dt"])
        return IntegratorCheckpoint(last_dt, *compensations, motion.accepted.copy(), motion.correction.copy())

    def restore(self, checkpoint: IntegratorCheckpoint | None, next_dt: float) -> None:
        """Continue from a checkpoint with a step of ``next_dt`` s; without a checkpoint, start anew."""
        motion = self._motion
        self.begin(next_dt)
        if checkpoint is None:
            return
        self._progress["last_dt"] = checkpoint.last_dt
        self._progress["after_impact"] &= checkpoint.last_dt == 0.0
        motion.position_compensation[:] = checkpoint.position_rest
        motion.velocity_compensation[:] = checkpoint.velocity_rest
        motion.accepted[:] = checkpoint.accepted
        motion.correction[:] = checkpoint.correction


def make(scene: Scene, needs: Requirements, bodies: Bodies, uniform: FloatArray) -> GaussRadau15:
    """Return the integrator of a scene's bodies in a uniform field, (3,) m/s²."""
    gravity = scene.gravity
    gm = gravity.constant * bodies.mass if needs.gravity.modelled else np.zeros(len(bodies))
    fixed = np.flatnonzero(bodies.ends.inverse_mass[: len(bodies)] == 0.0)
    refinement = min(scene.refinement, 1.0)
    steps = (largest_step(scene), scene.time.fixed_dt, STEP_FRACTION / refinement)
    planes = half_spaces(scene)
    solids = Solids.of(bodies.radius, planes.normal, planes.offset) if needs.contact.modelled else None
    forces = parameters_of_all(scene)
    motion = motion_of(bodies.position, bodies.velocity, gm, fixed, uniform, gravity.softening, bodies.mass, forces)
    return GaussRadau15(motion, *steps, solids, tolerance(refinement))


@long_kernel
def advance(
    motion: Motion,
    solids: Solids | None,
    progress: RecordArray[ProgressRecord],
    end: float,
    until: float,
    most: int,
    max_dt: float,
    adapts: bool,
) -> None:
    """Take steps; see `GaussRadau15.advance`."""
    run = progress[0]
    run.meets = run.rests = False
    planes = 0 if solids is None else len(solids.offset)
    while run.steps < most and run.time < end and (run.time < until or run.steps == 0):
        dt, limit = run.next_dt, ERROR
        if dt >= max_dt or not adapts:
            dt, limit = max_dt, CAP if adapts else FIXED
        if end - run.time <= dt * (1.0 + END_TOLERANCE):
            dt, limit = end - run.time, END
        accelerate(motion, motion.position, motion.start)
        change = LARGEST_CHANGE_AFTER_IMPACT if run.after_impact else LARGEST_CHANGE
        tried, wanted = attempt(motion, None, run, dt, change if adapts else np.inf)
        if tried < dt:
            dt, limit = tried, ERROR
        next_dt = min(wanted, LARGEST_CHANGE * dt)
        if solids is not None:
            displacement = max_displacement(motion, planes, dt)
            run.clearance -= 2.0 * displacement
            h = NONE if run.clearance > 0.0 else first_impact(motion, solids, run, dt, displacement)
            if 0.0 <= h <= 1.0:
                dt, limit = _end_at_impact(motion, solids, run, h, dt), IMPACT
            run.meets = h != NONE
            if run.meets and (h == AT_REST or not run.time + dt > run.time):
                # if no step was made, this call returns the meeting; otherwise the next call does
                run.meets = run.steps == 0
                run.rests = h == AT_REST and run.meets
                break
        move(motion, dt)
        run.before, run.limit = run.time, limit
        run.time = end if limit == END else run.time + dt
        run.last_dt, run.next_dt, run.after_impact = dt, next_dt, run.meets
        run.steps += 1
        if run.meets or not run.time > run.before:
            break  # the run has ended, or the step is NaN or too short to change the clock


@inner
def _end_at_impact(motion: Motion, solids: Solids, run: ProgressRecord, h: float, dt: float) -> float:
    """Repeat the step so that it ends where the pair in ``run`` touches; return its length in s.

    Within a step, the polynomial is less accurate than at its end, so each iteration corrects the length.
    """
    run.clearance = 0.0
    ratio = h
    for _ in range(MOST_CORRECTIONS):
        dt *= ratio
        if not run.time + dt > run.time:
            break
        shorten(motion, run, dt, ratio)
        missing = time_to_touch(motion, solids, run.i, run.j, dt)
        if not (abs(missing) > IMPACT_ROUNDING * dt and dt + missing > 0.0):
            break
        ratio = 1.0 + missing / dt
    return float(dt)
