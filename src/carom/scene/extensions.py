"""The parts of installed packages that a scene uses, and the properties that name them in a recording."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

from carom import registry

if TYPE_CHECKING:
    from carom.scene.schema import Scene

PROPERTY = "extension."  # before kind.name, in the properties of a recording that state the package and its version


def extensions_of(scene: Scene) -> dict[str, str]:
    """Return the package and version of each part that a scene uses from installed packages, by kind.name."""
    found = ((f"{kind}.{name}", registry.origin(kind, name)) for kind, name in _used(scene))
    return {key: f"{origin.package} {origin.version}" for key, origin in found if origin}


def _used(scene: Scene) -> Iterator[tuple[str, str]]:
    yield from (("forces", name) for name in scene.forces.given)
    yield from (("contact_laws", name) for name in scene.contact.laws)
    yield from (("walls", wall.shape) for wall in scene.wall)
    yield from (("series", name) for name in scene.record.series)
    if scene.time.integrator in registry.installed("integrators"):
        yield "integrators", scene.time.integrator


def stamped(properties: Mapping[str, Any]) -> dict[str, str]:
    """Return `extensions_of` the scene of a recording, from its properties."""
    known = {key.removeprefix(PROPERTY): str(value) for key, value in properties.items() if key.startswith(PROPERTY)}
    return dict(sorted(known.items()))


def names_of(kind: str, extensions: Mapping[str, str]) -> list[str]:
    """Return the names of the parts of a kind."""
    return [key.removeprefix(f"{kind}.") for key in extensions if key.startswith(f"{kind}.")]


def missing(extensions: Mapping[str, str]) -> str:
    """Return a sentence with the packages to install for missing parts of a recording; empty if none is missing."""
    lost: dict[str, list[str]] = {}
    for key, package in extensions.items():
        kind, _, name = key.partition(".")
        if kind in registry.KINDS and name not in registry.installed(kind):
            lost.setdefault(package, []).append(f'the {registry.KINDS[kind]} "{name}"')
    return "; ".join(
        f"it uses {' and '.join(parts)} of the package {package}, which is not installed: "
        f"pip install {package.replace(' ', '==')}"
        for package, parts in lost.items()
    )
