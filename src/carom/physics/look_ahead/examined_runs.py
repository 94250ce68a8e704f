"""The trial runs of a look-ahead, how far they got, and the promise that follows from their errors."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from carom.arrays import FloatArray
from carom.errors import SceneError
from carom.physics.look_ahead.error_growth import (
    APART,
    COARSEST,
    EPS,
    FARTHEST,
    FARTHEST_OF_SMOOTH,
    LONGEST,
    RATIO,
    SMALLEST,
    TRIED,
    TRIED_OF_SMOOTH,
    Scale,
    Twins,
    between_round_times,
    displaced,
    kept_until,
    onward,
    samples,
    with_start,
)
from carom.physics.look_ahead.trial_run import TrialRun, WorkBudget, radau_work
from carom.plan.auto import integrator
from carom.plan.features import require
from carom.scene.load import Scene
from carom.scene.schema import Promise
from carom.scene.schema.settings import LARGEST_ACCURACY
from carom.scene.start import InitialBodies
from carom.scene.units.dimension import TIME

SAMPLES = 64  # number of times at which runs are compared
LATER = 1024  # number of times beyond the trial runs; between two of them, an error grows little
# smallest number of samples within the budget; if there are fewer, the time that was reached is divided more finely
ENOUGH_SAMPLES = 8
FEWEST_SAMPLES = 4  # smallest number of known samples for an extrapolation of an error to later times
# smallest number of steps between samples for the coarsest trial run, whose steps end at samples; half as many with
# smooth errors
STEPS_PER_SAMPLE = 8
# initial displacement of the twin, relative to the size of the system; larger than the rounding of many steps
DISPLACEMENT = 1e-11
# Ratio of the error by rounding to the distance of twins. With 4, horizons were too early in 8 of 25 cases. With 1.3,
# errors exceeded the request before the horizon in 11 of 235 cases, earlier by up to a fifteenth of the time.
SPREAD = 2.5
LARGEST_ERROR = 1.0  # largest error, relative to the size; larger errors are not distinguished
ROUNDING = 8.0  # rounding ρ in units of the last bit of the coordinates
LOWEST = 64.0  # smallest accuracy in units of ρ
# fraction of the budget for the coarsest trial run; `TRIED` finer runs and a twin take 12 times this fraction
FIRST_SHARE = 1.0 / 13.0


class ExaminedRuns:
    """Trial runs of a scene within a budget, and the times up to which they are known.

    Raises SceneError if double precision cannot give the accuracy.
    """

    def __init__(
        self, scene: Scene, accuracy: float, threads: int | None, start: InitialBodies, budget: WorkBudget
    ) -> None:
        self._scene, self._accuracy, self._threads, self._start = scene, accuracy, threads, start
        self._budget = budget
        # without contacts, errors depend smoothly on the step, and are extrapolated beyond the times of the trial runs
        self._is_smooth = not require(scene).contact.modelled
        of_smooth = TRIED_OF_SMOOTH, FARTHEST_OF_SMOOTH
        self._tried, self._farthest = of_smooth if self._is_smooth else (TRIED, FARTHEST)
        # refinement up to which trial runs are always made, or the smallest refinement of a run if that is larger
        self._planned = max(COARSEST * RATIO**self._tried, LONGEST)
        self._kept_at_most = math.inf  # s
        self._times = samples(scene.time.duration, SAMPLES)
        self._scale = Scale.of(scene, start)
        last_bit = EPS * max(1.0, float(np.abs(start.position).max()) / self._scale.size)
        least = LOWEST * ROUNDING * last_bit
        if accuracy < least:
            raise SceneError(
                f"time.accuracy = {accuracy:g}: double precision allows at best {least:.1e} for the coordinates of "
                f"this scene; set {least:.1e} or more",
                ("time", "accuracy"),
            )
        if integrator(scene).controls_error:  # its error is rounding, seen in twins that start one bit apart
            self._twin, self._rounding = displaced(start, 0.0), SPREAD
        else:
            self._twin = displaced(start, DISPLACEMENT * self._scale.size)
            self._rounding = ROUNDING * last_bit / DISPLACEMENT

    def _coarsest(self) -> TrialRun:
        """Return the coarsest trial run, up to a time that finer trial runs can also reach within the budget.

        The coarsest trial run determines the times of comparison.
        """
        duration = self._scene.time.duration
        self._times = between_round_times(duration, SAMPLES)
        longer = self._planned / COARSEST
        run = self._run(COARSEST, share=FIRST_SHARE, longer=longer)
        run.at(SAMPLES - 1)
        if run.is_cut:
            count = max(1, min(SAMPLES, run.steps // (STEPS_PER_SAMPLE // 2 if self._is_smooth else STEPS_PER_SAMPLE)))
            self._times = between_round_times(run.reached, count)
            run = self._run(COARSEST, share=2.0 * FIRST_SHARE, longer=longer)
            run.at(count - 1)
        return run

    def _whole(self, run: TrialRun, refinement: float) -> float:
        """Return the cost of a whole run with a refinement, relative to the cost of a trial run so far."""
        longer = self._scene.time.duration / run.reached if run.reached > 0.0 else math.inf
        return longer * refinement / run.refinement

    def _bound(self, share: float) -> Callable[[int, float], bool]:
        """Return the condition on which a run of gauss-radau15 goes on, given its fraction of the whole budget."""
        budget, each, begun = self._budget, radau_work(self._scene.count), self._budget.spent

        def goes_on(iterations: int, time: float) -> bool:
            budget.spend(iterations * each, time)
            budget.own = (budget.spent - begun) * budget.duration / time
            return budget.spent - begun < min(share * budget.total, budget.total - begun)

        return goes_on

    def _part(self, run: TrialRun, twin: TrialRun) -> Twins:
        apart = self._scale.apart(run, twin, APART)
        return Twins.grown(self._times, apart, self._began, min(run.known, twin.known))

    @property
    def _known(self) -> int:
        """The number of times that all trial runs have reached within the budget; 1 if there are none."""
        return max(1, int(np.count_nonzero(self._times <= self._budget.covered)))

    def _growth(self, error: FloatArray, known: int) -> float:
        """Return the expected growth of an error, (K,), from its last known time to the end; 1 with contacts."""
        duration = self._scene.time.duration
        if not self._is_smooth or known < FEWEST_SAMPLES or self._times[known - 1] >= duration:
            return 1.0
        return float(onward(self._times[:known], error[:known], np.array([duration]))[0])

    def _at_end(self, error: FloatArray) -> float:
        """Return an error, (K,), at the end of the run."""
        return float(error[self._known - 1]) * self._growth(error, self._known)

    def _cover(self, times: FloatArray, known: int) -> None:
        """Record the number of times that a trial run has reached within the budget."""
        if known < len(times) or times[-1] < self._scene.time.duration:
            self._budget.cover(float(times[known - 1]) if known else 0.0)

    @property
    def _began(self) -> float:
        """The initial distance of the twins, relative to the size."""
        return max(self._scale.distance(self._start.position, self._twin.position), EPS**2)

    def _run(
        self,
        refinement: float,
        start: InitialBodies | None = None,
        times: FloatArray | None = None,
        share: float = 1.0,
        longer: float = 1.0,
    ) -> TrialRun:
        begins, times = start or self._start, self._times if times is None else times
        return TrialRun(self._scene, refinement, self._threads, begins, times, self._budget, share, longer)

    def _promise(self, refinement: float, error: FloatArray, exponent: float) -> Promise:
        until, covered = self._scene.time.duration, min(self._scene.time.duration, self._budget.covered)
        error = np.where(np.isfinite(error), np.minimum(error, LARGEST_ERROR), LARGEST_ERROR)
        times, known, reach = self._times, self._known, covered
        if covered < until:
            times, error = times[:known], error[:known]
            if self._is_smooth and known >= FEWEST_SAMPLES and error[-1] <= self._accuracy:
                later, reach = covered + samples(until - covered, LATER), until
                beyond = np.minimum(error[-1] * onward(times, error, later), LARGEST_ERROR)
                times, error = np.concatenate((times, later)), np.concatenate((error, beyond))
        kept = min(kept_until(times, error, self._accuracy), reach, self._kept_at_most)
        if covered < until and kept == 0.0:
            self._refuse(covered, error)
        grid = samples(max(covered, kept), SAMPLES)
        expected = np.interp(grid, with_start(times, 0.0), with_start(error, 0.0))
        return Promise(
            refinement=refinement,
            until=until,
            looked=covered if covered < until else None,
            horizon=kept if kept < until else None,
            lyapunov=float(f"{exponent:.6g}"),
            error=tuple(float(f"{each:.3g}") for each in expected.tolist()),
        )

    def _refuse(self, covered: float, error: FloatArray) -> None:
        """Refuse the accuracy; the message names an accuracy that could be promised."""
        units, until = self._scene.unit_system, self._scene.time.duration
        best = float(error.min(initial=LARGEST_ERROR))
        if best <= LARGEST_ACCURACY:
            digit = 10.0 ** math.floor(math.log10(max(best, SMALLEST)))
            rounded_up = math.ceil(best / digit) * digit
            could = f"{rounded_up:g} could be promised for the first {units.text(covered, TIME, '.2g')} or less"
        else:
            could = f"not even {LARGEST_ACCURACY:g} could be promised"
        raise SceneError(
            f"time.accuracy = {self._accuracy:g} cannot be promised: within {self._budget.least:g} s of computing, or "
            f"a tenth of the run, the trial runs reach t = {units.text(covered, TIME, '.2g')} of "
            f"{units.text(until, TIME, '.4g')}; {could}; raise time.accuracy, shorten time.duration, use fewer "
            "bodies, or remove time.accuracy",
            ("time", "accuracy"),
        )
