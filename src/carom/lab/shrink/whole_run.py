"""Conditions on a whole run, which no single frame shows: the verdict of a command, and replays that differ."""

from __future__ import annotations

import shlex
import subprocess
from dataclasses import dataclass, replace

from carom.errors import ExperimentError
from carom.lab.shrink.observation import Observation, said_by
from carom.physics.checkpoint import Checkpoint
from carom.physics.schedule import every
from carom.physics.space import Space
from carom.private_folder import temporary_folder
from carom.scene.schema import Scene

PLACE = "{}"  # in a command: where the path of the scene goes


@dataclass(frozen=True, slots=True)
class CommandShows:
    """A command that exits with 0 if a scene shows the failure."""

    text: str
    needs_impacts = False
    of_whole_run = True

    def check(self, seen: Observation) -> None:
        """Accept every run."""

    def pinned(self, seen: Observation) -> CommandShows:
        """Run the command twice, and refuse one that does not see the failure or changes its mind."""
        codes = [self._code(seen.space.scene) for _ in range(2)]
        if (codes[0] == 0) != (codes[1] == 0):
            raise ExperimentError(
                f"--while-command is flaky: of two runs on the same scene one exited with {codes[0]}, the other with "
                f"{codes[1]}; make it exit with the same code each time"
            )
        if codes[0] != 0:
            raise ExperimentError(
                f"nothing to shrink: the command exited with {codes[0]}; 0 means that the scene shows the failure"
            )
        return self

    def holds(self, seen: Observation) -> bool:
        """Tell whether the command exits with 0."""
        return self._code(seen.space.scene) == 0

    def said(self, seen: Observation) -> str:
        """Say that it does."""
        return "the command exits with 0"

    def bodies(self, seen: Observation) -> set[str]:
        """Return none: which bodies matter is not known."""
        return set()

    def _code(self, scene: Scene) -> int:
        with temporary_folder() as folder:
            path = folder / "scene.toml"
            path.write_text(scene.toml, encoding="utf-8")
            quoted = shlex.quote(str(path))
            line = self.text.replace(PLACE, quoted) if PLACE in self.text else f"{self.text} {quoted}"
            ran = subprocess.run(line, shell=True, check=False, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        return ran.returncode


@dataclass(frozen=True, slots=True)
class ReplayDiffers:
    """Two runs with different bits: on other threads, restored from a checkpoint, or by the other search."""

    text: str
    way: str = ""  # empty: any
    needs_impacts = False
    of_whole_run = True

    def check(self, seen: Observation) -> None:
        """Accept every run."""

    def pinned(self, seen: Observation) -> ReplayDiffers:
        """Return the condition that runs differ in the same way."""
        way = self._difference(seen)
        if not way:
            raise ExperimentError(
                "nothing to shrink: runs on two threads, from a checkpoint and by the other search have the same bits"
            )
        return replace(self, way=way)

    def holds(self, seen: Observation) -> bool:
        """Tell whether the runs differ."""
        way = self._difference(seen)
        return bool(way) and self.way in ("", way)

    def said(self, seen: Observation) -> str:
        """Say how they differ."""
        return f"a run {self.way} ends with other bits"

    def bodies(self, seen: Observation) -> set[str]:
        """Return none: which bodies matter is not known."""
        return set()

    def _difference(self, seen: Observation) -> str:
        """Say which run differs from the one that was seen; empty if none does."""
        scene, expected = seen.space.scene, _ending(seen.space, seen.error)
        other, middle = _run(Space(scene, threads=2), seen.space.step // 2)
        if other != expected:
            return "on two threads"
        if middle is None:
            return ""
        restored = Space(scene, threads=1)
        restored.restore(middle)
        if _run(restored)[0] != expected:
            return "from a checkpoint"
        search = "grid" if scene.contact.search == "k-d-tree" else "k-d-tree"
        contact = scene.contact.model_copy(update={"search": search})
        found = _run(Space(scene.model_copy(update={"contact": contact}), threads=1))[0]
        return "" if found == expected else "with the other contact.search"


def _ending(space: Space, error: str) -> tuple[int, int, str]:
    return space.step, space.fingerprint(), error


def _run(space: Space, middle: int = 0) -> tuple[tuple[int, int, str], Checkpoint | None]:
    """Run a space to its end; return how it ended, and the state after a step."""
    kept = None
    try:
        for frame in space.run(schedule=every(0.0)):
            if frame.step == middle and middle > 0:
                kept = frame.checkpoint
    except Exception as error:
        return _ending(space, said_by(error)), None
    return _ending(space, ""), kept
