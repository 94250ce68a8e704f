"""Judges candidates in several processes."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from types import TracebackType
from typing import Self

from carom.lab.shrink.budget import Budget
from carom.lab.shrink.condition import Condition
from carom.lab.shrink.literal import Document
from carom.physics.parallel.cores import cores
from carom.runs.interrupts import Interrupts
from carom.runs.workers import LocalWorkers, WorkerDiedError

START = 6.0  # s, about twice what workers take to start
MIN_SECONDS_TO_SEND = 0.05  # s of a candidate; shorter ones take as long to send
AHEAD = 2  # candidates a worker that are sent before they are needed
_TICK = 0.1  # s between two checks of the budget


@dataclass(frozen=True, slots=True)
class Task:
    """A candidate, the failure that it should show, and in how many steps at most."""

    document: Document
    condition: Condition
    steps: int


def execute(task: Task) -> bool:
    """Tell whether a candidate shows the failure."""
    from carom.lab.shrink.trials import Trials  # noqa: PLC0415 - imports this module

    trials = Trials(task.condition, Budget(math.inf, Interrupts()))
    return trials.judge(task.document, task.steps) is not None


class Judges:
    """Processes that judge candidates, started when these take long enough.

    The result does not depend on them: of several candidates the first in order that shows the failure is taken.

    Parameters
    ----------
    count
        Processes; None is one for each core, and 1 judges all candidates in this process.
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
        """Tell whether to judge candidates here that take so long each; starts the processes where that pays."""
        if self._count == 1 or candidates < 2:
            return False
        if self._workers is None and seconds * candidates > START:
            self._workers = LocalWorkers(self._count)
        return self._workers is not None and seconds > MIN_SECONDS_TO_SEND

    def first(
        self, documents: Sequence[Document], condition: Condition, steps: int, check: Callable[[], None]
    ) -> int | None:
        """Return the number of the first candidate that shows a failure.

        Parameters
        ----------
        documents
            The candidates.
        condition
            The failure.
        steps
            How many each may take.
        check
            Called several times a second; what it raises ends the work.

        Raises
        ------
        ExperimentError
            If the workers died.
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
