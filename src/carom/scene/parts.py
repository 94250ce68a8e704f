"""The parts of the model by name, and the parts of installed packages that a scene uses.

`carom explain` prints the names of parts and `model.force` accepts them. The properties of a recording name the parts
of installed packages.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from carom import registry
from carom.scene.forces import FORCES, GRAVITY
from carom.scene.wording import suggestion

if TYPE_CHECKING:
    from carom.scene.schema import Scene

PARTS = (  # in the order in which a step uses them
    "warm-up",
    "adaptive-step",
    "integrator",
    "accuracy",
    "spin",
    "orientation",
    "contact",
    "broad-phase",
    "narrow-phase",
    "time-of-impact",
    "colouring",
    "stabilisation",
    GRAVITY.name,
    "tree",
    "potential",
    *(kind.name for kind in FORCES if kind is not GRAVITY),
    "resting-contacts",
    "restitution",
    "friction",
    "torque",
    "energy",
)
PROPERTY = "extension."  # prefix of kind.name in the properties of a recording, for its package and version


@dataclass(frozen=True)
class Part:
    """One part of the model: its name, whether it is modelled, and the reason."""

    name: str  # as in `PARTS`
    modelled: bool
    why: str


def in_order(names: Iterable[str]) -> tuple[str, ...]:
    """Return names of parts in the order of `PARTS`; names of other forces follow carom's own."""
    others = [name for name in names if name not in PARTS]
    last = PARTS.index(FORCES[-1].name) + 1
    return (*PARTS[:last], *others, *PARTS[last:])


def unknown(name: str) -> str:
    """Return the message about an unknown part, with the nearest known name."""
    return f'no part "{name}"; {suggestion(name, PARTS)}'


def extensions_of(scene: Scene) -> dict[str, str]:
    """Return the package and version of each part that a scene uses from installed packages, by kind.name."""
    used: dict[str, Iterable[str]] = {
        "forces": scene.forces.given,
        "contact_laws": scene.contact.laws,
        "walls": (wall.shape for wall in scene.wall),
        "series": scene.record.series,
        "integrators": (scene.time.integrator,),
    }
    found = {f"{kind}.{name}": registry.origin(kind, name) for kind, names in used.items() for name in names}
    return {key: f"{origin.package} {origin.version}" for key, origin in found.items() if origin}


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
