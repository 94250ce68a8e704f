"""The parts of the model by name: `carom explain` prints the names, and ``model.force`` accepts them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from carom.scene.wording import suggestion

OWN_FORCES = ("gravity", "uniform-field", "drag")  # carom's forces in the order in which their accelerations are added
PARTS = (  # parts in the order in which a step uses them
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
    OWN_FORCES[0],
    "tree",
    "potential",
    *OWN_FORCES[1:],
    "resting-contacts",
    "restitution",
    "friction",
    "torque",
    "energy",
)


@dataclass(frozen=True)
class Part:
    """One part of the model: its name, whether it is modelled, and the reason."""

    name: str  # as in `PARTS`
    modelled: bool
    why: str


def in_order(names: Iterable[str]) -> tuple[str, ...]:
    """Return names of parts in the order of `PARTS`; forces of packages follow carom's own."""
    others = [name for name in names if name not in PARTS]
    last = PARTS.index(OWN_FORCES[-1]) + 1
    return (*PARTS[:last], *others, *PARTS[last:])


def unknown(name: str) -> str:
    """Return the message about an unknown part, with the nearest known name."""
    return f'no part "{name}"; {suggestion(name, PARTS)}'
