"""Finds the step that keeps an accuracy, by running the scene ahead with longer steps.

A run with steps of h has the error e(t). The same scene run with h and with h/2 differs by D(t), and

    e(t) of the finer run = D(t) / (2^p - 1),     e(t) with steps 2^j times shorter = e(t) / 2^{p j}

for an integrator of order p, or for the order that three such runs show, if that is lower. D contains everything that
makes errors grow, contacts and chaos too. The runs begin with the longest useful steps and halve them until the
extrapolation to the required step is short. Then the run itself takes that step, and never has to be repeated.

Chaos ends every promise. A twin run that starts slightly displaced shows how errors grow. Rounding alone makes an error
r(t) in proportion to the distance of the twins. The horizon is the time at which 2 e(t) + r(t) exceeds the accuracy.
Twins with gauss-radau15, which errs by rounding, start a last bit apart, so they show its error itself. The largest
Lyapunov exponent is that of their distance, to the end or until they are `APART`.
"""

from __future__ import annotations

import math
from copy import copy
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from carom.physics.error import PhysicsError
from carom.physics.integrators.radau_twin import part
from carom.physics.orbits_ahead import look_at_orbits
from carom.physics.periodic_box import minimum_images
from carom.plan.auto import integrator
from carom.plan.features import require
from carom.plan.hierarchy import orbits_often
from carom.scene.error import SceneError
from carom.scene.integrators import AUTO, INTEGRATORS
from carom.scene.placement import Start, place
from carom.scene.schema import Expect, Promise, Scene

FloatArray = NDArray[np.float64]

SAMPLES = 64  # times at which runs are compared
FEWER_SAMPLES = (4, 32)  # where bodies meet, and pausing costs more than the steps: more only if a promise ends
LONGEST = 1.0  # refinement of the longest useful steps
EXACT = 2.0**-8  # refinement of a run ahead whose steps err by rounding only; shorter ones cost more
EXACT_OF_MANY = 0.125  # likewise; in longer steps each body has more others within reach
FEW = 200  # bodies
FEWEST_ORBITS = 30.0  # of the innermost body; the first ones cost little with gauss-radau15
FINEST_OF_ORBITS = 1e-7  # accuracy; gauss-radau15 keeps a finer one for less than wisdom-holman
HILL_RADII = 3.0  # between orbits, so that encounters are rare
SAMPLES_OF_ORBITS = 16  # each takes a corrector and its inverse
SAFETY = 3.0  # times smaller than requested is the error that the step is chosen for
MARGIN = 2.0  # times the extrapolated error is the one that is expected; without it, a horizon was late
FARTHEST = 3  # halvings of the step beyond the finest run ahead; its run costs an eighth of the run itself
TRIED = 2  # comparisons before an order is believed
NEVER = 2**62  # steps between two checks of the energy of a run ahead
BODIES_PER_STEP = 30  # the time of a step does not fall below that of about so many bodies
NEARLY = 0.95  # of the longest time that the accuracy can be kept, with fewer steps
MOST_WORK = 2e6  # of the finest run ahead, some seconds; the run itself takes up to eight times as long
FALLING = 0.7  # largest part of the distance that a halving should leave
MOST_IDLE = 3  # halvings in a row that do not
DISPLACEMENT = 1e-11  # of the twin, over the size of the system; beyond the rounding of many steps
# Distance from the truth over that of runs that differ by rounding. With 4, horizons were too early in 8 of 25 cases;
# with 1, errors exceeded the request before the horizon in 6 of 80, by up to a few hundredths of the time.
SPREAD = 1.3
APART = 1e-2  # of the size; beyond, twins no longer part exponentially
LARGEST_ERROR = 1.0  # of the size; no larger one is told apart
EPS = float(np.finfo(np.float64).eps)
ROUNDING = 8.0  # ρ in units of the last bit of the coordinates
LOWEST = 64.0  # smallest accuracy in units of ρ
RADAU_AHEAD = 2.0**-1.5  # refinement of a run ahead with gauss-radau15
RADAU_CHAOTIC = 0.5  # likewise, where the promise ends: its own error may not reach the accuracy before
RADAU_LEVELS = (  # refinement, and how many times the error exceeds the distance of twins: the most of 8 scenes
    (2.0**-2.5, 1e6),
    (0.25, 5e4),
    (2.0**-1.5, 2e3),
    (0.5, 20.0),
    (1.0, SPREAD),
)


@dataclass(frozen=True, slots=True)
class Twins:
    """How two runs part that begin almost alike."""

    apart: FloatArray  # (K,) largest distance so far over the size
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
        record = scene.record.model_copy(update={"check_every": NEVER})
        unchecked = scene.model_copy(update={"promise": promise, "record": record, "expect": Expect()})
        self.refinement = refinement
        self.rests_from = math.inf  # s, when contacts came to rest that the integrator does not hold itself
        self._space = Space(unchecked, threads, start)
        self._start = self._space.frame().checkpoint
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
                self._positions.append(self._next(float(self._times[len(self._positions)])))
        except PhysicsError:
            return None  # too long a step
        return self._positions[sample]

    def again(self, start: Start) -> _Run:
        """Return a run from another start with the same memory; this one goes to its end before."""
        self.at(len(self._times) - 1)
        other = copy(self)
        other.rests_from, other._positions = math.inf, []
        self._space.restore(replace(self._start, position=start.position))
        return other

    def _next(self, time: float) -> FloatArray:
        """Go on to a time in s; return the positions there, (n, 3) m."""
        space = self._space
        if not self._chooses_steps:
            space.reach(time)
            return space.state.position.copy()
        space.pass_by(time)
        solution = space.between(time)
        if solution is not None:
            return solution[0]
        self.rests_from = min(self.rests_from, space.time)
        return space.state.position.copy()


class _LookAhead:
    def __init__(self, scene: Scene, accuracy: float, threads: int | None, start: Start) -> None:
        self._scene, self._accuracy, self._threads, self._start = scene, accuracy, threads, start
        self._box = np.array(scene.domain.size) if scene.domain.boundary == "periodic" else None
        self._times = _samples(scene, SAMPLES)
        self._size = _size(start, self._box)
        self._last_bit = EPS * max(1.0, float(np.abs(start.position).max()) / self._size)
        least = LOWEST * ROUNDING * self._last_bit
        if accuracy < least:
            raise SceneError(
                f"time.accuracy = {accuracy:g}: double precision can give {least:.1e} for bodies "
                "where this scene has them"
            )
        if integrator(scene).controls_error:  # errs by rounding, so twins that differ by a last bit show its errors
            self._twin, self._rounding = _displaced(start, 0.0), SPREAD
        else:
            self._twin, self._rounding = (
                _displaced(start, DISPLACEMENT * self._size),
                ROUNDING * self._last_bit / DISPLACEMENT,
            )

    def settle(self) -> Scene:
        if integrator(self._scene).hierarchical:
            return self._settle_orbits(persists=True) or self._scene
        if self._is_rough and orbits_often(self._scene, HILL_RADII) >= FEWEST_ORBITS:
            promised = self._settle_orbits(persists=False)
            if promised is not None:
                return promised
        if integrator(self._scene).controls_error:
            return self._settle_radau()
        if not require(self._scene).pulls:  # flights and times of impact are exact, whatever the step
            twins, _ = self._part_at_impacts(EXACT if self._scene.count <= FEW else EXACT_OF_MANY)
            return self._promise(LONGEST, self._rounding * twins.apart, twins.exponent)
        return self._settle_steps(integrator(self._scene).order)

    @property
    def _is_rough(self) -> bool:
        """Whether Wisdom–Holman integration may keep the accuracy for less than Gauss–Radau integration."""
        return self._scene.time.integrator == AUTO and self._accuracy >= FINEST_OF_ORBITS

    def _settle_radau(self) -> Scene:
        rests_from = math.inf
        if require(self._scene).contact.modelled:
            twins, rests_from = self._part_at_impacts(RADAU_AHEAD)
        else:
            twins = self._part_of_orbits(RADAU_AHEAD, 1)
            if SPREAD * twins.apart[-1] > self._accuracy:  # the run ahead has to be as true as the promise lasts
                twins = self._part_of_orbits(RADAU_CHAOTIC, 3)
        errors = {refinement: level * twins.apart for refinement, level in RADAU_LEVELS}
        enough = (refinement for refinement, error in errors.items() if SAFETY * error[-1] <= self._accuracy)
        chosen = next(enough, RADAU_LEVELS[-1][0])
        if rests_from < _kept(self._times, errors[chosen], self._accuracy):
            return self._settle_steps(INTEGRATORS["leapfrog"].order)
        return self._promise(chosen, errors[chosen], twins.exponent)

    def _part_of_orbits(self, refinement: float, iterations: int) -> Twins:
        """Return how bodies without contacts and their twins part."""
        enough, twin = APART * self._size, self._twin.position
        apart = part(self._scene, self._start, twin, refinement, self._times, enough, iterations)
        return _grown(self._times, np.maximum.accumulate(apart) / self._size, self._began)

    def _settle_orbits(self, persists: bool) -> Scene | None:
        """Return the scene with a promise of Wisdom–Holman integration; None if that is not worth it."""
        times, most = _samples(self._scene, SAMPLES_OF_ORBITS), self._accuracy * self._size / SAFETY
        found = look_at_orbits(self._scene, self._start, times, self._accuracy, most, persists)
        if not (found.keeps or persists):
            return None
        error = np.interp(self._times, _with_start(times, 0.0), _with_start(found.error / self._size, 0.0))
        chosen: Literal["wisdom-holman"] | None = "wisdom-holman" if self._scene.time.integrator == AUTO else None
        return self._promise(found.refinement, MARGIN * error, found.exponent, chosen)

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
        run = fine if chosen >= 0 else coarse
        twins = self._part(run, self._run(run.refinement, self._twin))
        return self._promise(refinement * 2.0**chosen, MARGIN * error + self._rounding * twins.apart, twins.exponent)

    def _stays(self, apart: list[FloatArray], kept: float) -> bool:
        """Tell whether the last halving hardly changed the distance where the accuracy is not kept any more."""
        k = min(int(np.searchsorted(self._times, kept, side="right")), len(self._times) - 1)
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

    def _part_at_impacts(self, refinement: float) -> tuple[Twins, float]:
        """Return how a run that bounces and its twin part, and when contacts come to rest, in s."""
        if self._scene.count > FEW:
            run = self._run(refinement)
            return self._part(run, self._run(refinement, self._twin)), run.rests_from
        for count in FEWER_SAMPLES:
            times = self._times = _samples(self._scene, count)
            run = self._run(refinement)
            twins = self._part(run, run.again(self._twin))
            if self._rounding * twins.apart[-1] <= self._accuracy:
                break
        self._times = _samples(self._scene, SAMPLES)
        return self._between(times, twins, self._began), run.rests_from

    def _between(self, times: FloatArray, twins: Twins, began: float) -> Twins:
        """Return what is known of twins at some times at all times; the distance grows exponentially between them."""
        grown = np.log(np.maximum(_with_start(twins.apart, began), EPS**2))
        return Twins(np.exp(np.interp(self._times, _with_start(times, 0.0), grown)), twins.exponent)

    def _part(self, run: _Run, twin: _Run) -> Twins:
        """Return how a run and its twin part."""
        return _grown(self._times, self._apart(run, twin, APART), self._began)

    @property
    def _began(self) -> float:
        """The distance of the twins at the start, over the size."""
        return max(self._distance(self._start.position, self._twin.position), EPS**2)

    def _distance(self, a: FloatArray, b: FloatArray) -> float:
        """Return the rms distance between positions, (n, 3) m, over the size."""
        d = a - b if self._box is None else minimum_images(a - b, self._box)
        return math.sqrt(float(np.mean(np.sum(d * d, axis=1)))) / self._size

    def _apart(self, one: _Run, other: _Run, enough: float) -> FloatArray:
        """Compare two runs until they are apart; return the largest distance so far over the size, (K,)."""
        apart = np.full(len(self._times), np.inf)
        largest = 0.0
        for k in range(len(self._times)):
            a, b = one.at(k), other.at(k)
            if a is None or b is None:
                break
            apart[k] = largest = max(largest, self._distance(a, b))
            if not largest < enough:
                break
        return apart

    def _run(self, refinement: float, start: Start | None = None) -> _Run:
        return _Run(self._scene, refinement, self._threads, start or self._start, self._times)

    def _promise(
        self, refinement: float, error: FloatArray, exponent: float, chosen: Literal["wisdom-holman"] | None = None
    ) -> Scene:
        until = self._scene.time.duration
        kept = _kept(self._times, error, self._accuracy)
        horizon = kept if kept < until else None
        return self._scene.promising(
            Promise(
                refinement=refinement,
                until=until,
                horizon=horizon,
                integrator=chosen,
                lyapunov=float(f"{exponent:.6g}"),
                error=tuple(float(f"{min(each, LARGEST_ERROR):.3g}") for each in error.tolist()),
            )
        )


def _grown(times: FloatArray, apart: FloatArray, began: float) -> Twins:
    """Continue the distance of twins, (K,) over the size, beyond where it is no longer small."""
    apart = np.maximum(apart, began)
    over = np.flatnonzero(~(apart < APART))
    last = int(over[0]) if len(over) else len(apart) - 1  # beyond, they go on to part as up to here
    apart[last] = min(apart[last], 1.0)
    exponent = math.log(apart[last] / began) / float(times[last])
    apart[last + 1 :] = apart[last] * np.exp(max(exponent, 0.0) * (times[last + 1 :] - times[last]))
    return Twins(apart, exponent)


def _with_start(values: FloatArray, start: float) -> FloatArray:
    """Return values at times, with that at 0 before them."""
    return np.concatenate(([start], values))


def _samples(scene: Scene, count: int) -> FloatArray:
    """Return times at which runs are compared, (count,) s."""
    return np.asarray(scene.time.duration * (np.arange(1, count + 1) / count))


def _size(start: Start, box: FloatArray | None) -> float:
    """Return half the box, the rms distance of the bodies from their centre, or that of one body from 0, in m."""
    if box is not None:
        return float(box.min()) / 2.0
    apart = start.position - start.position.mean(axis=0)
    size = math.sqrt(float(np.mean(np.sum(apart * apart, axis=1))))
    return size or float(np.abs(start.position).max()) or float(start.radius.max())


def _displaced(start: Start, distance: float) -> Start:
    """Return a start whose free bodies are displaced by an rms distance in m, or else by a last bit."""
    direction = 2.0 * np.random.default_rng(0).random(start.position.shape) - 1.0  # of rms length 1
    moved = start.position + distance * direction
    unmoved = np.nextafter(start.position, np.copysign(np.inf, direction))
    moved = np.where(moved == start.position, unmoved, moved)
    return replace(start, position=np.where(start.fixed[:, np.newaxis], start.position, moved))


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
