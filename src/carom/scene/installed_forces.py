"""Forces of installed packages: the classes that a package instantiates, and the search for a force by its name."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from carom import registry


def numbers_of(section: Any) -> Mapping[str, float]:
    """Return the numbers of a section: the default parameters of a force, or coefficients of a contact law."""
    values = dict(section)
    return {name: float(value) for name, value in values.items() if type(value) in (int, float)}


@dataclass(frozen=True, slots=True)
class BodyForce:
    """A force on each body, which depends on the body's position.

    The energy of such a force is the energy of its potential. Without a potential, the ledger has an entry for the
    force's work.

    carom compiles both functions with Numba, so they may use only sums, products, quotients and `math.sqrt` of numbers,
    and call only functions decorated by `carom.extend.kernel`. ``p`` is a record of the parameters.
    """

    section: type[Any]  # in the scene: a `carom.extend.Section` whose docstring says "[forces.NAME]: what it is"
    acceleration: Callable[..., tuple[float, float, float]]  # (x, y, z, p) → m/s²
    potential: Callable[..., float] | None = None  # (x, y, z, p) → J/kg, for a body of 1 kg; or None
    # returns the fields of p from the section, in SI units
    parameters: Callable[[Any], Mapping[str, float]] = numbers_of
    legend: str = ""  # legend of the force's energy; by default its name
    meaning: str = ""  # meaning of the force's energy, for `carom inspect`
    colour: str = "orange"  # colour of the force's energy: one of `carom.recording.schema.palette.LINES`
    periodic: bool = False  # whether the force may act in a periodic box, because it is the same on opposite faces


@dataclass(frozen=True, slots=True)
class PairForce:
    """A central force between every two bodies, which depends on their distance.

    The functions are compiled like the functions of a `BodyForce`. In a periodic box, the force acts between nearest
    images.
    """

    section: type[Any]  # in the scene, as for `BodyForce`
    attraction: Callable[..., float]  # (d2, m_i, m_j, p) → N/m, F/d, negative for repulsion; d2 is the squared distance
    potential: Callable[..., float]  # (d2, m_i, m_j, p) → J, potential energy of the pair
    parameters: Callable[[Any], Mapping[str, float]] = numbers_of
    legend: str = ""
    meaning: str = ""
    colour: str = "orange"


def force_called(name: str) -> BodyForce | PairForce:
    """Return a force of an installed package by its name; raises `ExtensionError` if it cannot be loaded."""
    force: BodyForce | PairForce = registry.load("forces", name)
    return force
