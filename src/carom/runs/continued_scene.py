"""The scene of a run that goes on from a checkpoint of another one."""

from __future__ import annotations

from carom.plan.auto import frame_interval, integrator
from carom.recording.read.recorded_scene import recorded_scene
from carom.recording.read.recording import Recording
from carom.scene.integrators import AUTO
from carom.scene.schema import Scene
from carom.scene.units.dimension import TIME


def continued_scene(recording: Recording, scene: Scene, overrides: list[str]) -> Scene:
    """Return the ``scene`` of a recording with overrides, for a run that goes on from one of its checkpoints.

    Some values of "auto" follow from the duration: the interval between frames, and the integrator of orbits. They stay
    as they were, unless the overrides set them.

    Raises
    ------
    SceneError, RecordingError
        As `recorded_scene`, or if an override contradicts the integrator.
    """
    changed = recorded_scene(recording, overrides)
    interval, chosen, kept = frame_interval(scene), integrator(scene).name, list(overrides)
    if changed.record.every == "auto" and frame_interval(changed) != interval:
        kept.append(f"record.every={scene.unit_system.literal(interval, TIME)}")
    if changed.time.integrator == AUTO and integrator(changed).name != chosen:
        kept.append(f"time.integrator={chosen}")
    return recorded_scene(recording, kept) if len(kept) > len(overrides) else changed
