"""The smallest scene so far that shows the failure."""

from __future__ import annotations

from collections.abc import Callable

from carom.lab.shrink.literal import BODIES, Document
from carom.lab.shrink.observation import Observation
from carom.lab.shrink.trials import Trials
from carom.scene.load import scene_from_dict
from carom.scene.schema import Scene


class Smallest:
    """Takes over every candidate that still shows the failure.

    Parameters
    ----------
    document
        A scene that shows it.
    seen
        What was seen of its run.
    trials
        Judges candidates.
    taken
        Called after a candidate was taken over.
    """

    def __init__(
        self, document: Document, seen: Observation, trials: Trials, taken: Callable[[Smallest], None] = lambda _: None
    ) -> None:
        self._trials = trials
        self._taken = taken
        self.kept = 0  # candidates that were taken over
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
        return scene_from_dict(self.document)

    @property
    def bodies(self) -> int:
        """Number of bodies."""
        return len(self.document[BODIES])

    def takes_shorter(self, document: Document) -> bool:
        """Take over a candidate if it shows the failure in fewer steps."""
        return self.steps > 1 and self.takes(document, self.steps - 1)

    def takes_as_short(self, document: Document) -> bool:
        """Take over a candidate if it shows the failure in no more steps."""
        return self.takes(document, max(self.steps, 1))

    def takes(self, document: Document, steps: int | None = None) -> bool:
        """Take over a candidate if it shows the failure, in at most so many steps; see `Trials.shows`.

        Raises
        ------
        OutOfTime
            If the time is over.
        """
        return document != self.document and self._try(document, steps)

    def is_shown(self) -> bool:
        """Run the scene itself; tell whether it shows the failure.

        Raises
        ------
        OutOfTime
            If the time is over.
        """
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
        """Take over the first of several candidates that shows the failure; return its number.

        Raises
        ------
        OutOfTime
            If the time is over.
        """
        number = 0
        while (found := self._trials.promising(documents, number)) is not None:
            if self.takes(documents[found]):
                return found
            number = found + 1
        return None
