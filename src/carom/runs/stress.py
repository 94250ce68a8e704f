"""Runs the numerical extremes: scenes at the limits of arithmetic and method, each with its criteria."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from carom.errors import SceneError
from carom.physics.diagnostics.extremes import Extreme
from carom.runs.outcome import Verdict
from carom.runs.run import Outcome, Watcher, recording_space, simulate
from carom.scene.scene_file import EXTREMES, extreme_scenes
from carom.scene.schema import Scene
from carom.scene.wording import suggestion


@dataclass(frozen=True, slots=True)
class Trial:
    """An extreme scene and the result of its run."""

    name: str
    title: str  # of the scene
    outcome: Outcome | None  # None if the scene was refused before the run
    refusal: str = ""

    @property
    def met(self) -> bool:
        """Whether the run completed and met every criterion."""
        return self.outcome is not None and self.outcome.ok

    @property
    def status(self) -> str:
        """The outcome, in a word or two."""
        return self.outcome.status if self.outcome else "refused"

    @property
    def reason(self) -> str:
        """Why it did not complete or meet a criterion; empty if it met all."""
        return self.outcome.reason if self.outcome else self.refusal

    @property
    def verdicts(self) -> list[Verdict]:
        """Each criterion and its measured value."""
        return self.outcome.verdicts if self.outcome else []

    @property
    def worst(self) -> dict[str, Extreme]:
        """The worst times by missed criterion; for an incomplete run, its end."""
        extremes = {verdict.name: verdict.worst for verdict in self.verdicts if not verdict.met and verdict.worst}
        if self.outcome and self.status == "failed":
            extremes["the end"] = Extreme(self.outcome.sim_time, self.outcome.steps, self.outcome.sim_time)
        return extremes


def extremes(name: str | None = None) -> dict[str, Path]:
    """Return the scene files of all extremes by their short names, or of the one named.

    Raises
    ------
    SceneError
        If the name is unknown; the message names the most similar one.
    """
    known = {full.removeprefix(f"{EXTREMES}/"): path for full, path in extreme_scenes().items()}
    if name is None:
        return known
    short = name.removeprefix(f"{EXTREMES}/")
    if short in known:
        return {short: known[short]}
    raise SceneError(f"{name}: no extreme of that name; {suggestion(short, known)}")


def attempt(name: str, scene: Scene, folder: Path, *, watch: Watcher | None = None) -> Trial:
    """Run an extreme and record it, replacing an earlier recording.

    Parameters
    ----------
    name
        Short name, as in `extremes`, and name of the recording.
    folder
        Folder of the recording.
    watch
        Called about ten times a second with the progress of the run.

    Raises
    ------
    RecordingError
        If the recording cannot be written at all.
    """
    try:
        space = recording_space(scene)
    except SceneError as error:
        return Trial(name, scene.title, None, str(error))
    return Trial(name, scene.title, simulate(space, folder / f"{name}.rrd", force=True, watch=watch))
