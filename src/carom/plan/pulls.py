"""The forces that accelerate bodies between contacts."""

from __future__ import annotations

from carom.scene.forces import GRAVITY, ForceKind, kinds_of
from carom.scene.parts import Part
from carom.scene.schema import Scene


def part(kind: ForceKind, scene: Scene) -> Part:
    """Decide whether a force is modelled."""
    return Part(kind.name, *kind.decide(scene))


def gravity(scene: Scene) -> Part:
    """Decide whether bodies pull each other."""
    return part(GRAVITY, scene)


def differing(scene: Scene) -> str:
    """Name the first force that accelerates bodies at rest differently, so they may meet; empty if none does."""
    found = (kind.short_name for kind in kinds_of(scene) if kind.differs and part(kind, scene).modelled)
    return next(found, "")


def pushing(scene: Scene) -> str:
    """Name the first force that accelerates all bodies at rest alike; empty if none does."""
    return next((kind.short_name for kind in kinds_of(scene) if kind.pushes(scene)), "")


def damping(scene: Scene) -> Part | None:
    """Return the force that depends on velocities; None if there is none."""
    return next(iter(dampings(scene)), None)


def dampings(scene: Scene) -> list[Part]:
    """Return all forces that depend on velocities; `carom.plan.checks` refuses more than one."""
    found = (part(kind, scene) for kind in kinds_of(scene) if kind.damps)
    return [force for force in found if force.modelled]


def further(scene: Scene) -> str:
    """Name the first force of an installed package; empty if there is none. Other engines do not know them."""
    return next(iter(scene.forces.given), "")
