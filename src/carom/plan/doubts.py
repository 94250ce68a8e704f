"""Sentences about a scene that runs, but may not be what its author meant."""

from __future__ import annotations

import math

from carom.plan.pulls import dampings, differing, pushing
from carom.scene.counted import counted
from carom.scene.names import body_key
from carom.scene.schema import Scene
from carom.scene.units.dimension import ACCELERATION, DENSITY, LENGTH

EARTH = 9.81  # m/s², written as 9.8 to 9.82
LIGHTEST = 100.0  # kg/m³; balls of cork have 200


def doubts(scene: Scene) -> list[str]:
    """Return what may be a mistake in a scene, a sentence each."""
    return [*_nothing_moves(scene), *_field_of_the_earth(scene), *_default_radius(scene)]


def _nothing_moves(scene: Scene) -> list[str]:
    """Say so if no force acts and every velocity is 0."""
    if differing(scene) or pushing(scene) or dampings(scene) or scene.contact.allow_overlap:
        return []
    moving = any(any(body.velocity) or any(body.angular_velocity) for body in scene.body)
    for columns in scene.data:
        moving |= bool(columns.velocity.any() or columns.angular_velocity.any())
    for group in scene.group:
        moving |= any(group.velocity.mean) or group.velocity.dispersion > 0.0
        moving |= group.spin.dispersion > 0.0 or any(group.bulk_rotation)
    return [] if moving else ["nothing can move: no force acts, and every velocity is 0"]


def _field_of_the_earth(scene: Scene) -> list[str]:
    """Ask for the unit of a uniform field that has the Earth's number, but not its size."""
    size = math.hypot(*scene.gravity.uniform)
    number = scene.unit_system.shown(size, ACCELERATION)
    if round(number, 1) != round(EARTH, 1) or math.isclose(size, EARTH, rel_tol=0.01):
        return []
    text = scene.unit_system.text(size, ACCELERATION, ".3g")
    return [f'gravity.uniform has {text}, {size / EARTH:.2g} of the Earth\'s; if that is meant, write "{EARTH} m/s^2"']


def _default_radius(scene: Scene) -> list[str]:
    """Name the first body whose mass is given, but whose radius is the default and makes it lighter than any solid."""
    light = [
        (number, density)
        for number, body in enumerate(scene.body)
        if "radius" not in body.model_fields_set and body.mass  # test particles have none
        if (density := body.mass / (4.0 / 3.0 * math.pi * body.radius**3)) < LIGHTEST
    ]
    if not light:
        return []
    number, density = light[0]
    units = scene.unit_system
    more = f"; the same holds for {counted(len(light) - 1, 'more body')}" if len(light) > 1 else ""
    return [
        f"{body_key(number, scene.body[number].name)} has no radius and gets the default, "
        f"{units.text(scene.body[number].radius, LENGTH, 'g')}: with its mass, the density is "
        f"{units.text(density, DENSITY, '.2g')}{more}"
    ]
