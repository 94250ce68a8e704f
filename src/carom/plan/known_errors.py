"""Errors of a run that are known before it starts: sentences on impacts, bounces and orbits with the scene's steps."""

from __future__ import annotations

import math

from carom.plan import interactions
from carom.plan.auto import (
    BOUNCES_UP_TO,
    TREE_FROM,
    cfl,
    integrator,
    largest_speed,
    largest_step,
    pull_fraction,
    smallest_radius,
    step_limits,
    target_dx,
    why_late,
)
from carom.plan.hierarchy import revolutions
from carom.scene.forces import MOST_RELAXATIONS
from carom.scene.load import Scene
from carom.scene.matter import body_mass, made_of, mean_mass
from carom.scene.rest_speed import PER_STEP
from carom.scene.units.dimension import TIME, VELOCITY

EXACT_IMPACT = 1e-9  # largest relative error of the approach speed if an impact counts as exact
LAGGING = 1e-3  # rad, largest lag of an orbit that is not worth a note


def inexact_impacts(scene: Scene) -> str:
    """Describe the error of an impact between two bodies that touch nothing else; empty if it is exact.

    The impulse follows exactly from the approach speed, but a force that varies within the step changes this speed.
    With self-gravity, the relative error is about a dt²/r, below rounding for small and fast bodies.
    """
    chosen = integrator(scene)
    if not interactions.contact(scene).modelled or chosen.ends_steps_at_impacts or scene.time.accuracy is not None:
        return ""
    if why_late(scene):
        return f"impacts are detected up to a step late, with an overlap: {why_late(scene)}"
    second_order = "approach speeds of impacts are accurate to second order in the step"
    if force := interactions.further(scene):
        return f"{force} changes during a step: {second_order}"
    if scene.domain.boundary == "periodic" and scene.anchored and interactions.pushing(scene):
        return f"paths are straight within a step in a periodic box: with fixed bodies, {second_order}"
    if scene.drag and (scene.time.fixed_dt or largest_step(scene)) > MOST_RELAXATIONS * scene.drag.relaxation_time:
        longest = scene.unit_system.text(MOST_RELAXATIONS * scene.drag.relaxation_time, TIME, "g")
        return (
            f"steps may exceed {MOST_RELAXATIONS:g} relaxation times of the drag, and impacts in such steps are "
            f"accurate only to first order; set time.max_dt = {longest} for exact impacts"
        )
    if not interactions.gravity(scene).modelled:
        return ""
    error = _error_by_gravity(scene)
    if error <= EXACT_IMPACT:
        return ""
    keeps = "; time.accuracy keeps the error smaller" if scene.count <= BOUNCES_UP_TO else ""
    return f"self-gravity changes during a step: approach speeds of impacts err by up to about {error:.0e}{keeps}"


def inexact_orbits(scene: Scene) -> str:
    """Describe the lag at the end of orbits about a dominant body; empty if the lag is small or unknown.

    With leapfrog, the angle of a circular orbit with angular velocity ω lags by the fraction (ω dt)²/3
    (docs/physics.md).
    """
    if integrator(scene).name != "leapfrog" or scene.time.accuracy is not None or scene.count > TREE_FROM:
        return ""
    turns, fraction = revolutions(scene), pull_fraction(scene)
    if not turns > 0.0:
        return ""
    turn = 2.0 * math.pi * turns / scene.time.duration * (scene.time.fixed_dt or largest_step(scene))  # rad in a step
    if fraction is not None and scene.time.fixed_dt is None:
        # this limit of the step uses the mean mass, here the dominant mass divided by the number of bodies
        turn = min(turn, fraction / scene.count**0.25)
    lag = 2.0 * math.pi * turns * turn * turn / 3.0
    if not LAGGING < lag < math.inf:
        return ""
    return (
        f"orbits lag: leapfrog delays the innermost body by about {lag:.1g} rad in {turns:.3g} revolutions, and more "
        "on eccentric orbits; the lag falls with the square of the step"
    )


def ended_bounces(scene: Scene) -> str:
    """Return a sentence about bounces that become resting contacts; empty if there are none."""
    contact = interactions.contact(scene)
    bounces = interactions.restitution(scene, contact).modelled and not integrator(scene).ends_steps_at_impacts
    if not (bounces and interactions.resting(scene, contact).modelled):
        return ""
    field, limit = math.hypot(*scene.gravity.uniform), ""
    if field > 0.0:
        limits = step_limits(scene)
        reach = max(limits.target_dx or 0.0, limits.held_dx or 0.0)
        longest = scene.time.fixed_dt or min(limits.max_dt, math.sqrt(2.0 * reach / field) if reach else math.inf)
        limit = f", here at most {scene.unit_system.text(PER_STEP * field * longest, VELOCITY, '.2g')}"
    return (
        "bounces shorter than about one step end at rest: bodies that are pressed together rebound only if they "
        f"approach faster than {PER_STEP:g} × the pressing acceleration × the step{limit}"
    )


def _error_by_gravity(scene: Scene) -> float:
    """Estimate the relative error of an approach speed that self-gravity causes in a step.

    The acceleration a at a contact is at most G M / r², with M twice the largest mass. The velocity limit allows a step
    of at most κ r/v, where κ is `cfl`. The acceleration limit allows a step in which a body falls by at most Δx from
    rest.
    """
    r, slowest = smallest_radius(scene), largest_speed(scene)
    # mass of each body, and mean mass of each group
    masses = [body_mass(made_of(scene, body)) for body in scene.body]
    masses += [mean_mass(made_of(scene, group)) for group in scene.group]
    a = 2.0 * scene.gravity.constant * max(masses + [float(columns.mass.max()) for columns in scene.data]) / (r * r)
    by_fall = 2.0 * (target_dx(scene) or math.inf) / r  # a dt² / r
    by_speed = (cfl(scene) or math.inf) ** 2 * a * r / slowest**2 if slowest > 0.0 else math.inf
    step = scene.time.fixed_dt or largest_step(scene)
    return min(by_fall, by_speed, a * step * step / r)
