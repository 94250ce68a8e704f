"""What a run will cost, from a few of its steps: time, memory, bytes."""

from __future__ import annotations

import time
from dataclasses import dataclass

from carom.physics.space import Space
from carom.scene.limits import memory_estimate
from carom.scene.requirements import BYTES_PER_BODY_AND_FRAME, frame_interval
from carom.scene.schema import Scene

TRIAL_SECONDS = 1.0
TRIAL_STEPS = 200


@dataclass(frozen=True, slots=True)
class Estimate:
    """Cost of a run, at the pace of its first steps: a collapse takes more steps later on."""

    steps: int
    seconds: float
    memory: int  # bytes, without the interpreter
    frames: int
    size: int  # bytes of the recording
    shares: dict[str, float]  # part of the step -> part of its time


def estimate(scene: Scene) -> Estimate:
    """Run the first steps of a scene for about a second and extrapolate."""
    space = Space(scene)
    began = time.perf_counter()
    while space.time < scene.time.duration and space.step < TRIAL_STEPS:
        space.compute_dynamics(space.step + 1)
        if time.perf_counter() - began > TRIAL_SECONDS:
            break
    spent = time.perf_counter() - began
    steps = max(space.step, round(space.step * scene.time.duration / space.time))
    interval = frame_interval(scene)
    frames = 1 + (steps if interval == 0.0 else min(steps, round(scene.time.duration / interval)))
    profile = space.profile.seconds()
    whole = sum(profile.values())
    return Estimate(
        steps=steps,
        seconds=spent / space.step * steps,
        memory=memory_estimate(scene),
        frames=frames,
        size=frames * scene.count * BYTES_PER_BODY_AND_FRAME,
        shares={part: seconds / whole for part, seconds in profile.items()},
    )
