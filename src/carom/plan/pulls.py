"""What accelerates bodies between contacts."""

from __future__ import annotations

from carom.scene.forces import GRAVITY, UNIFORM_FIELD, ForceKind
from carom.scene.parts import Part
from carom.scene.schema import Scene


def part(kind: ForceKind, scene: Scene) -> Part:
    """Decide whether a force is modelled."""
    return Part(kind.name, *kind.decide(scene))


def gravity(scene: Scene) -> Part:
    """Decide whether bodies pull each other."""
    return part(GRAVITY, scene)


def field(scene: Scene) -> Part:
    """Decide whether a uniform field pulls."""
    return part(UNIFORM_FIELD, scene)
