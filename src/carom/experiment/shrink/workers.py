"""Judges candidates on the workers of a sweep, several at a time. Needs `carom[cluster]`."""

from __future__ import annotations

import contextlib
import math
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

from carom.experiment.error import ExperimentError
from carom.experiment.interrupts import Interrupts
from carom.experiment.shrink.budget import Budget
from carom.experiment.shrink.condition import Condition
from carom.experiment.shrink.literal import Document
from carom.physics.parallel.cores import cores

if TYPE_CHECKING:
    from distributed import Client

START = 6.0  # s, about twice what workers take to start
MIN_SECONDS_TO_SEND = 0.05  # s of a candidate; shorter ones take as long to send
AHEAD = 2  # candidates a worker that are sent before they are needed
_TICK = 0.1  # s between two looks at the budget


@dataclass(frozen=True, slots=True)
class Task:
    """A candidate, the failure that it should show, and in how many steps at most."""

    document: Document
    condition: Condition
    steps: int


def execute(task: Task) -> bool:
    """Tell whether a candidate shows the failure."""
    from carom.experiment.shrink.trials import Trials  # noqa: PLC0415 - needs this module

    trials = Trials(task.condition, Budget(math.inf, Interrupts()))
    return trials.judge(task.document, task.steps) is not None


class Workers:
    """Workers that are started when candidates take long enough.

    The result does not depend on them: of several candidates the first in order that shows the failure is taken.

    Parameters
    ----------
    count
        Processes; None is one for each core, and 1 judges all candidates in this process.
    """

    def __init__(self, count: int | None) -> None:
        self._count = count
        self._client: Client | None = None
        self._stack = contextlib.ExitStack()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._stack.close()

    def pay(self, seconds: float, candidates: int) -> bool:
        """Tell whether to judge candidates here that take so long each; starts the workers where that pays."""
        if self._count == 1 or candidates < 2:
            return False
        if self._client is None and seconds * candidates > START:
            self._begin()
        return self._client is not None and seconds > MIN_SECONDS_TO_SEND

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
        from distributed import KilledWorker  # noqa: PLC0415 - optional

        client = self._client
        assert client is not None, "they have started"
        sent: dict[int, Any] = {}
        asked = 0
        try:
            for number in range(len(documents)):
                while asked < len(documents) and len(sent) < AHEAD * (self._count or 1):
                    sent[asked] = client.submit(execute, Task(documents[asked], condition, steps), pure=False)
                    asked += 1
                if self._result(sent.pop(number), check):
                    return number
        except KilledWorker as error:
            raise ExperimentError(
                f"the workers died, {error.last_worker.address} last; is there enough memory? --workers 1 needs none"
            ) from None
        finally:
            client.cancel(list(sent.values()))  # type: ignore[no-untyped-call]
        return None

    def _result(self, future: Any, check: Callable[[], None]) -> bool:
        done = threading.Event()
        future.add_done_callback(lambda _: done.set())
        while not done.wait(_TICK):  # `result` with a timeout of its own may fail in distributed, when both run out
            check()
        if future.cancelled():
            raise ExperimentError("the workers are gone; --workers 1 needs none")
        return bool(future.result())

    def _begin(self) -> None:
        """Start the workers; without `carom[cluster]` there are none."""
        try:
            from carom.experiment.sweep.cluster import connected  # noqa: PLC0415 - optional
        except ImportError:
            self._count = 1
            return
        self._count = self._count or cores()
        if self._count > 1:
            self._client = self._stack.enter_context(connected(None, self._count, self._count))
