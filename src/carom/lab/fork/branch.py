"""`Branch`: a recording to fork, the moment, and the parameters from there on."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from carom.errors import ExperimentError, RecordingError
from carom.physics.checkpoint import Checkpoint
from carom.physics.space import Space
from carom.plan.auto import integrator
from carom.plan.features import require
from carom.recording.read.moment import tolerance
from carom.recording.read.recorded_scene import recorded_scene
from carom.recording.read.recording import Recording
from carom.runs.continued_scene import continued_scene
from carom.runs.window import checkpoint_before, space_of
from carom.scene.schema import Scene
from carom.scene.units.dimension import TIME

_BODIES = ("body", "bodies", "group", "seed", "units", "title", "description")
_STATE = {"domain": "the places of the bodies belong to it", "sweep": "one fork is one run"}


@dataclass(frozen=True, slots=True)
class Branch:
    """What a worker needs to go on from a moment of a recording."""

    path: Path
    at: float  # s
    overrides: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Start:
    """The state at which a branch begins, and the scene from there on."""

    recording: Recording
    scene: Scene
    checkpoint: Checkpoint

    def space(self, threads: int | None = None, shift: int | None = None, ulps: int = 1) -> Space:
        """Build a space at the fork.

        Parameters
        ----------
        threads
            For the kernels.
        shift
            Seed of a perturbation that moves each coordinate of each position by ``ulps`` units in the last place, up
            or down; None moves nothing.
        ulps
            Number of units.
        """
        checkpoint = self.checkpoint if shift is None else _shifted(self.checkpoint, shift, ulps)
        records = self.recording.records_contacts
        space = space_of(self.recording, self.scene, checkpoint, threads, False, records)
        begun = space.frame().checkpoint  # what the forces of the new parameters are in this state
        space.restore(
            replace(checkpoint, acceleration=begun.acceleration, energy=begun.energy, books=begun.books)
            if checkpoint.step
            else begun
        )
        return space


def start_of(branch: Branch) -> Start:
    """Return the state at the end of the step that the moment of a branch is in.

    Raises
    ------
    RecordingError, SceneError, ExperimentError
        If the recording cannot be run again, or an override changes what a checkpoint holds.
    """
    recording = Recording.open(branch.path)
    recording.refuse_overlay()
    recording.refuse_some_bodies()
    original = recorded_scene(recording)
    _refuse_state(branch.overrides)
    scene = continued_scene(recording, original, list(branch.overrides)) if branch.overrides else original
    checkpoint = _checkpoint_at(recording, original, recording.moment(branch.at))
    _refuse_other_state(branch, original, scene)
    end, units = scene.time.duration, scene.unit_system
    if checkpoint.time >= end:
        raise ExperimentError(
            f"the run ends at {units.text(end, TIME, 'g')}: a fork at t = {units.text(checkpoint.time, TIME, '.9g')} "
            "has nothing to go on to; give an earlier --at, or a later end with --set time.duration=…"
        )
    return Start(recording, scene, checkpoint)


def _checkpoint_at(recording: Recording, scene: Scene, time: float) -> Checkpoint:
    """Run the steps from the last checkpoint before a time (s) again, up to the step that it is in."""
    checkpoint = checkpoint_before(recording, time)
    goal = time - tolerance(time)
    if checkpoint.time >= goal:
        return checkpoint
    space = space_of(recording, scene, checkpoint, record_contacts=recording.records_contacts)
    for frame in space.run(schedule=lambda step, before, now: now >= goal):
        if frame.time >= goal:
            return frame.checkpoint
    raise RecordingError(
        f"{recording.path} ends before {scene.unit_system.text(time, TIME, '.9g')} when it is run again"
    )


def _refuse_state(overrides: tuple[str, ...]) -> None:
    """Refuse overrides of keys that only say how the run began, or in what it lives."""
    for override in overrides:
        key = override.partition("=")[0].strip()
        section = key.partition(".")[0]
        if section in _BODIES:
            raise ExperimentError(
                f"--set {override}: a fork keeps the bodies of the checkpoint, so {key} has no effect on it; "
                "change parameters of forces, contacts or steps, or run the scene anew"
            )
        if section in _STATE:
            raise ExperimentError(f"--set {override}: {key} cannot change in the middle of a run: {_STATE[section]}")


def _refuse_other_state(branch: Branch, original: Scene, scene: Scene) -> None:
    """Refuse overrides that change which arrays a checkpoint holds."""
    before, after = require(original), require(scene)
    changes = {
        "whether bodies spin": (before.spin.modelled, after.spin.modelled),
        "whether bodies have orientations": (before.orientation.modelled, after.orientation.modelled),
        "whether bodies can touch": (before.contact.modelled, after.contact.modelled),
        "the solver of resting contacts": (original.contact.solver, scene.contact.solver),
        "the integrator": (integrator(original).name, integrator(scene).name),
        "the number of planes": (len(original.plane), len(scene.plane)),
    }
    for what, (one, other) in changes.items():
        if one != other:
            raise ExperimentError(
                f"--set {' --set '.join(branch.overrides)}: this changes {what}, which a checkpoint depends on; "
                "run the scene anew with `carom run`"
            )


def _shifted(checkpoint: Checkpoint, seed: int, ulps: int) -> Checkpoint:
    """Move each coordinate by some units in the last place, up or down."""
    rng = np.random.default_rng(seed)
    up = rng.integers(0, 2, checkpoint.position.shape).astype(bool)
    position = checkpoint.position
    for _ in range(ulps):
        position = np.where(up, np.nextafter(position, np.inf), np.nextafter(position, -np.inf))
    return replace(checkpoint, position=np.ascontiguousarray(position))
