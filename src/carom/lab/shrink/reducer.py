"""Reduces a scene to the smallest scene that shows a failure: the passes over its time, and the order of all passes."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

from carom.errors import ExperimentError
from carom.lab.run_summary import Observation
from carom.lab.shrink.leave_out import drop_parts, leave_out_bodies, round_numbers, set_defaults
from carom.lab.shrink.literal import BodyStates, Document, at_moment, literal, with_value
from carom.lab.shrink.trials import Budget, Condition, Judges, OutOfTime, Smallest, Trials, observe
from carom.physics.placement import place
from carom.physics.schedule import Schedule, every
from carom.physics.space import Space
from carom.runs.environment import Interrupts
from carom.scene.load import Scene
from carom.scene.start import InitialBodies
from carom.scene.wording import counted
from carom.state.frame import Frame

ROOM = 200_000_000  # largest number of bytes for stored states of a run
ROUNDING = 1e-9  # fraction of the duration by which a sum of steps may fall short
STEPS_AFTER = (0, 1, 3)  # numbers of steps added after the failure, since a shorter run may have different steps


@dataclass(slots=True)
class Chronicle:
    """The states of a run up to the failure. When the memory is full, every second state is dropped."""

    moments: list[BodyStates] = field(default_factory=list)
    end: BodyStates | None = None  # the first state that shows the failure, or otherwise the last state
    shown: bool = False  # whether the run shows the failure
    _gap: int = 1  # frames from one kept state to the next
    _frames: int = 0

    def keep(self, frame: Frame) -> None:
        """Store the state of a frame."""
        self.end = BodyStates.of(frame)
        if self._frames % self._gap == 0:
            self.moments.append(self.end)
            if len(self.moments) * self.end.size > ROOM:
                self.moments, self._gap = self.moments[::2], 2 * self._gap
        self._frames += 1


def chronicle(
    space: Space,
    trials: Trials,
    schedule: Schedule | None = None,
    first: Callable[[Observation], None] = lambda seen: None,
) -> tuple[Chronicle, Observation]:
    """Run a space up to the failure and store its states; ``first`` is called with the first observation."""
    kept = Chronicle()

    def see(seen: Observation, frame: Frame) -> bool:
        if kept.end is None:
            first(seen)
        kept.keep(frame)
        kept.shown = not trials.condition.of_whole_run and trials.condition.holds(seen)
        return not kept.shown

    seen = observe(space, trials.budget, see, schedule=schedule)
    assert seen is not None, "no limit of steps was given"
    return kept, seen


def cut_time(smallest: Smallest, trials: Trials) -> bool:
    """Let the smallest scene end at the failure and begin as late as possible; return whether it changed."""
    if smallest.steps <= 1:
        return False
    kept, _ = chronicle(trials.space(smallest.scene), trials, every(0.0))
    if trials.condition.of_whole_run:
        return cut_both_ends(smallest, kept)
    ended = kept.end is not None and kept.shown and end_at(smallest, kept.end)
    return begin_late(smallest, smallest.document, kept) or ended


def cut_both_ends(smallest: Smallest, kept: Chronicle) -> bool:
    """Bisect for the earliest end and latest beginning of a whole run that fails; return whether it became shorter.

    Candidates are expensive, so there are few: twice the logarithm of the number of states.
    """
    document = before = smallest.document
    lo, hi = 1, len(kept.moments) - 1
    while lo < hi:
        middle = (lo + hi) // 2
        if smallest.takes_shorter(with_value(document, ("time", "duration"), kept.moments[middle].time)):
            hi = middle
        else:
            lo = middle + 1
    document, end = smallest.document, smallest.scene.time.duration
    earlier = [moment for moment in kept.moments if 0.0 < moment.time < end]
    lo, hi = 0, len(earlier)
    while lo < hi:
        middle = (lo + hi) // 2
        moment = earlier[middle]
        duration = (end - moment.time) * (1.0 + ROUNDING) + moment.dt  # steps may differ from here on
        if smallest.takes_shorter(at_moment(document, moment, duration)):
            lo = middle + 1
        else:
            hi = middle
    return smallest.document != before


def end_at(smallest: Smallest, end: BodyStates) -> bool:
    """End the smallest scene at a moment, or later if the failure does not show in the shortened last step."""
    document, whole = smallest.document, smallest.scene.time.duration
    for after in STEPS_AFTER:
        duration = end.time + after * end.dt
        if 0.0 < duration < whole and smallest.takes_shorter(with_value(document, ("time", "duration"), duration)):
            return True
    return False


def begin_late(smallest: Smallest, document: Document, kept: Chronicle) -> bool:
    """Begin a document at the last state that leads to the failure; return whether it is later than the first state."""
    if kept.end is None:
        return False
    earlier = [moment for moment in kept.moments if 0.0 < moment.time < kept.end.time]
    back = 1
    while back <= len(earlier):
        moment = earlier[-back]
        for after in STEPS_AFTER:
            duration = (kept.end.time - moment.time) * (1.0 + ROUNDING) + after * kept.end.dt
            if smallest.takes_shorter(at_moment(document, moment, duration)):
                return True
        back = max(back + 1, back + back // 2)  # the intervals grow by half
    return False


_GOES_AWAY = "the failure disappears when every body is written out, so it cannot be shrunk"
MOST_ROUNDS = 12  # largest number of rounds of all passes, even if the scene still changes


@dataclass(frozen=True, slots=True)
class Stage:
    """The state of the reduction after a pass."""

    name: str
    bodies: int
    steps: int
    candidates: int  # candidates so far


@dataclass(slots=True)
class ReducerProgress:
    """The progress that a watcher receives."""

    stage: str = "running the scene"
    bodies: int = 0
    steps: int = 0
    candidates: int = 0  # number of candidates so far, including the running candidate
    kept: int = 0  # number of these candidates that were kept
    seconds: float = 0.0


@dataclass(frozen=True, slots=True)
class Reduction:
    """The result of a reduction."""

    document: Document
    said: str  # the failure of the reduced run
    bodies: int
    steps: int
    before: tuple[int, int]  # bodies and steps up to the failure in the given scene
    stages: list[Stage]
    seconds: float
    candidates: int
    kept: int  # number of candidates that show the failure; each replaced the previous smallest scene
    stopped: str = ""  # the reason for an early end; empty if nothing more can be left out

    @property
    def minimal(self) -> bool:
        """Whether nothing more can be left out."""
        return not self.stopped


@dataclass(slots=True)
class Reducer:
    """Reduces a scene."""

    condition: Condition  # the failure to keep
    seconds: float = math.inf  # the budget
    watch: Callable[[ReducerProgress], None] = lambda progress: None  # called before each candidate and after a success
    # called with each smaller scene and its failure
    keep: Callable[[Document, str], None] = lambda document, said: None
    before: tuple[int, int] | None = None  # bodies and steps of the original scene, if an earlier reduction began there
    # processes for candidates of delta debugging; None means one process for each core, and 1 means this process alone
    workers: int | None = 1
    _progress: ReducerProgress = field(default_factory=ReducerProgress)
    _stages: list[Stage] = field(default_factory=list)

    def reduce(self, scene: Scene, start: InitialBodies | None = None) -> Reduction:
        """Return the smallest scene found that shows the same failure as ``scene``.

        ``start`` has the scene's bodies at time 0; by default, the scene places them. Raises ExperimentError if the
        scene does not show the failure, or time ran out before it was reproduced, and SceneError if the scene cannot
        run.
        """
        with Interrupts() as interrupts, Judges(self.workers) as judges:
            budget = Budget(self.seconds, interrupts)
            trials = Trials(self.condition, budget, judges=judges)
            trials.watch = lambda: self._look(trials)
            try:
                smallest, cut = self._begin(scene, start or place(scene), trials)
            except OutOfTime as ended:
                raise ExperimentError(f"{ended} before the failure was reproduced; nothing is written") from None
            stopped = self._pass_all(smallest, cut, trials)
            if not smallest.kept:
                tried = counted(trials.count, "smaller scene")
                raise ExperimentError(f"the scene fails, but {stopped} after {tried}; nothing is written")
            return Reduction(
                document=smallest.document,
                said=smallest.said,
                bodies=smallest.bodies,
                steps=smallest.steps,
                before=self.before or (smallest.bodies, smallest.steps),
                stages=self._stages,
                seconds=budget.spent,
                candidates=trials.count,
                kept=smallest.kept,
                stopped=stopped,
            )

    def _begin(self, scene: Scene, start: InitialBodies, trials: Trials) -> tuple[Smallest, Callable[[], None]]:
        """Run the scene up to the failure; return it with bodies written out, and the first pass, which cuts time."""
        trials.budget.check()
        threads = 1 if trials.condition.of_whole_run else None  # this run is compared with one on two threads
        space = Space(scene, threads, start, record_contacts=trials.condition.needs_impacts)
        kept, seen = chronicle(space, trials, first=trials.condition.check)
        trials.condition = trials.condition.pinned(seen)
        self._progress.bodies, self._progress.steps = len(start.name), space.step
        self.before = self.before or (len(start.name), space.step)
        whole = literal(scene, start)

        def taken(smallest: Smallest) -> None:
            self._progress.bodies, self._progress.steps = smallest.bodies, smallest.steps
            self._progress.kept = smallest.kept
            self._look(trials)
            self.keep(smallest.document, smallest.said)

        smallest = Smallest(whole, seen, trials, taken)
        return smallest, lambda: self._cut_first(smallest, whole, kept, trials)

    def _cut_first(self, smallest: Smallest, whole: Document, kept: Chronicle, trials: Trials) -> None:
        """Begin as late as the failure allows; a failure of whole runs is first reproduced with bodies written out."""
        self._progress.stage = "cutting time"
        if trials.condition.of_whole_run:
            if not smallest.is_shown():
                raise ExperimentError(_GOES_AWAY)
            cut_both_ends(smallest, kept)
        elif not begin_late(smallest, whole, kept):
            # the scene begins at the start of the run, with every body written out
            assert kept.end is not None
            duration = kept.end.time if kept.shown else 0.0
            ends = [duration, duration + kept.end.dt] if duration else []
            candidates = [at_moment(whole, kept.moments[0], end) for end in ends]
            if not any(smallest.takes(candidate) for candidate in candidates) and not smallest.is_shown():
                raise ExperimentError(_GOES_AWAY)
        self._end_stage("cut time", smallest, trials)

    def _pass_all(self, smallest: Smallest, cut: Callable[[], None], trials: Trials) -> str:
        """Shorten the run, then repeat all passes until no pass changes the scene; return why passes ended early."""
        passes: dict[str, Callable[[], bool]] = {
            "left out bodies": lambda: leave_out_bodies(smallest, trials),
            "cut time": lambda: cut_time(smallest, trials),
            "dropped parts of the model": lambda: drop_parts(smallest),
            "set constants to defaults": lambda: set_defaults(smallest),
            "rounded numbers": lambda: round_numbers(smallest),
        }
        try:
            cut()
            for _ in range(MOST_ROUNDS):
                changed = False
                for name, work in passes.items():
                    self._progress.stage = name
                    found = work()
                    if found:
                        self._end_stage(name, smallest, trials)
                    changed |= found
                if not changed:
                    return ""
        except OutOfTime as ended:
            return str(ended)
        return f"it still changed after {MOST_ROUNDS} rounds"

    def _look(self, trials: Trials) -> None:
        self._progress.candidates, self._progress.seconds = trials.count, trials.budget.spent
        self.watch(self._progress)

    def _end_stage(self, name: str, smallest: Smallest, trials: Trials) -> None:
        self._stages.append(Stage(name, smallest.bodies, smallest.steps, trials.count))
