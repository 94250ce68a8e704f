"""Finds the step that keeps an accuracy, by running the scene ahead with longer steps.

A run with steps of h has the error e(t). The same scene run with h and with h/2 differs by D(t), and

    e(t) of the finer run = D(t) / (2^p - 1),     e(t) with steps 2^j times shorter = e(t) / 2^{p j}

for an integrator of order p, or for the order that three such runs show, if that is lower. D contains everything that
makes errors grow, contacts and chaos too. The runs begin with the longest useful steps and halve them until the
extrapolation to the required step is short. Then the run itself takes that step, and never has to be repeated.

Chaos ends every promise. A twin run that starts displaced by `DISPLACEMENT` shows by which factor G(t) errors grow.
Rounding alone makes an error of ρ G(t). The horizon is the time at which 2 e(t) + ρ G(t) exceeds the accuracy. The
largest Lyapunov exponent is ln G(t) / t, at the end or when the twins are `APART`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from carom.physics.error import PhysicsError
from carom.physics.periodic_box import minimum_images
from carom.physics.schedule import at
from carom.plan.auto import integrator
from carom.plan.features import require
from carom.scene.error import SceneError
from carom.scene.integrators import INTEGRATORS
from carom.scene.placement import Start, place
from carom.scene.schema import Promise, Scene

FloatArray = NDArray[np.float64]

SAMPLES = 64  # times at which runs are compared
LONGEST = 1.0  # refinement of the longest useful steps
SAFETY = 3.0  # times smaller than requested is the error that the step is chosen for
MARGIN = 2.0  # times the extrapolated error is the one that is expected; without it, a horizon was late
FARTHEST = 3  # halvings of the step beyond the finest run ahead; its run costs an eighth of the run itself
TRIED = 2  # comparisons before an order is believed
BODIES_PER_STEP = 30  # the time of a step does not fall below that of about so many bodies
NEARLY = 0.95  # of the longest time that the accuracy can be kept, with fewer steps
MOST_WORK = 2e6  # of the finest run ahead, some seconds; the run itself takes up to eight times as long
FALLING = 0.7  # largest part of the distance that a halving should leave
MOST_IDLE = 3  # halvings in a row that do not
DISPLACEMENT = 1e-9  # of the twin, over the size of the system
APART = 1e-2  # of the size; beyond, twins no longer part exponentially
LARGEST_ERROR = 1.0  # of the size; no larger one is told apart
EPS = float(np.finfo(np.float64).eps)
ROUNDING = 8.0  # ρ in units of the last bit of the coordinates
LOWEST = 64.0  # smallest accuracy in units of ρ
RADAU_LEVELS = ((2.0**-1.5, 1e-9), (0.5, 1e-12), (1.0, 0.0))  # refinement, and error of a run whose errors do not grow


@dataclass(frozen=True, slots=True)
class Growth:
    """Growth of a small displacement with time."""

    factor: FloatArray  # (K,) largest so far
    exponent: float  # 1/s


def settled(scene: Scene, threads: int | None = None, start: Start | None = None) -> Scene:
    """Return a scene with the step that its accuracy takes, as a [promise]; others are returned as they are.

    Raises
    ------
    SceneError
        If double precision cannot give the accuracy.
    PhysicsError
        If no run ahead comes to an end.
    """
    if scene.time.accuracy is None or scene.promise is not None:
        return scene
    return _LookAhead(scene, scene.time.accuracy, threads, start or place(scene)).settle()


class _Run:
    """A run that goes only as far as it is looked at."""

    def __init__(self, scene: Scene, refinement: float, threads: int | None, start: Start, times: FloatArray) -> None:
        from carom.physics.space import Space  # noqa: PLC0415 - a Space looks ahead before it begins

        promise = Promise(refinement=refinement, until=scene.time.duration, lyapunov=0.0, error=(0.0,))
        self.refinement = refinement
        self.rests_from = math.inf  # s, when contacts came to rest that the integrator does not hold itself
        self._space = Space(_promised(scene, promise), threads, start)
        self._chooses_steps = integrator(scene).controls_error
        self._times = times
        self._positions: list[FloatArray] = []  # (n, 3) m, at the times so far

    @property
    def work(self) -> float:
        """What all its steps would cost, by its steps so far: a step costs as much as `BODIES_PER_STEP` bodies more."""
        steps = self._space.step * len(self._times) / max(len(self._positions), 1)
        return steps * (self._space.scene.count + BODIES_PER_STEP)

    def at(self, sample: int) -> FloatArray | None:
        """Return the positions at one of the times, (n, 3) m; None where it fails before."""
        try:
            while len(self._positions) <= sample:
                for _ in self._space.run(float(self._times[len(self._positions)]), schedule=at(())):
                    pass
                if self._chooses_steps and not self._space.has_solution:
                    self.rests_from = min(self.rests_from, self._space.time)
                self._positions.append(self._space.state.position.copy())
        except PhysicsError:
            return None  # too long a step
        return self._positions[sample]


class _LookAhead:
    def __init__(self, scene: Scene, accuracy: float, threads: int | None, start: Start) -> None:
        self._scene, self._accuracy, self._threads, self._start = scene, accuracy, threads, start
        self._box = np.array(scene.domain.size) if scene.domain.boundary == "periodic" else None
        self._times = scene.time.duration * (np.arange(1, SAMPLES + 1) / SAMPLES)
        self._size = _size(start, self._box)
        self._rounding = ROUNDING * EPS * max(1.0, float(np.abs(start.position).max()) / self._size)
        if accuracy < LOWEST * self._rounding:
            raise SceneError(
                f"time.accuracy = {accuracy:g}: double precision can give {LOWEST * self._rounding:.1e} for bodies "
                "where this scene has them"
            )

    def settle(self) -> Scene:
        if integrator(self._scene).controls_error:
            return self._settle_radau()
        if not require(self._scene).pulls:  # flights and times of impact are exact, whatever the step
            growth = self._growth(self._run(LONGEST))
            return self._promise(LONGEST, self._rounding * growth.factor, growth)
        return self._settle_steps(integrator(self._scene).order)

    def _settle_radau(self) -> Scene:
        run = self._run(RADAU_LEVELS[0][0])
        growth = self._growth(run)
        errors = {refinement: (level + self._rounding) * growth.factor for refinement, level in RADAU_LEVELS}
        enough = (refinement for refinement, error in errors.items() if SAFETY * error[-1] <= self._accuracy)
        chosen = next(enough, RADAU_LEVELS[-1][0])
        if run.rests_from < _kept(self._times, errors[chosen], self._accuracy):
            return self._settle_steps(INTEGRATORS["leapfrog"].order)
        return self._promise(chosen, errors[chosen], growth)

    def _settle_steps(self, order: int) -> Scene:
        refinement = LONGEST
        coarse, apart, idle = self._run(refinement), list[FloatArray](), 0
        while True:
            refinement *= 2.0
            fine = self._run(refinement)
            apart.append(self._apart(coarse, fine, 1.0))
            chosen, kept, error = self._extrapolate(apart, order)
            idle = idle + 1 if self._stays(apart, kept) else 0
            if kept >= self._times[-1] or idle == MOST_IDLE or fine.work > MOST_WORK:
                break
            coarse = fine
        growth = self._growth(fine if chosen >= 0 else coarse)
        return self._promise(refinement * 2.0**chosen, MARGIN * error + self._rounding * growth.factor, growth)

    def _stays(self, apart: list[FloatArray], kept: float) -> bool:
        """Tell whether the last halving hardly changed the distance where the accuracy is not kept any more."""
        k = min(int(np.searchsorted(self._times, kept, side="right")), SAMPLES - 1)
        return len(apart) > 1 and bool(FALLING * apart[-2][k] < apart[-1][k] < APART)

    def _extrapolate(self, apart: list[FloatArray], highest: int) -> tuple[int, float, FloatArray]:
        """Return how many times to halve the finer step, up to when the accuracy is kept then, in s, and the error.

        -1 takes the coarser step. The factor in front of h^p depends on where in its step an impact happens, so the
        largest of the last three distances counts, each as far as it should have fallen since.
        """
        order = _observed(apart, highest)
        latest = apart[-1:-4:-1]
        distance = np.max([each / 2.0 ** (order * age) for age, each in enumerate(latest)], axis=0)
        surely = len(apart) >= TRIED and bool(latest[0].any())
        if not surely:
            return FARTHEST, 0.0, distance
        tried = range(-1, FARTHEST + 1)
        errors = [distance / (1.0 - 2.0**-order) / 2.0 ** (order * (halvings + 1)) for halvings in tried]
        kept = [_kept(self._times, SAFETY * error, self._accuracy) for error in errors]
        k = next(k for k, until in enumerate(kept) if until >= NEARLY * max(kept))
        return tried[k], kept[k], errors[k]

    def _growth(self, run: _Run) -> Growth:
        """Return by how much a displacement grows, with the steps of a run."""
        moved = _displaced(self._start, DISPLACEMENT * self._size)
        apart = self._apart(run, self._run(run.refinement, moved), APART)
        over = np.flatnonzero(~(apart < APART))
        last = int(over[0]) if len(over) else len(apart) - 1  # beyond, the growth goes on as up to here
        apart[last] = min(apart[last], 1.0)
        exponent = math.log(max(apart[last], EPS) / DISPLACEMENT) / float(self._times[last])
        factor = np.maximum(apart / DISPLACEMENT, 1.0)
        factor[last + 1 :] = factor[last] * np.exp(max(exponent, 0.0) * (self._times[last + 1 :] - self._times[last]))
        return Growth(factor, exponent)

    def _apart(self, one: _Run, other: _Run, enough: float) -> FloatArray:
        """Compare two runs until they are apart; return the largest distance so far over the size, (K,)."""
        apart = np.full(SAMPLES, np.inf)
        largest = 0.0
        for k in range(SAMPLES):
            a, b = one.at(k), other.at(k)
            if a is None or b is None:
                break
            d = a - b if self._box is None else minimum_images(a - b, self._box)
            largest = max(largest, math.sqrt(float(np.mean(np.sum(d * d, axis=1)))) / self._size)
            apart[k] = largest
            if not largest < enough:
                break
        return apart

    def _run(self, refinement: float, start: Start | None = None) -> _Run:
        return _Run(self._scene, refinement, self._threads, start or self._start, self._times)

    def _promise(self, refinement: float, error: FloatArray, growth: Growth) -> Scene:
        until = self._scene.time.duration
        kept = _kept(self._times, error, self._accuracy)
        horizon = kept if kept < until else None
        return _promised(
            self._scene,
            Promise(
                refinement=refinement,
                until=until,
                horizon=horizon,
                lyapunov=float(f"{growth.exponent:.6g}"),
                error=tuple(float(f"{min(each, LARGEST_ERROR):.3g}") for each in error.tolist()),
            ),
        )


def _promised(scene: Scene, promise: Promise) -> Scene:
    """Return a scene with a promise."""
    values = promise.model_dump(exclude_none=True)
    overrides = [
        f"promise.{key}={list(value) if isinstance(value, tuple) else value!r}" for key, value in values.items()
    ]
    return scene.changed(overrides)


def _size(start: Start, box: FloatArray | None) -> float:
    """Return half the box, the rms distance of the bodies from their centre, or that of one body from 0, in m."""
    if box is not None:
        return float(box.min()) / 2.0
    apart = start.position - start.position.mean(axis=0)
    size = math.sqrt(float(np.mean(np.sum(apart * apart, axis=1))))
    return size or float(np.abs(start.position).max()) or float(start.radius.max())


def _displaced(start: Start, distance: float) -> Start:
    """Return a start whose free bodies are displaced by an rms distance in m."""
    direction = 2.0 * np.random.default_rng(0).random(start.position.shape) - 1.0  # of rms length 1
    moved = np.where(start.fixed[:, np.newaxis], 0.0, direction * distance)
    return replace(start, position=start.position + moved)


def _observed(apart: list[FloatArray], order: int) -> float:
    """Return the order that the last distances show where all are comparable, from 1 to that of the integrator."""
    coarse, fine = apart[max(0, len(apart) - 3)], apart[-1]
    usable = np.flatnonzero((coarse < APART) & (coarse > 0.0) & (fine > 0.0))
    if len(apart) < TRIED or not len(usable):
        return 1.0
    k = int(usable[-1])
    return min(max(math.log2(coarse[k] / fine[k]) / min(2, len(apart) - 1), 1.0), float(order))


def _kept(times: FloatArray, error: FloatArray, accuracy: float) -> float:
    """Return the time at which the error exceeds the accuracy, in s; the last if it does not."""
    over = np.flatnonzero(~(error <= accuracy))
    if not len(over):
        return float(times[-1])
    k = int(over[0])
    if k == 0:
        return 0.0
    low, high = error[k - 1], error[k]
    share = 0.0
    if math.isfinite(high) and low > 0.0:
        share = math.log(accuracy / low) / math.log(high / low)
    return float(times[k - 1] + share * (times[k] - times[k - 1]))
