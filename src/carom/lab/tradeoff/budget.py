"""The time that a study may take, and the choice of settings worth timing: settings that may be on the front.

A setting is left out before its first run if another setting has longer steps, and no errors except rounding. A setting
is not timed if another setting is as accurate and clearly cheaper. Timings are repeated where the front is uncertain.
"""

from __future__ import annotations

import math
from dataclasses import astuple

from carom.lab.tradeoff.reference import Errors
from carom.lab.tradeoff.settings_grid import SettingResult
from carom.runs.stopwatch import Stopwatch

RUNS = 30.0  # default budget, in multiples of the time of the scene as written
LEAST = 5.0  # s, default budget of short runs
FOR_THE_REFERENCE = 0.5  # fraction of the budget after which the reference is not refined further
FOR_TIMES = 0.25  # fraction of the budget that is kept for repeated timings
# a run begins only if this fraction of the time of the scene as written is left; with less, it would be stopped
FASTEST = 0.5
SHORT = 0.05  # s; a shorter run is repeated until its time is known to `PRECISION`
PRECISION = 0.05  # relative precision of a median
TIMINGS = 3  # timings of each setting that may be on the front
MOST_TIMINGS = 60  # largest number of timings of a short run
ALONE = 0.3  # relative noise that a single timing may have: 0.26 was measured for runs of some milliseconds
CHEAPER = 3.0  # a setting whose estimated cost is this many times a rival's is not timed; estimates err by less
ROUNDING = 1e-11  # largest error that counts as rounding of a long run, which shorter steps do not reduce


class StudyBudget:
    """The seconds that a study may take, from its first run on; None until the time of a run is known."""

    def __init__(self, seconds: float | None = math.inf) -> None:
        self.seconds = seconds
        self.reserve = 0.0  # fraction of the budget that is kept for later
        self._watch: Stopwatch | None = None

    def begin(self) -> None:
        """Start the clock, unless it runs."""
        self._watch = self._watch or Stopwatch()

    def choose(self, run: float) -> None:
        """Choose the default budget for a scene whose run takes ``run`` seconds."""
        self.seconds = max(LEAST, RUNS * run)

    @property
    def spent(self) -> float:
        """Seconds since the first run."""
        return 0.0 if self._watch is None else self._watch.seconds

    @property
    def left(self) -> float:
        """Seconds that may still be spent, apart from the reserve."""
        seconds = math.inf if self.seconds is None else self.seconds
        return seconds if math.isinf(seconds) else max(0.0, (1.0 - self.reserve) * seconds - self.spent)

    @property
    def is_over(self) -> bool:
        """Whether no time is left."""
        return self.left <= 0.0

    @property
    def text(self) -> str:
        """The remaining time in words; empty without a budget."""
        return "" if math.isinf(self.left) else f"; {self.left:.2g} s of {self.seconds:.3g} s left"


def errs_by_rounding(errors: Errors, floors: Errors) -> bool:
    """Return whether no error exceeds rounding or the uncertainty of the reference."""
    pairs = zip(astuple(errors), astuple(floors), strict=True)
    return all(math.isnan(error) or error <= max(floor, ROUNDING) for error, floor in pairs)


def is_beaten(errors: Errors, rival: Errors, floors: Errors) -> bool:
    """Return whether a rival has no larger error of any kind, within the uncertainty of the reference."""
    rows = zip(astuple(errors), astuple(rival), astuple(floors), strict=True)
    return all(math.isnan(mine) or theirs <= max(mine, floor) for mine, theirs, floor in rows)


def estimated_cost(result: SettingResult, written: SettingResult) -> float:
    """Estimate the least cost (s) of a setting without timings, from the cost of the scene as written; 0 if unknown."""
    if not (written.costs and written.followed and result.followed and result.steps):
        return 0.0
    return written.cost * min(result.followed / written.followed, result.steps / written.steps)
