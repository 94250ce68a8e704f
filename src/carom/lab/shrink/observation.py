"""What a condition sees of a run: its summary so far, its events and its impacts, without a recording."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import Any

import numpy as np

from carom.errors import PhysicsError
from carom.event import Event
from carom.physics.frame import Frame
from carom.physics.space import Space
from carom.runs.environment import versions
from carom.runs.expectation import Verdict, judge
from carom.runs.run import closing_summary
from carom.scene.start import half_spaces
from carom.scene.wording import Names

Pair = frozenset[str]  # names of both ends

SUNK = 0.05  # of the smaller radius: a deeper overlap must not last
LASTING = 20  # steps
STEADY = 0.01  # of the smaller radius: an overlap that changes less in so many steps is one at rest


class Touches:
    """The pairs that met so far, by their names, which stay when other bodies are left out.

    Attributes
    ----------
    pairs
        Those that met.
    sunk
        Those that overlap at rest: the overlap over the smaller radius.
    """

    def __init__(self, space: Space) -> None:
        self._names = Names(list(space.names), list(half_spaces(space.scene).name))
        self._radius = space.state.radius
        self._since: dict[Pair, tuple[int, float]] = {}  # step from which on an overlap is steady, and the overlap then
        self.pairs: set[Pair] = set()
        self.sunk: dict[Pair, float] = {}

    def see(self, frame: Frame) -> None:
        """Add the impacts since the frame before, and look for overlaps that last."""
        if frame.impacts is not None:
            self.pairs |= {self._pair(int(row["i"]), int(row["j"])) for row in frame.impacts}
        since, self._since = self._since, {}
        for (i, j), overlap in zip(frame.contacts.pairs, frame.contacts.overlaps, strict=True):
            depth = float(overlap / min(self._radius[i], self._radius[j] if j < len(self._radius) else np.inf))
            if depth > SUNK:
                pair = self._pair(int(i), int(j))
                step, before = since.get(pair, (frame.step, depth))
                self._since[pair] = (step, before) if abs(depth - before) <= STEADY else (frame.step, depth)
        self.sunk = {pair: depth for pair, (step, depth) in self._since.items() if frame.step - step >= LASTING}

    def _pair(self, i: int, j: int) -> Pair:
        return frozenset((end_name(self._names, i), end_name(self._names, j)))


def end_name(names: Names, end: int) -> str:
    """Return the name of a body or a plane, without its number."""
    return names.bodies[end] if end < len(names.bodies) else names.of(end)


class Observation:
    """A run up to a frame.

    Parameters
    ----------
    space
        The run.
    initial
        J, its energy at the start.
    frames
        Number of frames so far.
    warnings
        Those so far.
    touches
        The pairs that met so far.
    error
        The message with which it failed; empty if it did not.
    stated
        Whether that is a PhysicsError, which the engine gives as a reason.
    """

    def __init__(
        self,
        space: Space,
        initial: float,
        frames: int,
        warnings: list[Event],
        touches: Touches,
        error: str = "",
        stated: bool = False,
    ) -> None:
        self.space = space
        self.error = error
        self.stated = stated
        self.warned = frozenset(warning.kind for warning in warnings)
        self.touches = touches
        self._initial = initial
        self._frames = frames
        self._warnings = warnings

    @cached_property
    def verdicts(self) -> list[Verdict]:
        """The promises of the scene."""
        return judge(self.space.scene, self.space.named_extremes(), self.space.time)

    @cached_property
    def summary(self) -> dict[str, Any]:
        """The numbers that `carom inspect --json` prints of a recording, without those of the recording itself."""
        space = self.space
        closing = _nested(closing_summary(space, space.named_extremes(), self.verdicts))
        for moment in closing.get("moments", {}).values():
            for ends in ("bodies", "planes"):
                moment[ends] = [int(number) for number in moment[ends].split(",") if number]
        for section in ("momentum", "angular_momentum"):
            closing.setdefault(section, {"max_error": None})
        final = space.status.energy.total
        energy = {"initial": self._initial, "final": final, "max_error": 0.0} | closing.pop("energy", {})
        contacts = {"total": 0, "max_overlap": 0.0} | closing.pop("contacts", {})
        closing.pop("profile", None)
        missed = [str(verdict) for verdict in self.verdicts if not verdict.met]
        outcome = f"failed: {self.error}" if self.error else "expectation missed" if missed else "completed"
        return {
            "scene": {"title": space.scene.title},
            "bodies": len(space.state),
            "frames": self._frames,
            "outcome": outcome,
            "energy": energy,
            "contacts": contacts,
            "warnings": [{"step": w.step, "time": w.time, "text": w.text, "kind": w.kind} for w in self._warnings],
            "moments": {},
            "accuracy": {},
            "versions": versions(),
            "expect": {},
        } | closing


def said_by(error: Exception) -> str:
    """Return the message of a PhysicsError; of any other exception also its type."""
    return str(error) if isinstance(error, PhysicsError) else f"{type(error).__name__}: {error}"


def _nested(properties: Mapping[str, Any]) -> dict[str, Any]:
    """Nest entries by the dots in their keys."""
    found: dict[str, Any] = {}
    for key, value in properties.items():
        *path, last = key.split(".")
        node = found
        for name in path:
            node = node.setdefault(name, {})
        node[last] = value
    return found
