"""Finds the step that keeps an accuracy, by trial runs of the scene with longer steps.

Let e(t) be the error of a run with steps of length h, and D(t) its distance from a run with steps of length h/q. Then

    e(t) of the finer run = D(t) / (q^p - 1),     e(t) with steps s times shorter = e(t) / s^p

for an integrator of order p, or with the order that the latest trial runs show, if it is lower. The distance D includes
all causes of growing errors, such as contacts and chaos. Trial runs start with about the longest useful steps, and
shorten them until the extrapolation to the required step is short. The run itself then uses that step, and never has to
be repeated.

Chaos limits every promise. A twin, a run with slightly displaced bodies, shows how errors grow. The error r(t) by
rounding is proportional to the distance of the twins. The horizon is the time at which 2 e(t) + r(t) exceeds the
accuracy. The error of gauss-radau15 is rounding; its twins start one bit apart, and so measure this error directly.
The errors of its longer steps are multiples of the distance between two trial runs, see `RADAU_ERRORS`. The largest
Lyapunov exponent is the growth rate of the distance of twins, up to the end or until it reaches `APART`.

The look-ahead has a budget (`WorkBudget`). If it is too small for the whole run, the trial runs cover only the
beginning. With contacts, the promise ends where the trial runs end; without contacts, errors are extrapolated
(`onward`).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np

from carom import registry
from carom.arrays import FloatArray
from carom.errors import SceneError
from carom.physics.forces.gravity.direct import MAX_IN_ONE_BLOCK
from carom.physics.look_ahead.error_growth import (
    APART,
    CHANCE,
    LONGEST,
    RATIO,
    SAFETY,
    Twins,
    by_chance,
    extrapolate,
    kept_until,
    largest_useful,
    samples,
    stays,
    with_start,
)
from carom.physics.look_ahead.examined_runs import ENOUGH_SAMPLES, SAMPLES, SPREAD, ExaminedRuns
from carom.physics.look_ahead.orbits import look_at_orbits
from carom.physics.look_ahead.trial_run import TrialRun, Watcher, WorkBudget, least_work, step_work
from carom.physics.placement import place
from carom.plan import interactions
from carom.plan.auto import auto_interval, integrator, largest_step
from carom.plan.features import require
from carom.plan.hierarchy import orbits_often
from carom.scene.explanation import naming_places
from carom.scene.integrators import AUTO, INTEGRATORS, Integrator
from carom.scene.load import Scene
from carom.scene.schema import Promise
from carom.scene.start import InitialBodies

if TYPE_CHECKING:
    from carom.physics.integrators.gauss_radau.radau_twin import FollowedOrbits

# number of samples if bodies meet, since pauses cost more than steps; the second number is for a promise that ends
# early
FEWER_SAMPLES = (4, 32)
EXACT = 2.0**-8  # refinement of a trial run with only rounding errors; shorter steps cost more
# refinement in place of `EXACT` for many bodies, which have more possible partners in longer steps
EXACT_OF_MANY = 0.125
EXACT_UP_TO = 200  # largest number of bodies for `EXACT`; for more, `EXACT_OF_MANY` applies
FEWEST_ORBITS = 30.0  # smallest number of revolutions of the innermost body; with fewer, gauss-radau15 is cheap
FINEST_OF_ORBITS = 1e-7  # smallest accuracy for wisdom-holman; below it, gauss-radau15 is cheaper
HILL_RADII = 3.0  # smallest number of Hill radii between orbits, so that encounters are rare
SAMPLES_OF_ORBITS = 16  # number of samples; each takes a corrector and its inverse
# largest growth of an error beyond the trial runs for which steps are shortened; more growth ends the promise
MOST_FORESEEN = 1e6
# ratio of the expected to the extrapolated error; with 2, an event in a step caused 1.4 times the expected error
MARGIN = 3.0
MOST_IDLE = 5  # largest number of successive trial runs whose shorter steps hardly change the distance; see `stays`
# Number of consecutive comparisons that must show that shorter steps would hardly extend a promise; a single one may do
# so by chance. Comparisons are ignored while no promise is kept, since the steps may be too long to tell.
MOST_ENOUGH = 2
# number of steps within the last 1 / λ in chaos; a twin with one iteration adds hardly any rounding
STEPS_OF_TWINS = 200
RADAU_AHEAD = 2.0**-1.5  # refinement of a trial run with gauss-radau15
RADAU_LONG = 0.25  # refinement of a second run, whose distance from the trial run measures errors
# Refinement, and ratio of the error of its steps to that distance. In 40 scenes (Kepler orbits of up to 3000 periods,
# planets, hierarchical triples, 3 to 60 bodies), the largest ratios at the end were 1.1, 0.2, 0.009 and 0.0013; steps
# of refinement 1 have only rounding errors.
RADAU_ERRORS = ((RADAU_LONG, 1.25), (RADAU_AHEAD, 0.2), (0.5, 0.01), (2.0**-0.5, 2e-3), (1.0, 0.0))

# Integrators that may cost less than Gauss–Radau integration for more bodies than `MAX_IN_ONE_BLOCK`, the cheapest
# first. With fewer bodies, the comparison would cost more than the run. Each integrator may spend a fraction of the
# remaining budget.
CHEAPER: dict[Literal["leapfrog", "yoshida4"], float] = {"leapfrog": 0.5, "yoshida4": 0.6}
RADAU_STEPS = 0.25  # longest steps of gauss-radau15, relative to leapfrog's with refinement 1; 0.18 to 0.31 in clusters
COARSE_ERRORS = 2.0  # the first comparison may overestimate the refinement that is needed by this factor

# fraction of the budget for a run, and for its twin; the remainder is for a run with long steps, or for leapfrog
TWIN_SHARE = 0.25


def with_promise(
    scene: Scene, threads: int | None = None, start: InitialBodies | None = None, watch: Watcher | None = None
) -> Scene:
    """Return a scene with the step for its accuracy in a [promise]; a scene without an accuracy is returned unchanged.

    ``watch`` is called with the `WorkBudget` during trial runs.

    Raises
    ------
    SceneError
        If double precision cannot give the accuracy, or the look-ahead's budget ends before any result.
    PhysicsError
        If no trial run completes.
    """
    if scene.time.accuracy is None or scene.promise is not None:
        return scene
    with naming_places(scene), np.errstate(invalid="ignore", divide="ignore"):  # unknown values are infinite
        least = least_work(scene, require(scene).contact.modelled)
        budget = WorkBudget(scene.time.duration, least, watch=watch)
        return scene.promising(_LookAhead(scene, scene.time.accuracy, threads, start or place(scene), budget).find())


class _Found(NamedTuple):
    """A step and the accuracy that it keeps."""

    kept: float  # s, time for which the step keeps the accuracy
    refinement: float
    error: FloatArray  # (K,) error relative to the size
    run: TrialRun  # the trial run with about this step
    known: int  # number of times at which the error is known


class _LookAhead(ExaminedRuns):
    def find(self) -> Promise:
        scene, chosen = self._scene, integrator(self._scene)
        if chosen.hierarchical and (promised := self._find_for_orbits(persists=True)):
            return promised
        # Wisdom–Holman integration may keep a rough accuracy at a lower cost than Gauss–Radau integration
        has_choice = scene.time.integrator == AUTO and "wisdom-holman" in registry.names("integrators")
        if has_choice and self._accuracy >= FINEST_OF_ORBITS and orbits_often(scene, HILL_RADII) >= FEWEST_ORBITS:
            promised = self._find_for_orbits(persists=False)
            if promised is not None:
                return promised
        is_free = scene.time.integrator == AUTO and chosen.name != "leapfrog"
        if is_free and self._is_smooth and scene.count > MAX_IN_ONE_BLOCK:
            return self._find_cheapest(chosen)
        if chosen.controls_error:
            return self._find_for_radau()
        # without contacts, steps of any length are exact under uniform fields and drag
        is_exact = self._is_smooth and not interactions.differing(scene)
        if require(scene).accelerates and not is_exact:
            return self._find_for_order(chosen.order)
        # without forces, flights and times of impact are exact, whatever the step
        _, twins = self._part_at_impacts(EXACT if scene.count <= EXACT_UP_TO else EXACT_OF_MANY)
        longest = auto_interval(scene, scene.time.duration) / largest_step(scene) if is_exact else LONGEST
        return self._promise(min(longest, LONGEST), self._rounding * twins.apart, twins.exponent)

    def _find_cheapest(self, usual: Integrator) -> Promise:
        """Return the promise of the cheapest integrator that keeps the accuracy to the end.

        If none does, return the promise that lasts longest. Gauss–Radau integration, if it is the ``usual`` integrator,
        is tried if no cheaper integrator keeps the accuracy to the end.
        """
        best: Promise | None = None
        refused: SceneError | None = None
        most, steps = math.inf, 0.0
        for name, part in CHEAPER.items():
            time = self._scene.time.model_copy(update={"integrator": name})
            scene = self._scene.model_copy(update={"time": time})
            whole = self._budget
            if steps * step_work(scene) >= most or not whole.left:
                break
            budget = WorkBudget(whole.duration, whole.least, part * whole.left / whole.total, whole.watch)
            ahead = _LookAhead(scene, self._accuracy, self._threads, self._start, budget)
            coarse = ahead._coarsest()
            if not steps:
                steps = coarse.steps * ahead._whole(coarse, LONGEST)
                most = RADAU_STEPS * steps * step_work(self._scene) if usual.controls_error else math.inf
            promise: Promise | None = None
            try:
                promise = ahead._find_for_steps(INTEGRATORS[name].order, coarse, most)
            except SceneError as error:
                refused = error
            whole.spend(budget.spent, budget.reached)
            if promise is not None and (best is None or promise.kept_until >= best.kept_until):
                best = promise.model_copy(update={"integrator": name})
                if promise.horizon is None:
                    most = steps * step_work(scene) * promise.refinement
        if usual.controls_error and (best is None or best.horizon is not None):
            return self._find_for_radau()
        if best is None:
            assert refused is not None  # no other limit applies
            raise refused
        return best

    def _find_for_radau(self) -> Promise:
        needs, rests_from = require(self._scene), math.inf
        run: TrialRun | FollowedOrbits
        if needs.contact.modelled:
            run, twins = self._part_at_impacts(RADAU_AHEAD if needs.gravity.modelled else RADAU_LONG)
            if run.is_cut and run.rests_from < math.inf:
                return self._find_for_order(INTEGRATORS["leapfrog"].order)
            rests_from, rounding = run.rests_from, SPREAD * twins.apart
        else:
            run, twins, rounding = self._part_of_orbits(RADAU_AHEAD, converges=False)
            if run.known == len(self._times) and not rounding[-1] <= self._accuracy:
                run, twins, rounding = self._part_of_orbits(1.0, converges=True)
        if not needs.gravity.modelled:  # parabolas are exact for steps of any length
            refinement, error = RADAU_LONG, rounding
        elif not SAFETY * self._at_end(rounding) <= self._accuracy:  # no other step keeps the accuracy for longer
            refinement, error = 1.0, rounding
        else:
            missed = twins.continued(self._times, self._missed_by_long_steps(run), run.times)
            errors = ((each, rounding + share * missed) for each, share in RADAU_ERRORS)
            refinement, error = next((each, e) for each, e in errors if SAFETY * self._at_end(e) <= self._accuracy)
        if rests_from < kept_until(self._times, error, self._accuracy):
            return self._find_for_order(INTEGRATORS["leapfrog"].order)
        return self._promise(refinement, error, twins.exponent)

    def _find_for_order(self, order: int) -> Promise:
        """Return the promise of kicks and drifts, whatever they cost."""
        found = self._find_for_steps(order)
        assert found is not None
        return found

    def _missed_by_long_steps(self, run: TrialRun | FollowedOrbits) -> FloatArray:
        """Return the distance of a run from a run with long steps, relative to the size, at the run's times, (K',)."""
        long: TrialRun | FollowedOrbits
        if isinstance(run, TrialRun):
            long = self._run(RADAU_LONG, times=run.times)
        else:
            from carom.physics.integrators.gauss_radau import radau_twin  # noqa: PLC0415 - a part that can be removed

            long = radau_twin.orbits(self._scene, self._start, RADAU_LONG, run.times, self._bound(1.0))
        missed = self._scale.apart(run, long, APART)
        if min(run.known, long.known) < len(missed):
            self._cover(run.times, min(run.known, long.known))
        return missed

    def _part_of_orbits(self, refinement: float, *, converges: bool) -> tuple[FollowedOrbits, Twins, FloatArray]:
        """Return a run without contacts, its divergence from its twin, and its rounding error, (K,).

        The twin makes a single iteration in each step unless it ``converges``.
        """
        from carom.physics.integrators.gauss_radau.radau_twin import CONVERGES, diverge  # noqa: PLC0415 - a part that can be removed

        iterations = CONVERGES if converges else 1
        enough, twin = APART * self._scale.size, self._twin.position
        followed = refinement, self._times, enough, iterations, self._bound(TWIN_SHARE)
        run, apart = diverge(self._scene, self._start, twin, *followed)
        if run.known < ENOUGH_SAMPLES and self._budget.reached > 0.0:
            self._times = samples(self._budget.reached, SAMPLES)
            followed = refinement, self._times, enough, iterations, self._bound(2.0 * TWIN_SHARE)
            run, apart = diverge(self._scene, self._start, twin, *followed)
        self._cover(self._times, run.known)
        apart = np.maximum.accumulate(apart) / self._scale.size
        twins = Twins.grown(self._times, apart, self._began, run.known)
        if converges:  # the rounding of the twin is independent
            return run, twins, SPREAD * twins.apart
        steps = twins.steps_that_count(self._began, run.steps)
        return run, twins, SPREAD * twins.apart * np.sqrt(np.maximum(1.0, steps / STEPS_OF_TWINS))

    def _find_for_orbits(self, persists: bool) -> Promise | None:
        """Return the promise of Wisdom–Holman integration; None if it is not worthwhile."""
        times, most = samples(self._scene.time.duration, SAMPLES_OF_ORBITS), self._accuracy * self._scale.size / SAFETY
        found = look_at_orbits(self._scene, self._start, times, self._accuracy, most, persists, self._budget)
        if not (found.keeps or persists):
            self._budget.covered = math.inf
            return None
        error = np.interp(self._times, with_start(times, 0.0), with_start(found.error / self._scale.size, 0.0))
        chosen: Literal["wisdom-holman"] | None = "wisdom-holman" if self._scene.time.integrator == AUTO else None
        promise = self._promise(found.refinement, MARGIN * error, found.exponent)
        return promise.model_copy(update={"integrator": chosen})

    def _find_for_steps(self, order: int, coarse: TrialRun | None = None, most: float = math.inf) -> Promise | None:
        """Return the promise of kicks and drifts; None if they would cost more than ``most`` nominal s.

        ``coarse`` is the coarsest trial run, if it exists already.
        """
        self._budget.covered = math.inf
        coarse = coarse or self._coarsest()
        budget, refinement, apart, idle, enough = self._budget, coarse.refinement, list[FloatArray](), 0, 0
        best: _Found | None = None
        useful = 1.0 if self._is_smooth else largest_useful(order, self._accuracy, self._farthest)
        while len(apart) < self._tried or 2.0 * RATIO * coarse.work <= budget.left:  # including a twin
            refinement *= RATIO
            share = (budget.left / 2.0) / budget.total  # a twin costs as much again
            fine = self._run(refinement, share=share, longer=max(1.0, self._planned / refinement))
            apart.append(self._scale.apart(coarse, fine, useful))
            known = min(coarse.known, fine.known)
            growth = self._growth(apart[-1], known)
            goal = self._accuracy / (growth if growth < MOST_FORESEEN else 1.0)
            chosen, kept, error = extrapolate(self._times, apart, refinement, order, goal, self._farthest)
            if len(apart) < self._tried and (self._is_smooth or by_chance(apart, self._accuracy) > CHANCE):
                kept, error = 0.0, np.full(len(self._times), np.inf)
            if most < math.inf and not kept >= self._times[-1]:
                missed = SAFETY * apart[-1][-1] / (RATIO**order - 1.0) / goal
                chosen = max(refinement * missed ** (1.0 / order) / COARSE_ERRORS, LONGEST)
            if coarse.work * self._whole(coarse, chosen) > most:
                return None
            if best is None or kept > best.kept or known >= best.known:
                run = fine if chosen > coarse.refinement and not fine.is_cut else coarse
                best = _Found(kept, chosen, error, run, known)
            idle = idle + 1 if stays(self._times, apart, kept) else 0
            enough = enough + 1 if chosen <= coarse.refinement and kept > 0.0 else 0
            if kept >= self._times[-1] or enough == MOST_ENOUGH or idle == MOST_IDLE or not known:
                break
            coarse = fine
        assert best is not None
        longer = max(1.0, self._planned / best.run.refinement)
        twin = self._run(best.run.refinement, self._twin, share=budget.left / budget.total, longer=longer)
        twins = self._part(best.run, twin)
        self._cover(self._times, min(best.known, twin.known))
        error = MARGIN * best.error + self._rounding * twins.apart
        over = np.flatnonzero(~(error <= self._accuracy))
        last = int(over[0]) - 1 if len(over) else len(error) - 1
        # between samples, an error may exceed the accuracy at any time
        if len(over) or not self._is_smooth:
            self._kept_at_most = float(self._times[last]) if last >= 0 else 0.0
        return self._promise(best.refinement, error, twins.exponent)

    def _part_at_impacts(self, refinement: float) -> tuple[TrialRun, Twins]:
        """Return a run with impacts, and its divergence from its twin; with few bodies, they share memory."""
        duration, many = self._scene.time.duration, self._scene.count > EXACT_UP_TO
        for count in (SAMPLES,) if many else FEWER_SAMPLES:
            self._times = samples(duration, count)
            run = self._run(refinement, share=TWIN_SHARE)
            run.at(0)
            if run.rests_from == 0.0:  # bodies rest from the start, so another integrator is needed
                run.end()
            run.at(count - 1)
            if run.is_cut and run.reached > 0.0 and run.rests_from == math.inf:  # compare at times that the run reaches
                self._times = samples(run.reached, count)
                run = self._run(refinement, share=2.0 * TWIN_SHARE)
            known = run.known
            twin = self._run(refinement, self._twin, share=TWIN_SHARE) if many else run.again(self._twin)
            twins = self._part(run, twin)
            known = min(known, twin.known)
            if run.is_cut or twin.is_cut or self._rounding * twins.apart[-1] <= self._accuracy:
                break
        times = self._times
        self._cover(times, known)
        self._times = samples(min(duration, self._budget.covered or duration), SAMPLES)
        return run, twins.at(self._times, times, self._began)
