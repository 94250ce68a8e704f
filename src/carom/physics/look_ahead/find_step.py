"""Finds the step that keeps an accuracy, by running the scene ahead with longer steps.

A run with steps of h has the error e(t). The same scene run with h and with h/2 differs by D(t), and

    e(t) of the finer run = D(t) / (2^p - 1),     e(t) with steps 2^j times shorter = e(t) / 2^{p j}

for an integrator of order p, or for the order that three such runs show, if that is lower. D contains everything that
makes errors grow, contacts and chaos too. The runs begin with the longest useful steps and halve them until the
extrapolation to the required step is short. Then the run itself takes that step, and never has to be repeated.

Chaos ends every promise. A twin run that starts slightly displaced shows how errors grow. The error r(t) by rounding is
proportional to the distance of the twins. The horizon is the time at which 2 e(t) + r(t) exceeds the accuracy.
Twins with gauss-radau15, which errs by rounding, start a last bit apart, so they show its error itself. Its longer
steps err by multiples of the distance of two runs ahead, see `RADAU_ERRORS`. The largest Lyapunov exponent is the
growth rate of the distance of twins, to the end or until it is `APART`.
"""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from carom.physics.integrators.radau_twin import Orbits, orbits, part
from carom.physics.look_ahead.error_curve import kept_until, samples, with_start
from carom.physics.look_ahead.extrapolation import COARSER, FARTHEST, SAFETY, TRIED, extrapolate, stays
from carom.physics.look_ahead.orbits import look_at_orbits
from carom.physics.look_ahead.scale import Scale
from carom.physics.look_ahead.trial_run import TrialRun
from carom.physics.look_ahead.twins import APART, EPS, Twins, displaced
from carom.physics.placement import place
from carom.plan.auto import integrator
from carom.plan.features import require
from carom.plan.hierarchy import orbits_often
from carom.scene.error import SceneError
from carom.scene.integrators import AUTO, INTEGRATORS
from carom.scene.key_places import naming_places
from carom.scene.schema import Promise, Scene
from carom.scene.start import Start

FloatArray = NDArray[np.float64]

SAMPLES = 64  # times at which runs are compared
FEWER_SAMPLES = (4, 32)  # where bodies meet, since pausing costs more than steps; the second if a promise ends early
LONGEST = 1.0  # refinement of the longest useful steps
EXACT = 2.0**-8  # refinement of a run ahead whose steps err by rounding only; shorter steps cost more
EXACT_OF_MANY = 0.125  # likewise for many bodies; in longer steps each has more others within reach
EXACT_UP_TO = 200  # bodies; more take `EXACT_OF_MANY`
FEWEST_ORBITS = 30.0  # of the innermost body; the first ones cost little with gauss-radau15
FINEST_OF_ORBITS = 1e-7  # accuracy; gauss-radau15 keeps a finer one for less than wisdom-holman
HILL_RADII = 3.0  # between orbits, so that encounters are rare
SAMPLES_OF_ORBITS = 16  # each takes a corrector and its inverse
MARGIN = 2.0  # factor from the extrapolated to the expected error; without it, a horizon was late
MOST_WORK = 2e6  # `TrialRun.work` of the finest run ahead, some seconds; the run itself takes up to eight times as long
MOST_IDLE = 3  # halvings in a row that hardly change the distance, see `stays`
# Comparisons in a row after which shorter steps would hardly extend a promise; one may be chance. Where none is kept at
# all, steps may still be too long to tell.
MOST_ENOUGH = 2
DISPLACEMENT = 1e-11  # of the twin, over the size of the system; beyond the rounding of many steps
# Distance from the truth over that of runs that differ by rounding. With 4, horizons were too early in 8 of 25 cases;
# with 1.3, errors exceeded the request before the horizon in 11 of 235, by up to a fifteenth of the time.
SPREAD = 2.5
LARGEST_ERROR = 1.0  # of the size; larger errors are not distinguished
ROUNDING = 8.0  # ρ in units of the last bit of the coordinates
LOWEST = 64.0  # smallest accuracy in units of ρ
STEPS_OF_TWINS = 200  # those of the last 1 / λ in chaos; a twin with a single iteration hardly rounds by itself
RADAU_AHEAD = 2.0**-1.5  # refinement of a run ahead with gauss-radau15
RADAU_CHAOTIC = 0.5  # likewise, where the promise ends: its own error may not reach the accuracy before
RADAU_LONG = 0.25  # refinement of the run whose distance from that one is its error
# Refinement, and the error of its steps over that distance. Of 40 scenes (Kepler orbits of up to 3000 periods, planets,
# hierarchical triples, 3 to 60 bodies) the largest were 1.1, 0.2, 0.009 and 0.0013 at the end; steps of 1 err by
# rounding.
RADAU_ERRORS = ((RADAU_LONG, 1.25), (RADAU_AHEAD, 0.2), (0.5, 0.01), (2.0**-0.5, 2e-3), (1.0, 0.0))


def with_promise(scene: Scene, threads: int | None = None, start: Start | None = None) -> Scene:
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
    with naming_places(scene):
        ahead = _LookAhead(scene, scene.time.accuracy, threads, start or place(scene))
    return ahead.find()


class _LookAhead:
    def __init__(self, scene: Scene, accuracy: float, threads: int | None, start: Start) -> None:
        self._scene, self._accuracy, self._threads, self._start = scene, accuracy, threads, start
        self._times = samples(scene, SAMPLES)
        self._scale = Scale.of(scene, start)
        self._last_bit = EPS * max(1.0, float(np.abs(start.position).max()) / self._scale.size)
        least = LOWEST * ROUNDING * self._last_bit
        if accuracy < least:
            raise SceneError(
                f"time.accuracy = {accuracy:g}: double precision can give {least:.1e} for bodies "
                f"where this scene has them; set {least:.1e} or more",
                ("time", "accuracy"),
            )
        if integrator(scene).controls_error:  # errs by rounding, so twins a last bit apart show its errors
            self._twin, self._rounding = displaced(start, 0.0), SPREAD
        else:
            self._twin, self._rounding = (
                displaced(start, DISPLACEMENT * self._scale.size),
                ROUNDING * self._last_bit / DISPLACEMENT,
            )

    def find(self) -> Scene:
        if integrator(self._scene).hierarchical:
            return self._find_for_orbits(persists=True) or self._scene
        if self._is_rough and orbits_often(self._scene, HILL_RADII) >= FEWEST_ORBITS:
            promised = self._find_for_orbits(persists=False)
            if promised is not None:
                return promised
        if integrator(self._scene).controls_error:
            return self._find_for_radau()
        if not require(self._scene).pulls:  # flights and times of impact are exact, whatever the step
            _, twins = self._part_at_impacts(EXACT if self._scene.count <= EXACT_UP_TO else EXACT_OF_MANY)
            return self._promise(LONGEST, self._rounding * twins.apart, twins.exponent)
        return self._find_for_steps(integrator(self._scene).order)

    @property
    def _is_rough(self) -> bool:
        """Whether Wisdom–Holman integration may keep the accuracy for less than Gauss–Radau integration."""
        return self._scene.time.integrator == AUTO and self._accuracy >= FINEST_OF_ORBITS

    def _find_for_radau(self) -> Scene:
        needs, rests_from = require(self._scene), math.inf
        run: TrialRun | Orbits
        if needs.contact.modelled:
            run, twins = self._part_at_impacts(RADAU_AHEAD if needs.gravity.modelled else RADAU_LONG)
            if run.is_given_up:
                return self._find_for_steps(INTEGRATORS["leapfrog"].order)
            rests_from, rounding = run.rests_from, SPREAD * twins.apart
        else:
            run, twins, rounding = self._part_of_orbits(RADAU_AHEAD, 1)
            if rounding[-1] > self._accuracy:  # the run ahead must be accurate while the promise lasts
                run, twins, rounding = self._part_of_orbits(RADAU_CHAOTIC, 3)
        if not needs.gravity.modelled:  # parabolas are exact in steps of any length
            refinement, error = RADAU_LONG, rounding
        elif SAFETY * rounding[-1] > self._accuracy:  # no other steps keep it for longer
            refinement, error = 1.0, rounding
        else:
            missed = twins.continued(self._times, self._missed_by_long_steps(run), run.times)
            errors = ((each, rounding + share * missed) for each, share in RADAU_ERRORS)
            refinement, error = next((each, e) for each, e in errors if SAFETY * e[-1] <= self._accuracy)
        if rests_from < kept_until(self._times, error, self._accuracy):
            return self._find_for_steps(INTEGRATORS["leapfrog"].order)
        return self._promise(refinement, error, twins.exponent)

    def _missed_by_long_steps(self, run: TrialRun | Orbits) -> FloatArray:
        """Return the distance over the size of a run with long steps from another, at the times of that, (K',)."""
        long: TrialRun | Orbits
        if isinstance(run, Orbits):
            long = orbits(self._scene, self._start, RADAU_LONG, run.times)
        else:
            long = TrialRun(self._scene, RADAU_LONG, self._threads, self._start, run.times)
        return self._scale.apart(run, long, APART)

    def _part_of_orbits(self, refinement: float, iterations: int) -> tuple[Orbits, Twins, FloatArray]:
        """Return a run without contacts, how it and its twin diverge, and its error by rounding, (K,)."""
        enough, twin = APART * self._scale.size, self._twin.position
        run, apart = part(self._scene, self._start, twin, refinement, self._times, enough, iterations)
        twins = Twins.grown(self._times, np.maximum.accumulate(apart) / self._scale.size, self._began)
        steps = twins.steps_that_count(self._began, run.steps)
        return run, twins, SPREAD * twins.apart * np.sqrt(np.maximum(1.0, steps / STEPS_OF_TWINS))

    def _find_for_orbits(self, persists: bool) -> Scene | None:
        """Return the scene with a promise of Wisdom–Holman integration; None if that is not worth it."""
        times, most = samples(self._scene, SAMPLES_OF_ORBITS), self._accuracy * self._scale.size / SAFETY
        found = look_at_orbits(self._scene, self._start, times, self._accuracy, most, persists)
        if not (found.keeps or persists):
            return None
        error = np.interp(self._times, with_start(times, 0.0), with_start(found.error / self._scale.size, 0.0))
        chosen: Literal["wisdom-holman"] | None = "wisdom-holman" if self._scene.time.integrator == AUTO else None
        return self._promise(found.refinement, MARGIN * error, found.exponent, chosen)

    def _find_for_steps(self, order: int) -> Scene:
        refinement = LONGEST
        coarse, apart, idle, enough = self._run(refinement), list[FloatArray](), 0, 0
        while True:
            refinement *= 2.0
            fine = self._run(refinement)
            apart.append(self._scale.apart(coarse, fine, 1.0))
            given_up = coarse.is_given_up or fine.is_given_up
            farthest = COARSER if given_up else FARTHEST
            chosen, kept, error = extrapolate(self._times, apart, order, self._accuracy, farthest)
            idle = idle + 1 if stays(self._times, apart, kept) else 0
            enough = 0 if chosen >= 0 or len(apart) < TRIED or kept == 0.0 else enough + 1
            too_much = given_up or fine.work > MOST_WORK
            if kept >= self._times[-1] or enough == MOST_ENOUGH or idle == MOST_IDLE or too_much:
                break
            coarse = fine
        run = fine if chosen >= 0 else coarse
        twins = self._part(run, self._run(run.refinement, self._twin))
        return self._promise(refinement * 2.0**chosen, MARGIN * error + self._rounding * twins.apart, twins.exponent)

    def _part_at_impacts(self, refinement: float) -> tuple[TrialRun, Twins]:
        """Return a run with impacts, and how it and its twin diverge."""
        if self._scene.count > EXACT_UP_TO:
            run = self._run(refinement)
            return run, self._part(run, self._run(refinement, self._twin))
        for count in FEWER_SAMPLES:
            times = self._times = samples(self._scene, count)
            run = self._run(refinement)
            twins = self._part(run, run.again(self._twin))
            if run.is_given_up or self._rounding * twins.apart[-1] <= self._accuracy:
                break
        self._times = samples(self._scene, SAMPLES)
        return run, twins.at(self._times, times, self._began)

    def _part(self, run: TrialRun, twin: TrialRun) -> Twins:
        """Return how a run and its twin diverge."""
        return Twins.grown(self._times, self._scale.apart(run, twin, APART), self._began)

    @property
    def _began(self) -> float:
        """The distance of the twins at the start, over the size."""
        return max(self._scale.distance(self._start.position, self._twin.position), EPS**2)

    def _run(self, refinement: float, start: Start | None = None) -> TrialRun:
        return TrialRun(self._scene, refinement, self._threads, start or self._start, self._times)

    def _promise(
        self, refinement: float, error: FloatArray, exponent: float, chosen: Literal["wisdom-holman"] | None = None
    ) -> Scene:
        until = self._scene.time.duration
        kept = kept_until(self._times, error, self._accuracy)
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
