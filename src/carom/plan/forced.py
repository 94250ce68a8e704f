"""Parts of the model that `model.force` switches on."""

from __future__ import annotations

from carom.scene.schema import Scene

# The parts that each part needs. Consequences, such as torques from friction, are decided as for any scene.
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
    """Return the parts that are forced on, each with the part in ``model.force`` that needs it."""
    forced = {name: name for name in scene.model.force}
    for name in scene.model.force:
        for needed in _NEEDS.get(name, ()):
            forced.setdefault(needed, name)
    return forced
