"""The parts of the model by name, as `carom explain` prints them and `model.force` takes them."""

from __future__ import annotations

from carom.scene.nearest import suggestion

PARTS = (  # in the order in which a step uses them
    "warm-up",
    "adaptive-step",
    "integrator",
    "spin",
    "orientation",
    "contact",
    "broad-phase",
    "narrow-phase",
    "time-of-impact",
    "colouring",
    "stabilisation",
    "gravity",
    "tree",
    "potential",
    "uniform-field",
    "resting-contacts",
    "restitution",
    "friction",
    "torque",
    "energy",
)


def unknown(name: str) -> str:
    """Say that there is no part of that name, and which is nearest."""
    return f'no part "{name}"; {suggestion(name, PARTS)}'
