"""Decides whether the bodies of a scene orbit a dominant body, and how far apart they are at the start.

Planets and comets keep their distances for many revolutions; integrators of orbits rely on this.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from carom.plan.interactions import contact, damping, gravity
from carom.scene.load import Scene
from carom.scene.matter import body_mass, made_of, mean_mass
from carom.scene.units.dimension import LENGTH
from carom.scene.wording import body_called

DOMINANT = 0.99  # smallest fraction of the total mass in a dominant body
# smallest number of revolutions of the innermost body for which "auto" chooses wisdom-holman; for fewer,
# gauss-radau15 is cheap
FEWEST_ORBITS = 1000
# largest number of bodies for wisdom-holman; more bodies meet more often, and gauss-radau15 integrates all of them in
# each encounter
MOST_BODIES = 100
# smallest distance of two orbits in Hill radii, so that encounters are rare; Jupiter and Saturn are 8 apart
HILL_RADII_APART = 5.0
# smallest distance of bodies far apart, in sums of their radii; Europa is 9 from Jupiter, the Moon 47 from the Earth
LEAST_DISTANCE = 8.0
WIDER = 1.0 + 1e-9  # factor that enlarges a distance by more than any rounding
# largest number of bodies that count as far apart, unless one dominates: in a contracting system, more bodies would
# soon meet often
MOST_APART = 32


class Heaviest(NamedTuple):
    """The heaviest body of a scene."""

    name: str
    fraction: float  # fraction of the total mass that this body has


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
    """Return why the bodies do not orbit a dominant body, and the remedy; empty if they do."""
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
    if fraction > DOMINANT:
        return ""
    why = f"{name} has {100.0 * fraction:.4g} % of the mass, but more than 99 % is needed"
    return f'without a dominant body: {why}; use "auto"'


def orbits_often(scene: Scene, hill_radii: float = HILL_RADII_APART) -> float:
    """Return the number of revolutions of the innermost body about the dominant body; 0 if orbits are too close."""
    if scene.count > MOST_BODIES:
        return 0.0
    orbits = _orbits_about_dominant(scene)
    apart = all(
        outer.pericentre - inner.apocentre > hill_radii * max(inner.hill, outer.hill)
        for inner, outer in itertools.pairwise(orbits)
    )
    return _revolutions(scene, orbits) if apart else 0.0


def revolutions(scene: Scene) -> float:
    """Return the number of revolutions of the innermost body about the dominant body; 0 without such orbits."""
    return _revolutions(scene, _orbits_about_dominant(scene))


def _revolutions(scene: Scene, orbits: list[Orbit]) -> float:
    return scene.time.duration / min((orbit.period for orbit in orbits), default=math.inf)


def _orbits_about_dominant(scene: Scene) -> list[Orbit]:
    """Return the orbits about a dominant body, ordered by pericentre; none if any force but gravity acts."""
    if scene.group or scene.count < 3 or contact(scene).modelled or damping(scene) or why_no_hierarchy(scene):
        return []
    return _orbits(scene) or []


def _orbits(scene: Scene) -> list[Orbit] | None:
    """Return the orbits about the heaviest body, ordered by pericentre; None if a body is not bound."""
    points = [_Point(body_mass(made_of(scene, body)), body.position, body.velocity) for body in scene.body]
    for columns in scene.data:
        state = columns.mass.tolist(), columns.position.tolist(), columns.velocity.tolist()
        points += itertools.starmap(_Point, zip(*state, strict=True))
    centre = max(points, key=lambda point: point.mass)
    orbits = []
    for body in points:
        if body is centre:
            continue
        x = [there - here for there, here in zip(body.position, centre.position, strict=True)]
        v = [there - here for there, here in zip(body.velocity, centre.velocity, strict=True)]
        mu, r = scene.gravity.constant * (centre.mass + body.mass), math.hypot(*x)
        beta = 2.0 * mu / r - math.fsum(u * u for u in v) if r > 0.0 else 0.0
        if beta <= 0.0:
            return None
        axis = mu / beta
        spin = math.hypot(x[1] * v[2] - x[2] * v[1], x[2] * v[0] - x[0] * v[2], x[0] * v[1] - x[1] * v[0])
        e = math.sqrt(max(0.0, 1.0 - spin * spin / (mu * axis)))
        period = 2.0 * math.pi * axis * math.sqrt(axis / mu)
        hill = axis * (body.mass / (3.0 * centre.mass)) ** (1.0 / 3.0)
        orbits.append(Orbit(period, axis * (1.0 - e), axis * (1.0 + e), hill))
    return sorted(orbits, key=lambda orbit: orbit.pericentre)


def far_apart(scene: Scene) -> bool:
    """Return whether the bodies are far apart at the start, and few or on orbits, like planets and comets."""
    if scene.group or scene.count < 2:
        return False
    if scene.count > MOST_APART and (why_no_hierarchy(scene) or _orbits(scene) is None):
        return False
    position = np.array([body.position for body in scene.body]).reshape(-1, 3)
    radius = np.array([body.radius for body in scene.body])
    position = np.concatenate([position, *(columns.position for columns in scene.data)])
    radius = np.concatenate([radius, *(columns.radius for columns in scene.data)])
    order = np.argsort(position[:, 0], kind="stable")  # all pairs of 900 bodies would take 30 ms in each of 50 calls
    position, radius = position[order], radius[order]
    reach = 2.0 * LEAST_DISTANCE * radius.max() * WIDER
    for k in range(1, len(radius)):
        apart = position[k:] - position[:-k]
        if apart[:, 0].min() > reach:  # no pair farther apart in this order is within reach either
            return True
        if np.any(np.sqrt((apart**2).sum(axis=1)) < LEAST_DISTANCE * (radius[k:] + radius[:-k])):
            return False
    return True
