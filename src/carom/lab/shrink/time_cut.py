"""Cuts time: a scene that begins as late and ends as early as the failure allows."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

from carom import Frame, Space
from carom.extend import Schedule, every
from carom.lab.run_summary import Observation
from carom.lab.shrink.literal import BodyStates, Document, at_moment, with_value
from carom.lab.shrink.trials import Smallest, Trials, observe

ROOM = 200_000_000  # bytes of states that are kept of a run
ROUNDING = 1e-9  # of the duration, since a sum of steps may fall short of it
STEPS_AFTER = (0, 1, 3)  # steps to add after the failure, where a shorter run takes other steps


@dataclass(slots=True)
class Chronicle:
    """The states of a run, thinned where there are too many, up to the first that shows the failure."""

    moments: list[BodyStates] = field(default_factory=list)
    end: BodyStates | None = None  # the last state; the first that shows the failure, if one does
    shown: bool = False  # whether it does
    _gap: int = 1  # frames from one kept state to the next
    _frames: int = 0

    def keep(self, frame: Frame) -> None:
        """Keep a state, or drop every other one when there is no room."""
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
    """Run a space up to the failure and keep the states of its frames; ``first`` gets the first observation."""
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
    """Let the smallest scene end right after the failure and begin as late as it can; tell whether it changed."""
    if smallest.steps <= 1:
        return False
    kept, _ = chronicle(trials.space(smallest.scene), trials, every(0.0))
    if trials.condition.of_whole_run:
        return cut_both_ends(smallest, kept)
    ended = kept.end is not None and kept.shown and end_at(smallest, kept.end)
    return begin_late(smallest, smallest.document, kept) or ended


def cut_both_ends(smallest: Smallest, kept: Chronicle) -> bool:
    """End as early and begin as late as a failure of whole runs allows, by bisection; tell whether that is shorter.

    Each candidate is a run of a command, say, so there are few: twice the logarithm of the number of states.
    """
    ended = _end_early(smallest, kept)
    return _begin_by_bisection(smallest, kept) or ended


def end_at(smallest: Smallest, end: BodyStates) -> bool:
    """End the smallest scene at a moment; later if the last step, which is cut, shows nothing."""
    document, whole = smallest.document, smallest.scene.time.duration
    for after in STEPS_AFTER:
        duration = end.time + after * end.dt
        if 0.0 < duration < whole and smallest.takes_shorter(with_value(document, ("time", "duration"), duration)):
            return True
    return False


def _end_early(smallest: Smallest, kept: Chronicle) -> bool:
    """Find the first state at which the smallest scene may end, by bisection; tell whether it is not the last."""
    document, lo, hi = smallest.document, 1, len(kept.moments) - 1
    while lo < hi:
        middle = (lo + hi) // 2
        if smallest.takes_shorter(with_value(document, ("time", "duration"), kept.moments[middle].time)):
            hi = middle
        else:
            lo = middle + 1
    return smallest.document != document


def _begin_by_bisection(smallest: Smallest, kept: Chronicle) -> bool:
    """Find the last state at which the smallest scene may begin; tell whether it is not the first."""
    document, end = smallest.document, smallest.scene.time.duration
    earlier = [moment for moment in kept.moments if 0.0 < moment.time < end]
    lo, hi = 0, len(earlier)
    while lo < hi:
        middle = (lo + hi) // 2
        moment = earlier[middle]
        duration = (end - moment.time) * (1.0 + ROUNDING) + moment.dt  # other steps may be taken from here
        if smallest.takes_shorter(at_moment(document, moment, duration)):
            lo = middle + 1
        else:
            hi = middle
    return smallest.document != document


def begin_late(smallest: Smallest, document: Document, kept: Chronicle) -> bool:
    """Begin a document at the last of its states that leads to the failure; tell whether there is one but the first."""
    if kept.end is None:
        return False
    earlier = [moment for moment in kept.moments if 0.0 < moment.time < kept.end.time]
    for moment in _backwards(earlier):
        for after in STEPS_AFTER:
            duration = (kept.end.time - moment.time) * (1.0 + ROUNDING) + after * kept.end.dt
            if smallest.takes_shorter(at_moment(document, moment, duration)):
                return True
    return False


def _backwards(moments: list[BodyStates]) -> Iterator[BodyStates]:
    """Yield states from the last one back, in steps that grow by half."""
    back = 1
    while back <= len(moments):
        yield moments[-back]
        back = max(back + 1, back + back // 2)
