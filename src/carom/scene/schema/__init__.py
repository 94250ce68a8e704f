"""The scene: everything that a run depends on, as validated data. Each description states the unit.

Sections and keys have the same names as in the TOML file. All are optional, but a scene needs a body or a group.
Unknown keys are refused.
"""

import warnings
from typing import Any

from carom.scene.schema.body import Body, BodyData, BodyGroup, RadiusRange, Region, SolidPlane, Spin, Velocity
from carom.scene.schema.contact import Coefficients, ContactSettings, Drag, Gravity, Material, MaterialPair
from carom.scene.schema.promise import Expect, Promise, Sweep
from carom.scene.schema.quantity import LARGEST
from carom.scene.schema.scene import Scene
from carom.scene.schema.settings import Domain, ForcedParts, Record, Time, Units

__all__ = [
    "LARGEST",
    "Body",
    "BodyData",
    "BodyGroup",
    "Coefficients",
    "ContactSettings",
    "Domain",
    "Drag",
    "Expect",
    "ForcedParts",
    "Gravity",
    "Material",
    "MaterialPair",
    "Promise",
    "RadiusRange",
    "Record",
    "Region",
    "Scene",
    "SolidPlane",
    "Spin",
    "Sweep",
    "Time",
    "Units",
    "Velocity",
]


def __getattr__(name: str) -> Any:
    if name == "StaticPlane":  # its name until 0.1, when planes could not move
        warnings.warn("carom.scene.schema.StaticPlane is now called SolidPlane", DeprecationWarning, stacklevel=2)
        return SolidPlane
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
