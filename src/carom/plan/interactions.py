"""The forces that accelerate bodies between contacts, and the parts of the contact model that a scene requires.

`forced_parts` are the parts that ``model.force`` switches on.
"""

from __future__ import annotations

import math

from carom.plan.once_a_scene import once_a_scene
from carom.scene.contact_laws import exerts_torque, functions_of
from carom.scene.forces import GRAVITY, ForceKind, kinds_of
from carom.scene.load import Scene
from carom.scene.matter import KindOfContact, kinds_of_contacts, mean_volume
from carom.scene.parts import Part
from carom.scene.wall_shapes import shape_called
from carom.scene.wording import counted, in_series

DENSE = 0.5  # packing fraction above which contacts in a flow last; hard spheres begin to freeze at 0.494


def part(kind: ForceKind, scene: Scene) -> Part:
    """Decide whether a force is modelled."""
    return Part(kind.name, *kind.decide(scene))


def gravity(scene: Scene) -> Part:
    """Decide whether bodies attract each other."""
    return part(GRAVITY, scene)


def differing(scene: Scene) -> str:
    """Return the first force that gives bodies at rest different accelerations; empty if there is none."""
    return next((kind.short_name for kind in kinds_of(scene) if kind.differs and part(kind, scene).modelled), "")


def pushing(scene: Scene) -> str:
    """Return the first force that gives all bodies at rest the same acceleration; empty if there is none."""
    return next((kind.short_name for kind in kinds_of(scene) if kind.pushes(scene)), "")


def damping(scene: Scene) -> Part | None:
    """Return the force that depends on velocities; None if there is none."""
    return next(iter(dampings(scene)), None)


def dampings(scene: Scene) -> list[Part]:
    """Return all forces that depend on velocities; `carom.plan.checks` refuses more than one."""
    forces = (part(kind, scene) for kind in kinds_of(scene) if kind.damps)
    return [force for force in forces if force.modelled]


def further(scene: Scene) -> str:
    """Return the first force of an installed package, which other engines lack; empty if there is none."""
    return next(iter(scene.forces.given), "")


@once_a_scene
def contact(scene: Scene) -> Part:
    """Decide whether anything can touch."""
    name = "contact"
    if not scene.contact.enabled:
        return Part(name, False, "contact.enabled = false")
    if scene.admits:
        return Part(name, True, "bodies enter, and may touch other bodies")
    walls = len(scene.wall) + 2 * len(scene.domain.walled)
    solids = [counted(count, noun) for count, noun in ((len(scene.plane), "plane"), (walls, "wall")) if count]
    if scene.count == 1 and not solids:
        return Part(name, False, "a single body has nothing to touch")
    if not differing(scene) and not moves_relatively(scene):
        return Part(name, False, "all bodies move in the same way and no force attracts them: distances never change")
    if solids:
        return Part(name, True, f"{in_series([counted(scene.count, 'body'), *solids])} may collide")
    return Part(name, True, f"{scene.count} bodies may collide")


def moves_relatively(scene: Scene) -> bool:
    """Return whether two bodies may move relative to each other without forces: velocities differ, or bodies overlap.

    A uniform field or a moving medium moves free bodies relative to planes, walls and fixed bodies.
    """
    if scene.translating or scene.domain.shear:  # groups move with the flow
        return True
    velocities: set[tuple[float, ...] | None] = {body.velocity for body in scene.body}
    velocities |= {columns.common_velocity for columns in scene.data} | {group.velocity.mean for group in scene.group}
    if None in velocities:  # the velocities in a file differ
        return True
    if scene.anchored:
        velocities.add((0.0, 0.0, 0.0))
        if pushing(scene):
            return True
    stirred = any(group.velocity.dispersion > 0 or any(group.bulk_rotation) for group in scene.group)
    return len(velocities) > 1 or stirred or scene.contact.allow_overlap


def where_bodies_meet(name: str, contact: Part, why: str) -> Part:
    """Decide on a part that every model with contacts has."""
    return Part(name, contact.modelled, why if contact.modelled else "no contact is possible")


def stabilisation(scene: Scene, contact: Part) -> Part:
    """Decide whether overlaps are corrected."""
    how = scene.contact.stabilisation
    if contact.modelled and how == "none":
        return Part("stabilisation", False, 'contact.stabilisation = "none"')
    if contact.modelled and scene.domain.shear and not flow_presses(scene):
        return Part("stabilisation", False, "domain.shear: every contact is an impact at its own time")
    return where_bodies_meet("stabilisation", contact, f"{how}: overlaps are corrected")


def load(scene: Scene) -> str:
    """Return the force that presses contacts together; empty if there is none, so that every contact is an impact."""
    if force := differing(scene):
        return force
    if scene.anchored and (field := pushing(scene)):
        return f"the {field}"
    if flow_presses(scene):
        return "the shear"
    if scene.has_piston:
        return "the piston"
    return pressing_wall(scene) or ("what enters" if scene.admits else "")


def pressing_wall(scene: Scene) -> str:
    """Return the kind of wall that presses without any other force; empty if there is none.

    A body that moves along a curved wall at speed v is pressed against the wall by m v²/f, where f is the radius of
    curvature. On such a wall, and on a wall that accelerates, bounces that dissipate come to an end. Elastic bounces
    never end; each is an impact.
    """
    kinds = kinds_of_contacts(scene)
    if "restitution" not in functions_of(scene.contact.laws) and all(e.coefficients.restitution == 1 for e in kinds):
        return ""
    if any(not shape_called(wall.shape).flat for wall in scene.wall):
        return "a curved wall"
    return (
        "a wall that accelerates"
        if any(wall.motion and any(wall.motion.amplitude) for wall in scene.translating)
        else ""
    )


def flow_presses(scene: Scene) -> bool:
    """Return whether contacts in a sheared box may last, which requires impacts resolved at the end of a step.

    "auto" resolves the impacts of a gas at their own times. A packing has too many impacts for exact times: 150 rough
    spheres at a packing fraction of 0.55 would take 40 times as long, and at 0.58 a single step may take a minute.
    """
    if scene.domain.shear is None:
        return False
    if scene.contact.timing != "auto":
        return scene.contact.timing == "end-of-step"
    cubes = sum(body.radius**3 for body in scene.body)
    cubes += sum(float((columns.radius**3).sum()) for columns in scene.data)
    volume = 4.0 / 3.0 * math.pi * cubes + sum(mean_volume(group) * group.count for group in scene.group)
    return volume / math.prod(scene.domain.size or (math.inf,)) > DENSE


def resting(scene: Scene, contact: Part) -> Part:
    """Decide whether contacts can be at rest."""
    name, pressing = "resting-contacts", load(scene)
    if contact.modelled and not pressing:
        return Part(name, False, "no force presses contacts together: every contact is an impact")
    how = "warm-started impulses" if scene.contact.solver == "lasting" else "impulses from 0 in each step"
    return where_bodies_meet(name, contact, f"{pressing} presses: {how}")


def restitution(scene: Scene, contact: Part) -> Part:
    """Decide whether anything bounces."""
    name, kinds = "restitution", kinds_of_contacts(scene)
    if "restitution" in functions_of(scene.contact.laws):
        return where_bodies_meet(name, contact, scene.contact.law_key)
    if contact.modelled and all(kind.coefficients.restitution == 0 for kind in kinds):
        return Part(name, False, "every coefficient is 0: no bounces")
    return where_bodies_meet(name, contact, f"e = {_range(kinds, 'restitution')}")


def friction(scene: Scene, contact: Part) -> Part:
    """Decide whether contacts resist sliding."""
    name, kinds = "friction", kinds_of_contacts(scene)
    if contact.modelled and exerts_torque(scene.contact.laws):
        return Part(name, True, f"{scene.contact.law_key} resists rolling")
    if contact.modelled and all(kind.coefficients.static_friction == 0 for kind in kinds):
        return Part(name, False, "both coefficients are 0")
    why = f"μs = {_range(kinds, 'static_friction')}, μk = {_range(kinds, 'kinetic_friction')}"
    return where_bodies_meet(name, contact, why)


def _range(kinds: list[KindOfContact], coefficient: str) -> str:
    """Return the common value of a coefficient in all kinds of contacts, or its range, as text."""
    values = [getattr(kind.coefficients, coefficient) for kind in kinds]
    return f"{min(values):g}" if min(values) == max(values) else f"{min(values):g} to {max(values):g}"


def torque(friction: Part) -> Part:
    """Decide whether contacts exert torques."""
    if friction.modelled:
        return Part("torque", True, "friction turns bodies")
    return Part("torque", False, "the normal force acts on the centre")


# The parts that a forced part needs in order to work. Other consequences, such as torques from friction, are decided as
# for any scene.
_NEEDS = {
    "potential": ("gravity",),
    "tree": ("gravity",),
    "broad-phase": ("contact",),
    "narrow-phase": ("contact",),
    "time-of-impact": ("contact",),
    "colouring": ("contact",),
    "stabilisation": ("contact",),
    "resting-contacts": ("contact",),
    "restitution": ("contact",),
    "friction": ("contact",),
    "torque": ("contact", "spin"),
    "orientation": ("spin",),
}


def forced_parts(scene: Scene) -> dict[str, str]:
    """Return the forced parts, each with the entry of ``model.force`` that causes it."""
    forced = {name: name for name in scene.model.force}
    for name in scene.model.force:
        for needed in _NEEDS.get(name, ()):
            forced.setdefault(needed, name)
    return forced
