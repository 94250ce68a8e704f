"""Tests candidates within a budget, in one or several processes; `Smallest` keeps the smallest that still fails."""

from __future__ import annotations

import math
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from types import TracebackType
from typing import Self

from carom.errors import ExperimentError, PhysicsError
from carom.event import Event
from carom.lab.run_summary import Observation, Touches, said_by
from carom.lab.shrink.literal import BODIES, Document
from carom.physics.jit import cores
from carom.physics.schedule import Every, Schedule
from carom.physics.space import Space
from carom.plan import auto
from carom.runs.environment import Interrupts
from carom.runs.workers import LocalWorkers, WorkerDiedError
from carom.scene.load import Scene
from carom.scene.scene_file import toml_text
from carom.state.frame import Frame


@dataclass(frozen=True, slots=True)
class Condition(ABC):
    """A failure of a run. A condition is evaluated after every recorded frame, for the run so far."""

    text: str  # text of the condition, as given
    needs_impacts = False  # whether the condition depends on the impacts of the run
    of_whole_run = False  # whether the condition is evaluated only at the end

    def check(self, seen: Observation) -> None:  # noqa: B027 - without names there is nothing to check
        """Check the names at the first frame of the run.

        Raises ExperimentError if the condition uses an unknown name; the message suggests the nearest known name.
        """

    @abstractmethod
    def pinned(self, seen: Observation) -> Condition:
        """Return a condition that holds only for the same failure.

        Raises ExperimentError if the run does not show the failure; the message describes what it shows.
        """

    @abstractmethod
    def holds(self, seen: Observation) -> bool:
        """Return whether the run shows the failure."""

    @abstractmethod
    def said(self, seen: Observation) -> str:
        """Describe the failure, for the comments of the result."""

    def bodies(self, seen: Observation) -> set[str]:
        """Return the names of the bodies involved, if they are known."""
        return set()


_POLL = 0.05  # s between two checks of a run


class OutOfTime(Exception):  # noqa: N818 - not an error: the smallest scene so far is the result
    """Time has run out, or the user has ended the reduction."""


class Budget:
    """The time of a reduction in s, infinite without a limit; the user may end the reduction earlier."""

    def __init__(self, seconds: float, interrupts: Interrupts) -> None:
        self._began = time.monotonic()
        self._seconds = seconds
        self._interrupts = interrupts

    @property
    def spent(self) -> float:
        """The time so far in s."""
        return time.monotonic() - self._began

    @property
    def reason(self) -> str:
        """The reason why the reduction has ended; empty while it continues."""
        if self._interrupts.count:
            return f"stopped by {self._interrupts.sender}"
        return "the budget was spent" if self.spent > self._seconds else ""

    def check(self) -> None:
        """Raise `OutOfTime` when the time is used up."""
        if reason := self.reason:
            raise OutOfTime(reason)

    @contextmanager
    def guarding(self, space: Space) -> Iterator[None]:
        """Stop a run when time has run out, and then raise `OutOfTime`."""
        self.check()
        over = threading.Event()

        def watch() -> None:
            while not over.wait(_POLL):
                if self.reason:
                    space.stop()
                    return

        watcher = threading.Thread(target=watch, name="budget", daemon=True)
        watcher.start()
        try:
            yield
        finally:
            over.set()
            watcher.join()
        self.check()


STEPS_MORE = 4  # step limit of a candidate, in multiples of the steps of the smallest scene so far
FEWEST_STEPS = 2000


@dataclass(frozen=True, slots=True)
class EveryUpTo(Every):
    """A schedule of frames at multiples of an interval, and at the step after which a run is abandoned."""

    last: int

    def __call__(self, step: int, before: float, time: float) -> bool:
        """Return whether a step passes a multiple, or is the last step."""
        return step == self.last or Every.__call__(self, step, before, time)

    def quiet(self, step: int, time: float) -> tuple[float, float]:
        """Return the number of steps and the time (s) up to which no frame is due."""
        steps, until = Every.quiet(self, step, time)
        return min(steps, max(1, self.last - step)), until


def observe(
    space: Space,
    budget: Budget,
    each: Callable[[Observation, Frame], bool] = lambda seen, frame: True,
    *,
    steps: int | None = None,
    schedule: Schedule | None = None,
) -> Observation | None:
    """Run a space from its start and return the observation of its end; None if the run is abandoned after ``steps``.

    ``each`` is called at each frame with the observation so far, and returns whether to continue. By default, frames
    follow the schedule of the scene. Raises `OutOfTime` if the budget ends before the run.
    """
    interval = auto.frame_interval(space.scene)
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
        except Exception as error:  # an error in the engine may be the failure itself
            stated = isinstance(error, PhysicsError)
            return Observation(space, initial, frames, warnings, touches, said_by(error), stated)
    return seen


@dataclass(slots=True)
class Trials:
    """Tests candidates and remembers the rejected ones. Raises `OutOfTime` when time has run out."""

    condition: Condition  # the failure to keep
    budget: Budget
    steps: int = FEWEST_STEPS  # steps of the smallest scene so far
    count: int = 0  # candidates that ran
    watch: Callable[[], None] = lambda: None  # called before each candidate runs
    judges: Judges | None = None  # processes that test several candidates at a time if a candidate takes long
    _seconds: float = 0.0  # s, duration of the last candidate
    _rejected: set[int] = field(default_factory=set)  # hashes of candidates that do not show the failure

    def shows(self, document: Document, steps: int | None = None) -> Observation | None:
        """Run a candidate; return its observation if it still shows the failure.

        By default, a candidate may take a few times as many steps as the smallest scene so far.
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
        """Return the number of the next candidate that may show the failure; None if there is none.

        Without judges, this is simply the next candidate. Judges test candidates ahead, so with judges it is the first
        candidate that shows the failure.
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
        """Default limit of the steps of a candidate."""
        return max(FEWEST_STEPS, STEPS_MORE * self.steps)

    def judge(self, document: Document, steps: int) -> Observation | None:
        """Run a candidate for at most ``steps`` steps; return its observation if it shows the failure."""
        if not document[BODIES]:
            return None
        try:
            space = self.space(Scene.from_dict(document))
        except Exception:  # an invalid scene, or an error before the first step
            return None
        seen = observe(space, self.budget, steps=steps + 1)
        return seen if seen is not None and self.condition.holds(seen) else None

    def space(self, scene: Scene) -> Space:
        """Return a space whose frames carry the data that the condition depends on."""
        return Space(scene, threads=1, record_contacts=self.condition.needs_impacts)


START = 6.0  # s, about twice the time that workers take to start
MIN_SECONDS_TO_SEND = 0.05  # s, shortest run that is sent to a worker; sending takes about as long
AHEAD = 2  # candidates sent ahead to each worker
_TICK = 0.1  # s between two checks of the budget


@dataclass(frozen=True, slots=True)
class Task:
    """A candidate, the failure that it should show, and the limit of its steps."""

    document: Document
    condition: Condition
    steps: int


def execute(task: Task) -> bool:
    """Return whether a candidate shows the failure."""
    trials = Trials(task.condition, Budget(math.inf, Interrupts()))
    return trials.judge(task.document, task.steps) is not None


class Judges:
    """Processes that test candidates, started once candidates take long enough; ``None`` means one for each core.

    The result does not depend on the number of processes: of the candidates that show the failure, the first in order
    is chosen.
    """

    def __init__(self, count: int | None) -> None:
        self._count = count or cores()
        self._workers: LocalWorkers | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if self._workers is not None:
            self._workers.__exit__(kind, error, traceback)

    def pay(self, seconds: float, candidates: int) -> bool:
        """Return whether processes are worthwhile for candidates of this duration; start them if so."""
        if self._count == 1 or candidates < 2:
            return False
        if self._workers is None and seconds * candidates > START:
            self._workers = LocalWorkers(self._count)
        return self._workers is not None and seconds > MIN_SECONDS_TO_SEND

    def first(
        self, documents: Sequence[Document], condition: Condition, steps: int, check: Callable[[], None]
    ) -> int | None:
        """Return the number of the first candidate that shows a failure within the steps; None if no candidate does.

        ``check`` is called several times a second; its exceptions end the work. Raises ExperimentError if the workers
        die.
        """
        workers = self._workers
        assert workers is not None, "they have started"
        verdicts: dict[int, bool] = {}
        sent = 0
        try:
            for number in range(len(documents)):
                ahead = range(sent, min(len(documents), number + AHEAD * self._count))
                workers.send(execute, {each: Task(documents[each], condition, steps) for each in ahead})
                sent = max(sent, ahead.stop)
                while number not in verdicts:
                    check()
                    verdicts |= {ended.key: ended.result for ended in workers.ended(_TICK)}
                if verdicts[number]:
                    return number
        except WorkerDiedError as error:
            raise WorkerDiedError(f"{error} --workers 1 needs none") from None
        finally:
            workers.drop()
        return None


class Smallest:
    """The smallest scene so far that shows the failure.

    It begins as a document that shows the failure, with the observation of its run. A candidate that still shows the
    failure replaces the smallest scene; ``taken`` is called after each replacement.
    """

    def __init__(
        self, document: Document, seen: Observation, trials: Trials, taken: Callable[[Smallest], None]
    ) -> None:
        self._trials = trials
        self._taken = taken
        self.kept = 0  # number of adopted candidates
        self._keep(document, seen)

    def _keep(self, document: Document, seen: Observation) -> None:
        self.document = document
        self.steps = seen.space.step
        self.said = self._trials.condition.said(seen)
        self.suspects = self._trials.condition.bodies(seen)
        self._trials.steps = self.steps

    @property
    def scene(self) -> Scene:
        """The scene, validated."""
        return Scene.from_dict(self.document)

    @property
    def bodies(self) -> int:
        """Number of bodies."""
        return len(self.document[BODIES])

    def takes_shorter(self, document: Document) -> bool:
        """Adopt a candidate if it shows the failure in fewer steps than the smallest scene."""
        return self.steps > 1 and self.takes(document, self.steps - 1)

    def takes_as_short(self, document: Document) -> bool:
        """Adopt a candidate if it shows the failure in no more steps than the smallest scene."""
        return self.takes(document, max(self.steps, 1))

    def takes(self, document: Document, steps: int | None = None) -> bool:
        """Adopt a candidate if it shows the failure in at most ``steps`` steps; see `Trials.shows`."""
        return document != self.document and self._try(document, steps)

    def is_shown(self) -> bool:
        """Run the scene itself; return whether it shows the failure."""
        return self._try(self.document, None)

    def _try(self, document: Document, steps: int | None) -> bool:
        seen = self._trials.shows(document, steps)
        if seen is None:
            return False
        self._keep(document, seen)
        self.kept += 1
        self._taken(self)
        return True

    def takes_first(self, documents: list[Document]) -> int | None:
        """Adopt the first of several candidates that shows the failure; return its number."""
        number = 0
        while (found := self._trials.promising(documents, number)) is not None:
            if self.takes(documents[found]):
                return found
            number = found + 1
        return None
