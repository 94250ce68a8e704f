"""Checks of the names of materials: where they are given, and where they are used."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING

from carom.scene.nearest import suggestion
from carom.scene.schema.material import DEFAULT, Material, Pair
from carom.scene.schema.matter import Matter
from carom.scene.schema.section_error import SectionError

if TYPE_CHECKING:
    from carom.scene.schema.scene import Scene

Path = tuple[str | int, ...]


def check_materials(scene: Scene) -> None:
    """Refuse names that are unknown or given twice, and bodies that contradict their material.

    Raises
    ------
    SectionError
        Naming the key.
    """
    known: dict[str, Material | None] = {DEFAULT: None}
    for index, material in enumerate(scene.material):
        if material.name in known:
            raise SectionError(
                ("material", index, "name"), f'a second material "{material.name}"; rename one of the two'
            )
        known[material.name] = material
    _check_pairs(scene.pair, known)
    for section, members in (("body", scene.body), ("bodies", scene.bodies), ("group", scene.group)):
        for index, matter in enumerate(members):
            if matter.material is not None:
                _check_matter((section, index), matter, known)
    for index, plane in enumerate(scene.plane):
        if plane.material is not None:
            _check_name(("plane", index, "material"), plane.material, known)
            if plane.given:
                raise SectionError(
                    ("plane", index, plane.given[0]),
                    f'given, and material = "{plane.material}" has one; leave one of the two out',
                )
    if scene.domain.material is not None:
        _check_name(("domain", "material"), scene.domain.material, known)


def _check_name(path: Path, name: str, known: Iterable[str]) -> None:
    if name not in known:
        given = list(known)
        only = f'there is no [[material]], only "{DEFAULT}"'
        raise SectionError(path, f'no material "{name}"; {suggestion(name, given) if len(given) > 1 else only}')


def _check_matter(path: Path, matter: Matter, known: Mapping[str, Material | None]) -> None:
    name = matter.material or ""
    _check_name((*path, "material"), name, known)
    material = known[name]
    for key in ("density", "inertia_factor"):
        if material is not None and getattr(matter, key) is not None and getattr(material, key) is not None:
            raise SectionError((*path, key), f'given, and material = "{name}" has one; leave one of the two out')


def _check_pairs(pairs: tuple[Pair, ...], known: Iterable[str]) -> None:
    seen: set[frozenset[str]] = set()
    for index, pair in enumerate(pairs):
        path: Path = ("pair", index, "materials")
        for name in pair.materials:
            _check_name(path, name, known)
        if frozenset(pair.materials) in seen:
            raise SectionError(path, f"a second pair of {' and '.join(pair.materials)}; merge the two")
        seen.add(frozenset(pair.materials))
