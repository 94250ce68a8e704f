"""Inlets decide when bodies enter: one inlet for each group with a release, and one for all other bodies."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from carom.arrays import FloatArray, IntArray
from carom.scene.load import Scene
from carom.scene.units.dimension import TIME
from carom.state.checkpoint import PRESENT

ORIGIN, COUNT = range(2)  # columns of `Inlets.slots`


class Inlets:
    """The inlets of a scene, and how many bodies have entered.

    At an inlet with a rate, the slot number k is at the time origin + k/rate. Each body that enters takes the next
    slot. The first inlet is for bodies present from the start, which return as soon as there is room.
    """

    def __init__(self, scene: Scene, bodies: int) -> None:
        self.of_body = np.zeros(bodies, dtype=np.int64)  # number of each body's inlet
        self.begun = np.full(bodies, PRESENT)  # s, value of `ReleaseCheckpoint.since` at the start of the run
        rows = [(0.0, 0.0, np.inf)]
        self._names = ["bodies that come back"]
        first = bodies - sum(group.count for group in scene.group)
        for index, group in enumerate(scene.group):
            members = slice(first, first + group.count)
            first += group.count
            if (release := group.release) is None:
                continue
            self.of_body[members], self.begun[members] = len(rows), release.at
            rows.append((release.at, 1.0 / release.rate if release.rate else 0.0, release.until or np.inf))
            self._names.append(group.name or f"group {index}")
        self._at, self._interval, self._until = np.array(rows).T  # s; if an interval is 0, all bodies enter together
        self._units = scene.unit_system
        self.first_slots = np.stack([self._at, np.zeros(len(rows))], axis=1)
        self.slots = self.first_slots.copy()  # (k, 2), origin in s, and number of slots taken since the origin

    def __len__(self) -> int:
        return len(self._at)

    def closed(self, time: float, waiting: IntArray) -> IntArray:
        """Return the numbers of the inlets that are closed from a time (s) on, although bodies wait."""
        return np.flatnonzero((self._until <= time) & (waiting > 0))

    def room(self, time: float, waiting: IntArray) -> IntArray:
        """Return the number of waiting bodies that are due at a time (s), for each inlet, (k,)."""
        due = np.zeros(len(self), dtype=np.int64)
        for k in np.flatnonzero(waiting).tolist():
            if self._interval[k] == 0.0:
                due[k] = waiting[k] if self._at[k] <= time else 0
                continue
            while due[k] < waiting[k] and self._slot(k, int(due[k])) <= time:
                due[k] += 1
        return due

    def next_due(self, time: float, waiting: IntArray) -> float:
        """Return the first time (s) after a given time at which a waiting body is due."""
        found = np.inf
        for k, due in enumerate(self.room(time, waiting).tolist()):
            if due < waiting[k]:
                found = min(found, self._slot(k, due) if self._interval[k] else float(self._at[k]))
        return found

    def take(self, inlets: IntArray) -> None:
        """Count bodies that enter through inlets with these numbers, (b,)."""
        self.slots[:, COUNT] += np.bincount(inlets, minlength=len(self))

    def begin_again(self, inlets: IntArray, time: float, waiting: IntArray) -> None:
        """Restart the slots of inlets whose empty queues get their first body at a time (s)."""
        for k in np.unique(inlets).tolist():
            if self._interval[k] and not waiting[k] and self._slot(k, 0) < time:
                self.slots[k] = time, 0.0

    def blocked(self, time: float, since: FloatArray, waiting: IntArray, patience: float) -> Iterable[str]:
        """Yield a sentence for each inlet where a body has been due for longer than ``patience`` (s)."""
        for k in np.flatnonzero(self.room(time, waiting)).tolist():
            due = self._slot(k, 0) if self._interval[k] else float(self._at[k])
            due = max(due, float(since[(self.of_body == k) & (since != PRESENT)].min()))
            if time - due > patience:
                long = self._units.text(patience, TIME, ".3g")
                yield (
                    f"A body of {self._names[k]} could not enter for {long}, because other bodies are in its place; "
                    "enlarge its region, lower its rate, or give it a velocity out of the region."
                )

    def _slot(self, inlet: int, ahead: int) -> float:
        """Return the time (s) of the slot that is ``ahead`` slots after the next free one."""
        origin, taken = self.slots[inlet].tolist()
        return float(origin + (taken + ahead) * self._interval[inlet])
