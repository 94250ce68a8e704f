"""Runs candidates and tells whether they still show the failure."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field

from carom.errors import ExperimentError, PhysicsError
from carom.event import Event
from carom.lab.shrink.budget import Budget, OutOfTime
from carom.lab.shrink.condition import Condition
from carom.lab.shrink.judges import Judges
from carom.lab.shrink.literal import BODIES, Document
from carom.lab.shrink.observation import Observation, Touches, said_by
from carom.physics.frame import Frame
from carom.physics.schedule import Every, Schedule
from carom.physics.space import Space
from carom.plan.auto import frame_interval
from carom.scene.load import scene_from_dict
from carom.scene.schema import Scene
from carom.scene.toml_text import toml_text

Each = Callable[[Observation, Frame], bool]  # called at each frame; whether to go on

STEPS_MORE = 4  # times as many steps as the smallest scene so far may a candidate take
FEWEST_STEPS = 2000


@dataclass(frozen=True, slots=True)
class EveryUpTo(Every):
    """A frame at each multiple of an interval, and at one step, where a run may be given up."""

    last: int

    def __call__(self, step: int, before: float, time: float) -> bool:
        """Tell whether a step passes a multiple, or is the last."""
        return step == self.last or Every.__call__(self, step, before, time)

    def quiet(self, step: int, time: float) -> tuple[float, float]:
        """Return after how many steps, and up to which time in s, no frame is due before."""
        steps, until = Every.quiet(self, step, time)
        return min(steps, max(1, self.last - step)), until


def observe(
    space: Space,
    budget: Budget,
    each: Each = lambda seen, frame: True,
    *,
    steps: int | None = None,
    schedule: Schedule | None = None,
) -> Observation | None:
    """Run a space and return what a condition sees at its end.

    Parameters
    ----------
    space
        At the start of its run.
    budget
        The time of the reduction.
    each
        Called at each frame with what is seen so far; returns whether to go on.
    steps
        Number of steps after which the run is given up; None is returned then.
    schedule
        After which steps frames come; by default as the scene says.

    Raises
    ------
    OutOfTime
        If the time ended before the run.
    """
    interval = frame_interval(space.scene)
    schedule = schedule or (Every(interval) if steps is None else EveryUpTo(interval, steps))
    touches, warnings, frames, initial = Touches(space), list[Event](), 0, space.status.energy.total
    seen = Observation(space, initial, 0, warnings, touches)
    with budget.guarding(space):
        try:
            for frame in space.run(schedule=schedule):
                frames += 1
                touches.see(frame)
                warnings += [event for event in frame.events if event.level == "WARN"]
                seen = Observation(space, initial, frames, warnings, touches)
                if not each(seen, frame):
                    return seen
                if steps is not None and frame.step >= steps:
                    return None
        except (OutOfTime, ExperimentError):
            raise
        except Exception as error:  # a fault in the engine, which may be what is looked for
            stated = isinstance(error, PhysicsError)
            return Observation(space, initial, frames, warnings, touches, said_by(error), stated)
    return seen


@dataclass(slots=True)
class Trials:
    """Judges candidates and remembers the verdicts.

    Attributes
    ----------
    condition
        The failure to keep.
    budget
        The time of the reduction.
    steps
        Number of steps of the smallest scene so far.
    count
        Number of candidates that ran.
    watch
        Called before each candidate runs.
    judges
        Judge several candidates at a time, where these take long.
    """

    condition: Condition
    budget: Budget
    steps: int = FEWEST_STEPS
    count: int = 0
    watch: Callable[[], None] = lambda: None
    judges: Judges | None = None
    _seconds: float = 0.0  # that the last candidate took
    _rejected: set[int] = field(default_factory=set)  # hashes of candidates that do not show it

    def shows(self, document: Document, steps: int | None = None) -> Observation | None:
        """Run a candidate; return what is seen of it if it still shows the failure.

        Parameters
        ----------
        document
            The candidate.
        steps
            How many it may take; by default a few times as many as the smallest scene so far.

        Raises
        ------
        OutOfTime
            If the time is over.
        """
        self.budget.check()
        key = hash((toml_text(document), steps))
        if key in self._rejected:
            return None
        self.count += 1
        self.watch()
        began = time.monotonic()
        seen = self.judge(document, steps or self._most_steps)
        self._seconds = time.monotonic() - began
        if seen is None:
            self._rejected.add(key)
        return seen

    def promising(self, documents: list[Document], number: int) -> int | None:
        """Return the number of the next of several candidates that may show the failure; None if there is none.

        Without judges that is the next one. They judge the others ahead, so it is the first that shows it.

        Raises
        ------
        OutOfTime
            If the time is over.
        """
        rest = documents[number:]
        if self.judges is None or not self.judges.pay(self._seconds, len(rest)):
            return number if rest else None
        self.watch()
        found = self.judges.first(rest, self.condition, self._most_steps, self.budget.check)
        self.count += len(rest) if found is None else found
        return None if found is None else number + found

    @property
    def _most_steps(self) -> int:
        """Number of steps that a candidate may take, unless it is said otherwise."""
        return max(FEWEST_STEPS, STEPS_MORE * self.steps)

    def judge(self, document: Document, steps: int) -> Observation | None:
        """Run a candidate for so many steps at most; return what is seen of it if it shows the failure."""
        if not document[BODIES]:
            return None
        try:
            space = self.space(scene_from_dict(document))
        except Exception:  # a scene that cannot be, or a fault that shows before the first step
            return None
        seen = observe(space, self.budget, steps=steps + 1)
        return seen if seen is not None and self.condition.holds(seen) else None

    def space(self, scene: Scene) -> Space:
        """Build a space whose frames carry what the condition looks at."""
        return Space(scene, threads=1, record_contacts=self.condition.needs_impacts)
