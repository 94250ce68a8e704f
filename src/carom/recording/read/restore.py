"""Restores a space from a recording, for replays and resumed runs.

A recording may come from a stranger, so everything in it is checked before it is used.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from carom.errors import PhysicsError, RecordingError, SceneError
from carom.physics.checkpoint import Checkpoint
from carom.physics.space import Space
from carom.recording.read.recording import Recording
from carom.recording.schema.header import scene_digest
from carom.scene.data.body_sources import SourcedBodies, Wanted
from carom.scene.load import longest_text, scene_from_text
from carom.scene.schema import Scene
from carom.scene.start import InitialBodies


def recorded_scene(recording: Recording, overrides: list[str] | None = None) -> Scene:
    """Return the scene of a recording.

    Raises
    ------
    SceneError
        If this version cannot read it.
    RecordingError
        If it was recorded from another engine, or the scene has another number of bodies than the recording.
    """
    if recording.engine:
        raise RecordingError(
            f"{recording.path} was recorded from {recording.engine}: carom has its states, and cannot run it again"
        )
    if recording.is_partial:
        raise RecordingError(
            f"{recording.path} is a clip of {len(recording.shown)} of {recording.info['bodies']} bodies without exact "
            "states: it cannot be run again; the recording that it was cut from can"
        )
    text, bodies = recording.scene_toml, len(recording.bodies.mass)
    if len(text) > longest_text(bodies):
        raise RecordingError(
            f"{recording.path} has a scene of {len(text)} characters for {bodies} bodies: it is damaged"
        )
    stated = recording.info.get("scene_sha256")
    if stated is not None and stated != scene_digest(text):
        raise RecordingError(
            f"{recording.path}: its scene is not the one that was recorded, since the SHA-256 differs; "
            "the file was altered and cannot be run again"
        )
    source = f"the scene in {recording.path}"
    scene = scene_from_text(text, source, bodies=RecordedBodies(recording))
    if overrides:
        scene = scene_from_text(text, source, overrides, scene.held)
    if scene.count != len(recording.bodies.mass):
        raise RecordingError(
            f"{recording.path} has {len(recording.bodies.mass)} bodies, but its scene has {scene.count}: it is damaged"
        )
    return scene


class RecordedBodies:
    """Finds the bodies of [[bodies]] in a recording."""

    def __init__(self, recording: Recording) -> None:
        self._recording = recording

    def find(self, wanted: Wanted) -> SourcedBodies:
        """Return the bodies of a section; see `BodySource`."""
        section = wanted.section
        if self._recording.is_partial:
            raise SceneError("its bodies are not in this clip")
        if section.count is None or section.sha256 is None:
            raise SceneError("its count and sha256 are missing: the recording is damaged")
        place = range(wanted.first, wanted.first + section.count)
        notes = tuple(self._recording.data_notes(wanted.index))
        return SourcedBodies(self._recording.given_bodies(wanted.index, wanted.row, place), section.sha256, notes=notes)


def space_of(
    recording: Recording,
    scene: Scene,
    checkpoint: Checkpoint,
    threads: int | None = None,
    continued: bool = True,
    record_contacts: bool = False,
) -> Space:
    """Build a space in the state of a checkpoint.

    Bodies are those recorded, not placed anew: random numbers may differ between libraries.

    Parameters
    ----------
    continued
        Whether the run goes on as it was recorded; otherwise the bodies of the checkpoint start another run. At the
        start of a run a space already has what a checkpoint restores, and the contacts of frame 0.
    record_contacts
        Whether frames carry what contacts did.

    Raises
    ------
    SceneError
        If the scene cannot run on this machine or in this version.
    RecordingError
        If the bodies in it cannot be simulated.
    """
    try:
        space = Space(scene, threads, start_of(recording, scene, checkpoint), record_contacts=record_contacts)
        needs, kept = space.requirements, (checkpoint.angular_velocity is not None, checkpoint.orientation is not None)
        if (needs.spin.modelled, needs.orientation.modelled) != kept:
            raise RecordingError(f"{recording.path}: its scene and its checkpoints do not agree on whether bodies spin")
        if continued and checkpoint.step > 0:
            space.restore(checkpoint)
        elif continued:
            space.begin_as(checkpoint)
    except PhysicsError as error:
        raise RecordingError(f"{recording.path} cannot be resumed from step {checkpoint.step}: {error}") from None
    return space


def checkpoint_before(recording: Recording, time: float) -> Checkpoint:
    """Return the last checkpoint at or before a time, otherwise the first one.

    Raises
    ------
    RecordingError
        If there is none.
    """
    times = recording.checkpoint_times
    if not times:
        raise RecordingError(f"{recording.path} has no checkpoint to start from: {recording.outcome}")
    earlier = [step for step, at in times.items() if at <= time]
    return recording.checkpoint(earlier[-1] if earlier else next(iter(times)))


def start_of(recording: Recording, scene: Scene, checkpoint: Checkpoint) -> InitialBodies:
    """Return the recorded bodies in the state of a checkpoint."""
    bodies, n = recording.bodies, scene.count
    spin = checkpoint.angular_velocity
    return InitialBodies(
        name=bodies.name,
        group=bodies.group,
        position=checkpoint.position,
        velocity=checkpoint.velocity,
        angular_velocity=np.zeros((n, 3)) if spin is None else spin,
        mass=bodies.mass,
        radius=bodies.radius,
        inertia=bodies.inertia,
        fixed=fixed_of(scene),
    )


def fixed_of(scene: Scene) -> NDArray[np.bool_]:
    """Return (n,) which bodies of a scene are fixed; those of groups are not."""
    given = [np.array([body.fixed for body in scene.body], dtype=bool), *(columns.fixed for columns in scene.data)]
    fixed = np.concatenate(given)
    return np.pad(fixed, (0, scene.count - len(fixed)))
