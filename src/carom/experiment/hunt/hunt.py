"""Draws scenes, holds each to the laws, and files every miss, shrunk, with its recording."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from carom.experiment.error import ExperimentError
from carom.experiment.hunt.laws import Law, laws_of
from carom.experiment.hunt.scenes import drawn
from carom.experiment.interrupts import Interrupts
from carom.experiment.output import output_folder
from carom.experiment.run import recording_space, simulate
from carom.experiment.shrink.budget import Budget, OutOfTime
from carom.experiment.shrink.condition import Condition
from carom.experiment.shrink.observation import Observation
from carom.experiment.shrink.reducer import Reducer
from carom.experiment.shrink.result import key_of, text_of, write
from carom.experiment.shrink.trials import observe
from carom.physics.error import PhysicsError
from carom.physics.space import Space
from carom.scene.command import command
from carom.scene.error import SceneError
from carom.scene.load import scene_from_dict, scene_from_text
from carom.scene.schema import Scene

AUDIT = 1e-9  # of a speed, that impulses may leave unexplained: some 10⁶ roundings
STEPS = 400  # after which a scene is given up
SHARE = 0.2  # of the budget for the shrinking of one miss
LONGEST = 60.0  # s, likewise


@dataclass(frozen=True, slots=True)
class Miss:
    """A law that a scene breaks."""

    law: str
    index: int  # of the scene, for the same seed
    said: str  # what its run shows
    path: Path | None  # of the reduced scene; None if one like it was filed before
    bodies: int


@dataclass(slots=True)
class Tally:
    """What a hunt has done so far."""

    seed: int
    scenes: int = 0
    refused: int = 0
    stated: int = 0  # runs that ended with a stated reason
    given_up: int = 0  # runs of too many steps
    misses: list[Miss] = field(default_factory=list)
    seconds: float = 0.0
    stopped: str = ""


@dataclass(slots=True)
class Hunt:
    """Hunts for scenes that break a law.

    Parameters
    ----------
    seed
        Of the scenes; the same seed draws the same ones.
    folder
        Where misses are filed.
    seconds
        s, the budget.
    first, most
        Number of the first scene, and of scenes at most.
    watch
        Called after each scene.
    """

    seed: int
    folder: Path
    seconds: float = math.inf
    first: int = 0
    most: int | None = None
    watch: Callable[[Tally], None] = lambda tally: None
    tally: Tally = field(init=False)

    def __post_init__(self) -> None:
        self.tally = Tally(self.seed)

    def hunt(self) -> Tally:
        """Hunt until the budget is spent, the scenes are judged, or the user ends it."""
        with Interrupts() as interrupts:
            budget = Budget(self.seconds, interrupts)
            index = self.first
            while self.most is None or index < self.first + self.most:
                try:
                    budget.check()
                    self._judge(index, budget)
                except OutOfTime as ended:
                    self.tally.stopped = str(ended)
                    break
                self.tally.seconds = budget.spent
                self.watch(self.tally)
                index += 1
        return self.tally

    def _judge(self, index: int, budget: Budget) -> None:
        """Draw a scene, run it, and file each law that it breaks."""
        document = drawn(self.seed, index)
        self.tally.scenes += 1
        try:
            scene = scene_from_dict(document | {"expect": {"contact_audit": AUDIT}})
            laws = laws_of(scene)
            space = Space(scene, threads=1)
        except SceneError:
            self.tally.refused += 1
            return
        except PhysicsError:
            self.tally.stated += 1
            return
        seen = observe(space, budget, steps=STEPS)
        if seen is None:
            self.tally.given_up += 1
            return
        self.tally.stated += bool(seen.error)
        for law in laws:
            condition = law.broken()
            if condition.holds(seen):
                self._file(law, condition, index, scene, seen)

    def _file(self, law: Law, condition: Condition, index: int, scene: Scene, seen: Observation) -> None:
        """Shrink a scene that breaks a law, record it, and add it to the misses."""
        said = condition.said(seen)
        if any(miss.law == law.name for miss in self.tally.misses):
            self.tally.misses.append(Miss(law.name, index, said, None, len(seen.space.state)))
            return
        output_folder(self.folder)
        path = self.folder / f"{law.name.replace(' ', '-')}-{self.seed}-{index}.toml"
        bodies, small = len(seen.space.state), scene.toml
        try:
            result = Reducer(condition, min(LONGEST, SHARE * self.seconds)).reduce(scene)
            key = key_of(scene.toml, condition.text)
            how = command("hunt", "--seed", self.seed, "--from", index, "--scenes", 1)
            small = text_of(result, f"{law.name}: {law.says}", key, how)
            bodies, said = result.bodies, result.said
        except ExperimentError as error:
            said = f"{said} ({error})"
        write(path, small)
        _record(small, path)
        self.tally.misses.append(Miss(law.name, index, said, path, bodies))


def _record(text: str, path: Path) -> None:
    """Record the run of a reduced scene beside it, as far as it goes."""
    try:
        simulate(recording_space(scene_from_text(text, str(path)), threads=1), path.with_suffix(".rrd"), force=True)
    except Exception:  # the fault that was found may end the run anyhow
        path.with_suffix(".rrd").unlink(missing_ok=True)


def as_document(tally: Tally) -> dict[str, Any]:
    """Return a tally as JSON can hold it."""
    misses = [
        {"law": m.law, "scene": m.index, "said": m.said, "file": m.path and str(m.path), "bodies": m.bodies}
        for m in tally.misses
    ]
    numbers = {name: getattr(tally, name) for name in ("seed", "scenes", "refused", "stated", "given_up", "seconds")}
    return numbers | {"stopped": tally.stopped, "misses": misses}
