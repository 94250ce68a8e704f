"""The scene: everything that a run depends on, as validated data. Each description states the unit.

Sections and keys have the names that they have in the TOML file. All are optional, except that a scene needs a body or
a group. Unknown keys are refused.
"""

from carom.scene.schema.bodies import BodyData
from carom.scene.schema.body import Body
from carom.scene.schema.contact import Contact
from carom.scene.schema.domain import Domain
from carom.scene.schema.expect import Expect
from carom.scene.schema.forces import Drag, Gravity
from carom.scene.schema.group import Group, RadiusRange, Region, Spin, Velocity
from carom.scene.schema.material import Coefficients, Material, Pair
from carom.scene.schema.model import Model
from carom.scene.schema.plane import Plane
from carom.scene.schema.promise import Promise
from carom.scene.schema.quantity import LARGEST
from carom.scene.schema.record import Record
from carom.scene.schema.scene import Scene
from carom.scene.schema.sweep import Sweep
from carom.scene.schema.time import Time
from carom.scene.schema.units import Units

__all__ = [
    "LARGEST",
    "Body",
    "BodyData",
    "Coefficients",
    "Contact",
    "Domain",
    "Drag",
    "Expect",
    "Gravity",
    "Group",
    "Material",
    "Model",
    "Pair",
    "Plane",
    "Promise",
    "RadiusRange",
    "Record",
    "Region",
    "Scene",
    "Spin",
    "Sweep",
    "Time",
    "Units",
    "Velocity",
]
