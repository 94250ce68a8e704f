"""The forces that accelerate bodies between contacts, and the parts of the contact model that a scene needs.

`forced_parts` are the parts that ``model.force`` switches on. Orbits about a dominant body, and the distances between
bodies at the start, decide whether a scene is a hierarchy.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from carom.scene.contact_laws import exerts_torque, functions_of
from carom.scene.forces import GRAVITY, ForceKind, kinds_of
from carom.scene.matter import KindOfContact, body_mass, kinds_of_contacts, made_of, mean_mass, mean_volume
from carom.scene.parts import Part
from carom.scene.schema import Scene
from carom.scene.units.dimension import LENGTH
from carom.scene.wording import body_called, counted, in_series

DENSE = 0.5  # packing fraction above which contacts in a flow last; hard spheres begin to freeze at 0.494


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


def contact(scene: Scene) -> Part:
    """Decide whether anything can touch."""
    name = "contact"
    if not scene.contact.enabled:
        return Part(name, False, "contact.enabled = false")
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
    """Return whether two bodies start with different velocities or overlap, and so may move apart or together.

    A uniform field or a moving medium moves bodies relative to planes, walls and fixed bodies, which it does not move.
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
    """Decide on a part that is modelled wherever contacts are."""
    return Part(name, contact.modelled, why if contact.modelled else "no contact is possible")


def broad_phase(scene: Scene, contact: Part) -> Part:
    """Decide whether to search for pairs that may touch."""
    how = "k-d tree" if scene.contact.search == "k-d-tree" else "hierarchical grid"
    return where_bodies_meet("broad-phase", contact, f"one {how} for each octave of radius")


def narrow_phase(contact: Part) -> Part:
    """Decide whether distances of pairs are computed."""
    return where_bodies_meet("narrow-phase", contact, "the distance of each pair that may touch")


def colouring(scene: Scene, contact: Part) -> Part:
    """Decide whether contacts are coloured."""
    what = "no two contacts of a stage share a body" if scene.contact.colouring == "contacts" else "of bodies"
    return where_bodies_meet("colouring", contact, what)


def stabilisation(scene: Scene, contact: Part) -> Part:
    """Decide whether overlaps are corrected."""
    how = scene.contact.stabilisation
    if contact.modelled and how == "none":
        return Part("stabilisation", False, 'contact.stabilisation = "none"')
    if contact.modelled and scene.domain.shear and not flow_presses(scene):
        return Part("stabilisation", False, "domain.shear: every contact is an impact at its own time")
    return where_bodies_meet("stabilisation", contact, f"{how}: overlaps are corrected")


def load(scene: Scene) -> str:
    """Return the force that presses contacts together; empty without one, when every contact is an impact."""
    if force := differing(scene):
        return force
    if field_presses(scene):
        return f"the {pushing(scene)}"
    if flow_presses(scene):
        return "the shear"
    return "the piston" if scene.has_piston else ""


def flow_presses(scene: Scene) -> bool:
    """Return whether contacts in a sheared box may last: where impacts are resolved at the end of a step.

    "auto" resolves the impacts of a gas at their own times, but not those of a packing, where they hardly end. 150
    rough spheres at a fraction of 0.55 take 40 times as long with them, and at 0.58 a step may take a minute.
    """
    if scene.domain.shear is None:
        return False
    asked = scene.contact.timing
    return asked == "end-of-step" or (asked == "auto" and filled_fraction(scene) > DENSE)


def filled_fraction(scene: Scene) -> float:
    """Return the volume of all bodies over that of the box."""
    cubes = sum(body.radius**3 for body in scene.body)
    cubes += sum(float((columns.radius**3).sum()) for columns in scene.data)
    volume = 4.0 / 3.0 * math.pi * cubes + sum(mean_volume(group) * group.count for group in scene.group)
    return volume / math.prod(scene.domain.size or (math.inf,))


def field_presses(scene: Scene) -> bool:
    """Return whether the uniform field or a medium presses bodies onto something fixed."""
    return scene.anchored and pushing(scene) != ""


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


# The parts that a part needs to work. Their consequences, such as torques from friction, are decided as for any scene.
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
    """Return the forced parts, each with the entry of ``model.force`` that needs it."""
    forced = {name: name for name in scene.model.force}
    for name in scene.model.force:
        for needed in _NEEDS.get(name, ()):
            forced.setdefault(needed, name)
    return forced


DOMINANT = 0.99  # smallest fraction of the mass of a dominant body
# revolutions of the innermost body, for "auto"; for fewer, Gauss–Radau integration to rounding is cheap
FEWEST_ORBITS = 1000
MOST_BODIES = 100  # for "auto"; more bodies may meet often, and each close encounter integrates all of them
HILL_RADII_APART = 5.0  # for "auto", between orbits, so that encounters are rare; Jupiter and Saturn are 8 apart
LEAST_DISTANCE = 8.0  # in sums of the two radii; Europa is 9 from Jupiter, the Moon 47 from the Earth
MOST_APART = 32  # bodies; more would soon meet often as the system contracts


class Heaviest(NamedTuple):
    """The heaviest body of a scene."""

    name: str
    fraction: float  # of the total mass


class _Point(NamedTuple):
    """A body as a point mass."""

    mass: float  # kg
    position: Sequence[float]  # m
    velocity: Sequence[float]  # m/s


class Orbit(NamedTuple):
    """An orbit about the heaviest body."""

    period: float  # s
    pericentre: float  # m
    apocentre: float  # m
    hill: float  # m, Hill radius


def heaviest(scene: Scene) -> Heaviest:
    """Return the heaviest body and its fraction of the expected total mass."""
    masses = [body_mass(made_of(scene, body)) for body in scene.body]
    groups = [mean_mass(made_of(scene, group)) for group in scene.group]
    total = math.fsum([*masses, *(mass * group.count for mass, group in zip(groups, scene.group, strict=True))])
    names, first = {number: body.name for number, body in enumerate(scene.body)}, len(masses)
    heavy = dict(enumerate(masses))
    for columns in scene.data:
        number = first + columns.heaviest
        heavy[number] = float(columns.mass[columns.heaviest])
        names[number] = columns.name[columns.heaviest] if columns.name else ""
        total += columns.total_mass
        first += len(columns)
    if heavy and max(heavy.values()) >= max(groups, default=0.0):
        number = max(heavy, key=heavy.__getitem__)
        return Heaviest(body_called(number, names[number]), heavy[number] / total)
    number = groups.index(max(groups))
    return Heaviest(f"a body of group.{number}", groups[number] / total)


def why_no_hierarchy(scene: Scene) -> str:
    """Return why the bodies do not orbit a dominant one, and the remedy; empty if they do."""
    if not gravity(scene).modelled:
        return 'without gravity between bodies; use "auto"'
    if scene.gravity.softening > 0.0:
        soft = f"gravity.softening = {scene.unit_system.text(scene.gravity.softening, LENGTH)}"
        return f'with {soft}, but its orbits assume point masses; set it to 0, or use "auto"'
    if any(scene.gravity.uniform):
        return "with gravity.uniform, under which orbits are not Keplerian; remove it"
    fixed = next((number for number, body in enumerate(scene.body) if body.fixed), None)
    if fixed is None and scene.has_fixed_bodies:
        return 'with a fixed body, but all bodies must be free to move; set fixed = false, or use "auto"'
    if fixed is not None:
        called = body_called(fixed, scene.body[fixed].name)
        return f'with {called} fixed, but all bodies must be free to move; set fixed = false, or use "auto"'
    name, fraction = heaviest(scene)
    if fraction <= DOMINANT:
        why = f"{name} has {100.0 * fraction:.4g} % of the mass, but more than 99 % is needed"
        return f'without a dominant body: {why}; use "auto"'
    return ""


def orbits_often(scene: Scene, hill_radii: float = HILL_RADII_APART) -> float:
    """Return the number of revolutions of the innermost body about a dominant one; 0 if orbits are too close."""
    if scene.group or not 3 <= scene.count <= MOST_BODIES:
        return 0.0
    if contact(scene).modelled or damping(scene) or why_no_hierarchy(scene):
        return 0.0
    orbits = _orbits(scene)
    if orbits is None or not all(
        outer.pericentre - inner.apocentre > hill_radii * max(inner.hill, outer.hill)
        for inner, outer in itertools.pairwise(orbits)
    ):
        return 0.0
    return scene.time.duration / min(orbit.period for orbit in orbits)


def _orbits(scene: Scene) -> list[Orbit] | None:
    """Return the orbits about the heaviest body, ordered by pericentre; None if a body is not bound."""
    points = [_Point(body_mass(made_of(scene, body)), body.position, body.velocity) for body in scene.body]
    for columns in scene.data:
        state = columns.mass.tolist(), columns.position.tolist(), columns.velocity.tolist()
        points += itertools.starmap(_Point, zip(*state, strict=True))
    centre = max(points, key=lambda point: point.mass)
    orbits = []
    for point in points:
        if point is centre:
            continue
        orbit = _orbit(point, centre, scene.gravity.constant)
        if orbit is None:
            return None
        orbits.append(orbit)
    return sorted(orbits, key=lambda orbit: orbit.pericentre)


def _orbit(body: _Point, centre: _Point, constant: float) -> Orbit | None:
    """Return the orbit of a body about another one; None if it is not bound."""
    mass, heavy = body.mass, centre.mass
    x = [there - here for there, here in zip(body.position, centre.position, strict=True)]
    v = [there - here for there, here in zip(body.velocity, centre.velocity, strict=True)]
    mu, r = constant * (heavy + mass), math.hypot(*x)
    beta = 2.0 * mu / r - math.fsum(u * u for u in v) if r > 0.0 else 0.0
    if beta <= 0.0:
        return None
    axis = mu / beta
    spin = math.hypot(x[1] * v[2] - x[2] * v[1], x[2] * v[0] - x[0] * v[2], x[0] * v[1] - x[1] * v[0])
    e = math.sqrt(max(0.0, 1.0 - spin * spin / (mu * axis)))
    period = 2.0 * math.pi * axis * math.sqrt(axis / mu)
    return Orbit(period, axis * (1.0 - e), axis * (1.0 + e), axis * (mass / (3.0 * heavy)) ** (1.0 / 3.0))


def far_apart(scene: Scene) -> bool:
    """Return whether there are few bodies at large initial distances and no groups, as for planets and comets."""
    if scene.group or not 2 <= scene.count <= MOST_APART:
        return False
    position = np.array([body.position for body in scene.body]).reshape(-1, 3)
    radius = np.array([body.radius for body in scene.body])
    position = np.concatenate([position, *(columns.position for columns in scene.data)])
    radius = np.concatenate([radius, *(columns.radius for columns in scene.data)])
    i, j = np.triu_indices(len(radius), 1)
    distance = np.sqrt(((position[i] - position[j]) ** 2).sum(axis=1))
    return bool(np.all(distance >= LEAST_DISTANCE * (radius[i] + radius[j])))
