"""The forces that accelerate bodies between contacts."""

from __future__ import annotations

from carom.scene.forces import GRAVITY, ForceKind, kinds_of
from carom.scene.parts import Part
from carom.scene.schema import Scene


def part(kind: ForceKind, scene: Scene) -> Part:
    """Decide whether a force is modelled."""
    return Part(kind.name, *kind.decide(scene))


def gravity(scene: Scene) -> Part:
    """Decide whether bodies attract each other."""
    return part(GRAVITY, scene)


def differing(scene: Scene) -> str:
    """Return the first force that accelerates bodies at rest differently; empty if there is none."""
    found = (kind.short_name for kind in kinds_of(scene) if kind.differs and part(kind, scene).modelled)
    return next(found, "")


def pushing(scene: Scene) -> str:
    """Return the first force that gives all bodies at rest the same acceleration; empty if there is none."""
    return next((kind.short_name for kind in kinds_of(scene) if kind.pushes(scene)), "")


def damping(scene: Scene) -> Part | None:
    """Return the force that depends on velocities; None if there is none."""
    return next(iter(dampings(scene)), None)


def dampings(scene: Scene) -> list[Part]:
    """Return all forces that depend on velocities; `carom.plan.checks` refuses more than one."""
    found = (part(kind, scene) for kind in kinds_of(scene) if kind.damps)
    return [force for force in found if force.modelled]


def further(scene: Scene) -> str:
    """Return the first force of an installed package, which other engines lack; empty if there is none."""
    return next(iter(scene.forces.given), "")
