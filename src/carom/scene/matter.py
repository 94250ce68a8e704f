"""Masses, materials, and the coefficients of contacts.

A contact of two materials has the coefficients of their [[pair]]. Missing coefficients are combined from both
materials, see `carom.scene.schema.contact.combined`. Coefficients of a [[plane]] apply to all contacts with it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np

from carom.arrays import FloatArray, IntArray
from carom.scene.contact_laws import Numbers, law_called
from carom.scene.portable_math import power
from carom.scene.scene_model import SceneModel
from carom.scene.schema import Body, BodyGroup, Coefficients, Material
from carom.scene.schema.body import Matter
from carom.scene.schema.contact import DEFAULT, Surface, combined

DEFAULT_DENSITY = 1000.0  # kg/m³
SAMPLE = 4096  # number of sampled radii; the mean volume of uniform radii up to r is then known to 2 %


def body_mass(body: Body) -> float:
    """Return the mass of a body in kg."""
    return float(mass_of(body, np.array(body.radius)))


def mean_mass(group: BodyGroup) -> float:
    """Return the expected mass of a body of a group in kg."""
    if group.mass is not None:
        return group.mass
    return (DEFAULT_DENSITY if group.density is None else group.density) * mean_volume(group)


@np.errstate(over="ignore")
def mass_of(matter: Body | BodyGroup, radius: FloatArray) -> FloatArray:
    """Return masses (n,) in kg for radii (n,) in m."""
    if matter.mass is not None:
        return np.asarray(matter.mass)
    density = DEFAULT_DENSITY if matter.density is None else matter.density
    return np.asarray(density * (4.0 / 3.0) * math.pi * radius * radius * radius)


def drawn_radii(group: BodyGroup, rng: np.random.Generator) -> FloatArray:
    """Draw radii by inverting the cumulative distribution."""
    low, high = group.radius.min, group.radius.max
    u = rng.random(group.count)
    if low == high:
        return np.full(group.count, low)
    if group.radius.distribution == "uniform":
        return low + (high - low) * u
    p = group.radius.exponent + 1.0
    if group.radius.distribution == "log-uniform" or p == 0.0:
        return np.asarray(np.clip(low * power(np.array(high / low), u), low, high))
    return np.asarray(np.clip(low * power(1 + u * (power(np.array(high / low), p) - 1), 1 / p), low, high))


def mean_volume(group: BodyGroup) -> float:
    """Return the mean volume of a sphere of the group, from a fixed sample of the radius distribution."""
    sample = group.model_copy(update={"count": SAMPLE})
    radius = drawn_radii(sample, np.random.default_rng(0))
    return float(np.mean((4.0 / 3.0) * math.pi * radius * radius * radius))


AnyMatter = TypeVar("AnyMatter", bound=Matter)


@dataclass(frozen=True)
class BodyMaterials:
    """The materials of the bodies of a scene."""

    names: list[str]  # (a,) names in the order of the first body of each material
    index: IntArray  # (n,) indices into `names`


@dataclass(frozen=True)
class PairCoefficients:
    """Coefficients of the contacts between n bodies, which have ``a`` materials, and with p planes and walls.

    If all bodies have one material, there is one row for contacts between bodies, and one for each plane. Otherwise
    each material has a + p rows: one for contacts with each material, and one for each plane. For the contact of body i
    with body j > i, or with plane j - n, the row is ``places[i, 0] + places[j, 1]``.
    """

    rows: FloatArray  # (1 + p, 3), or (a (a + p), 3): the fields of `Coefficients`
    bodies: int  # number n of bodies
    # (n + p, 2) places; no rows if there is one material
    places: IntArray = field(default_factory=lambda: np.zeros((0, 2), dtype=np.int64))
    laws: tuple[str, ...] = ()  # names of the contact laws other than Coulomb's
    names: tuple[str, ...] = ()  # names of the laws' further coefficients
    # (rows, k) values of the further coefficients
    further: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))

    def of(self, i: int, j: int) -> Coefficients:
        """Return the coefficients of the contact of body i with body j > i, or with plane j - n."""
        row = self.places[i, 0] + self.places[j, 1] if len(self.places) else max(0, j - self.bodies + 1)
        return Coefficients(*self.rows[row].tolist())


@dataclass(frozen=True)
class KindOfContact:
    """A kind of contact that a scene may have."""

    between: tuple[str, str]  # materials, or a material and a plane
    coefficients: Coefficients

    def other(self, name: str) -> str:
        """Return the other material or plane."""
        one, other = self.between
        return other if one == name else one

    def __str__(self) -> str:
        one, other = self.between
        return f"{one} on {one}" if one == other else f"{one} and {other}"


def body_materials(scene: SceneModel) -> BodyMaterials:
    """Return the material of each body."""
    given = _given(scene)
    names = list(dict.fromkeys(name for name, _ in given))
    number = {name: index for index, name in enumerate(names)}
    index = np.repeat([number[name] for name, _ in given], [count for _, count in given])
    return BodyMaterials(names, index.astype(np.int64))


def pair_coefficients(scene: SceneModel) -> PairCoefficients:
    """Return the coefficients of all kinds of contacts."""
    names, further = _names(scene), tuple(_of_law(scene, DEFAULT, DEFAULT))
    table, own = _table(scene, names), len(Coefficients._fields)
    bodies, planes = scene.count, table.shape[1] - len(names)
    law, no_places = (scene.contact.laws, further), np.zeros((0, 2), dtype=np.int64)
    if (table[:, : len(names)] == table[0, 0]).all() and (table[:, len(names) :] == table[:1, len(names) :]).all():
        one = np.concatenate((table[0, :1], table[0, len(names) :]))
        return PairCoefficients(one[:, :own], bodies, no_places, *law, one[:, own:])
    places = np.zeros((bodies + planes, 2), dtype=np.int64)
    places[:bodies, 1] = body_materials(scene).index
    places[bodies:, 1] = len(names) + np.arange(planes)
    places[:bodies, 0] = places[:bodies, 1] * table.shape[1]
    rows = table.reshape(-1, table.shape[2])
    return PairCoefficients(rows[:, :own], bodies, places, *law, rows[:, own:])


def kinds_of_contacts(scene: SceneModel) -> list[KindOfContact]:
    """List the possible kinds of contacts between the materials and planes of a scene."""
    names, own = _names(scene), len(Coefficients._fields)
    table = _table(scene, names)
    planes = [_called(plane.name or f"plane {index}", plane.material) for index, plane in enumerate(scene.plane)]
    domain = [_called("walls", scene.domain.material)] if scene.domain.walled else []
    walls = [_called(name, wall.material) for name, wall in zip(scene.wall_names, scene.wall, strict=True)]
    columns = [*range(len(names) + len(planes) + len(domain)), *range(table.shape[1] - len(walls), table.shape[1])]
    ends = dict(zip(columns, (*names, *planes, *domain, *walls), strict=True))
    return [
        KindOfContact((name, ends[other]), Coefficients(*table[index, other, :own].tolist()))
        for index, name in enumerate(names)
        for other in columns[index:]
    ]


def material_called(scene: SceneModel, name: str) -> Material | None:
    """Return the material with a name; None for the material of [contact]."""
    return next((material for material in scene.material if material.name == name), None)


def made_of(scene: SceneModel, matter: AnyMatter) -> AnyMatter:
    """Return a body or a group with the density and the inertia factor of its material."""
    material = material_called(scene, matter.material) if matter.material else None
    if material is None:
        return matter
    density = matter.density if matter.density is not None or matter.mass is not None else material.density
    factor = matter.inertia_factor if matter.inertia_factor is not None else material.inertia_factor
    return matter.model_copy(update={"density": density, "inertia_factor": factor})


def between(scene: SceneModel, one: str, other: str) -> Coefficients:
    """Return the coefficients of a contact of two materials."""
    meeting = combined(_coefficients_of(scene, one), _coefficients_of(scene, other))
    pair = next((pair for pair in scene.pair if set(pair.materials) == {one, other}), None)
    return meeting if pair is None else pair.completed(meeting)


def _coefficients_of(scene: SceneModel, name: str) -> Coefficients:
    material, default = material_called(scene, name), scene.contact.coefficients
    return default if material is None else material.completed(default)


def _called(name: str, material: str | None) -> str:
    return f"{name} ({material})" if material else name


def _given(scene: SceneModel) -> list[tuple[str, int]]:
    """Return the materials in the order of the bodies, each with its number of bodies."""
    members: Iterable[tuple[Matter, int]] = [
        *((body, 1) for body in scene.body),
        *((section, len(columns)) for section, columns in zip(scene.bodies, scene.data, strict=True)),
        *((group, group.count) for group in scene.group),
    ]
    return [(matter.material or DEFAULT, count) for matter, count in members]


def _names(scene: SceneModel) -> list[str]:
    """Return the materials of the bodies."""
    return list(dict.fromkeys(name for name, _ in _given(scene))) if scene.material else [DEFAULT]


def _of_law(scene: SceneModel, one: str, other: str, plane: Surface | None = None) -> dict[str, float]:
    """Return the further coefficients of the contact laws for two materials.

    ``plane`` may have its own coefficients. If the section of a material, a pair or a plane lacks a coefficient, the
    coefficient keeps the value that it would have without the section.
    """
    pair = next((pair for pair in scene.pair if set(pair.materials) == {one, other}), None)
    coefficients: dict[str, float] = {}
    for name in scene.contact.laws:
        law, default = law_called(name), scene.contact.law_section(name)
        if default is None:
            continue
        common = law.coefficients(default)
        mine, others = (_completed(common, name, material_called(scene, material)) for material in (one, other))
        coefficients |= _completed(_completed(law.combined(mine, others), name, pair), name, plane)
    return coefficients


def _completed(numbers: Numbers, law: str, surface: Surface | None) -> dict[str, float]:
    """Return the coefficients of a law; coefficients of ``surface`` take precedence."""
    own = None if surface is None else getattr(surface, law)
    if own is None:
        return dict(numbers)
    implied = type(own).model_fields.keys() - own.model_fields_set
    stated = law_called(law).coefficients(own)
    return {**numbers, **{key: value for key, value in stated.items() if key not in implied}}


def _table(scene: SceneModel, names: list[str]) -> FloatArray:
    """Return the coefficients of each material with each material, plane and wall, (a, a + p, 3 + k)."""
    walls = 2 * len(scene.domain.walled)

    def row(name: str, other: str, plane: Surface | None = None) -> tuple[float, ...]:
        meeting = between(scene, name, other)
        own = meeting if plane is None else plane.completed(meeting)
        return (*own, *_of_law(scene, name, other, plane).values())

    rows = [
        [
            *(row(name, other) for other in names),
            *(row(name, plane.material or DEFAULT, plane) for plane in scene.plane),
            *([row(name, scene.domain.material or DEFAULT)] * walls),
            *(row(name, wall.material or DEFAULT, wall) for wall in scene.wall),
        ]
        for name in names
    ]
    return np.array(rows, dtype=np.float64)
