"""Contact laws: how a contact rebounds, slides, rolls and twists.

`COULOMB` is the law of scenes that choose no law. A scene selects another law by ``contact.law``. It may select several
laws if they define different functions, such as a restitution and a rolling resistance. The coefficients of a law are
in a section ``[contact.NAME]``, or in a section NAME of a material, a pair of materials or a plane.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, fields
from typing import Any

from carom import registry
from carom.scene.installed_forces import numbers_of

Numbers = Mapping[str, float]  # coefficients of a law by name, in SI units


def geometric_mean(a: float, b: float) -> float:
    """Return √(a b), which is exactly a if both are equal."""
    return a if a == b else math.sqrt(a) * math.sqrt(b)  # the product could underflow


def geometric_means(one: Numbers, other: Numbers) -> Numbers:
    """Return the geometric mean of each coefficient, as for friction; the mean is 0 if one of the two is 0."""
    return {name: geometric_mean(a, other[name]) for name, a in one.items()}


@dataclass(frozen=True, slots=True)
class ContactLaw:
    """A contact law: the impulses that a contact exerts.

    carom compiles the functions of a law with Numba, as in `carom.extend.BodyForce`. The first argument of each
    function is a record of the coefficients of the two materials: the coefficients of Coulomb's law (``restitution``,
    ``static_friction``, ``kinetic_friction``) and of the law's section. None selects the function of Coulomb's law.

    An angular impulse acts on body j, and the opposite impulse on body i. The function receives the angular impulse
    that would end the relative rotation, and returns the exerted angular impulse, which must not be larger, since a
    contact only dissipates. ``radius`` is the reduced radius r_i r_j / (r_i + r_j) in m or, at a plane, the radius of
    the body.
    """

    section: type[Any] | None  # in the scene: a `carom.extend.Section` whose docstring says "[contact.NAME]: what it
    # is"; None if the law has no further coefficients
    rolling: Callable[..., tuple[float, float, float]] | None = None  # (p, normal, radius, x, y, z) → N m s, (3,),
    # about axes in the tangential plane; ``normal`` is the normal impulse in N s
    twisting: Callable[..., float] | None = None  # (p, normal, radius, stopping) → N m s, about the normal
    restitution: Callable[..., float] | None = None  # see `carom.physics.contact.law` for the arguments
    equivalent_speed: Callable[..., float] | None = None
    dissipates: Callable[..., bool] | None = None
    impact_friction: Callable[..., float] | None = None
    lasting_friction: Callable[..., tuple[float, float, float]] | None = None
    sliding_friction: Callable[..., tuple[float, float, float]] | None = None
    sticks: Callable[..., bool] | None = None
    slides: Callable[..., bool] | None = None
    coefficients: Callable[[Any], Numbers] = numbers_of  # coefficients from a section, in SI units
    combined: Callable[[Numbers, Numbers], Numbers] = geometric_means  # combines the coefficients of two materials


COULOMB = ContactLaw(None)
DEFAULT_LAW = "coulomb"
FUNCTIONS = tuple(
    field.name for field in fields(ContactLaw) if field.name not in ("section", "coefficients", "combined")
)


def law_called(name: str) -> ContactLaw:
    """Return a contact law by its name; raises `ExtensionError` if it cannot be loaded."""
    law: ContactLaw = registry.load("contact_laws", name)
    return law


def functions_of(laws: Iterable[str]) -> dict[str, Callable[..., Any]]:
    """Return the functions that laws define together, by name; the remaining functions are Coulomb's.

    Raises ValueError if two laws define the same function.
    """
    functions: dict[str, Callable[..., Any]] = {}
    owner: dict[str, str] = {}
    for name in laws:
        law = law_called(name)
        for key in FUNCTIONS:
            function = getattr(law, key)
            if function is None:
                continue
            if key in functions:
                raise ValueError(f'"{owner[key]}" and "{name}" both define the {key} of a contact; choose one of them')
            functions[key], owner[key] = function, name
    return functions


def exerts_torque(laws: Iterable[str]) -> bool:
    """Return whether contacts under these laws resist rolling or twisting."""
    return any(law.rolling is not None or law.twisting is not None for law in map(law_called, laws))
