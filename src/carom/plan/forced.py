"""Parts of the model that `model.force` switches on."""

from __future__ import annotations

from carom.scene.schema import Scene

# What a part cannot be without. What follows from a part, such as torques from friction, is decided as for any other.
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
    """Return the parts that are forced on, each with the one in ``model.force`` that wants it."""
    forced = {name: name for name in scene.model.force}
    for name in scene.model.force:
        for needed in _NEEDS.get(name, ()):
            forced.setdefault(needed, name)
    return forced
