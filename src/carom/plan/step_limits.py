"""Limits of the adaptive step of a scene, and wider ones for the coarse run of `carom explain`."""

from __future__ import annotations

import math
from dataclasses import dataclass

from carom.plan.auto import (
    FREE_CFL,
    STEP_GROWS_UP_TO,
    STEP_PER_BODY,
    auto_interval,
    cfl,
    held_dx,
    largest_step,
    pull_fraction,
    smallest_radius,
    smoothing,
    target_dx,
)
from carom.scene.schema import Scene

HELD_PART = 0.01  # of its own radius that a held body may move in a step: rolling about each other takes 600 a turn
WIDEST_HELD_PART = 0.1
WIDEST_HELD = 3.0  # times the step of held bodies
WIDEST_FALL = 0.5  # of the time of a fall through the smallest radius
WIDEST_PULL = 0.1  # of the time of a pair: an orbit of 90 steps


@dataclass(frozen=True, slots=True)
class StepLimits:
    """The limits by their keys; None if one does not apply."""

    max_dt: float  # s, infinite for no limit
    cfl: float | None
    target_dx: float | None  # m
    held_dx: float | None  # m, replaces ``target_dx`` for bodies that lasting contacts hold; None if it does not
    held_part: float  # of its own radius that such a body may move in a step
    pull_fraction: float | None
    smoothing: float


def step_limits(scene: Scene) -> StepLimits:
    """Return the limits that a scene asks for."""
    if scene.promise is not None:
        return accurate_limits(scene, scene.promise.refinement, scene.promise.until)
    return StepLimits(
        max_dt=largest_step(scene),
        cfl=cfl(scene),
        target_dx=target_dx(scene),
        held_dx=held_dx(scene),
        held_part=HELD_PART,
        pull_fraction=pull_fraction(scene),
        smoothing=smoothing(scene),
    )


def accurate_limits(scene: Scene, refinement: float, until: float) -> StepLimits:
    """Return limits for steps so many times shorter than the longest useful ones, with impacts at their own times.

    Every limit shrinks alike, so that runs with different refinements differ wherever the step matters. No step is
    longer than the interval between the frames of an automatic recording of ``until`` seconds, the part that was
    looked ahead. A resumed run may be longer, and keeps its step.
    """
    touches = cfl(scene) is not None
    return StepLimits(
        max_dt=min(largest_step(scene), auto_interval(scene, until)) / refinement,
        cfl=FREE_CFL / refinement if touches else None,
        target_dx=(WIDEST_FALL / refinement) ** 2 * smallest_radius(scene) if touches else None,
        held_dx=None,
        held_part=HELD_PART,
        pull_fraction=None if pull_fraction(scene) is None else WIDEST_PULL / refinement,
        smoothing=1.0,
    )


def wider_limits(scene: Scene, stride: float) -> StepLimits:
    """Return limits for steps up to ``stride`` times longer, as far as contacts are still found and orbits kept."""
    if scene.promise is not None:
        return accurate_limits(scene, scene.promise.refinement / stride, scene.promise.until)

    def wider(limit: float | None, widest: float) -> float | None:
        return None if limit is None else min(stride * limit, max(limit, widest))

    reach, fall = target_dx(scene), STEP_PER_BODY * STEP_GROWS_UP_TO * math.sqrt(smallest_radius(scene))
    rest = held_dx(scene)
    root = wider(None if reach is None else math.sqrt(reach), fall)
    return StepLimits(
        max_dt=stride * largest_step(scene),
        cfl=wider(cfl(scene), FREE_CFL),
        target_dx=None if root is None else root * root,
        held_dx=None if rest is None else min(stride, WIDEST_HELD) ** 2 * rest,
        held_part=min(stride * HELD_PART, WIDEST_HELD_PART),
        pull_fraction=wider(pull_fraction(scene), WIDEST_PULL),
        smoothing=1.0,
    )
