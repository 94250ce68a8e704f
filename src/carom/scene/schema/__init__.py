"""The scene: everything that a run depends on, as validated data. Each description states the unit.

Sections and keys have the same names as in the TOML file. All are optional, but a scene needs a body or a group.
Unknown keys are refused.
"""

from carom.scene.schema.body import Body as Body
from carom.scene.schema.body import BodyGroup as BodyGroup
from carom.scene.schema.contact import Coefficients as Coefficients
from carom.scene.schema.contact import ContactSettings as ContactSettings
from carom.scene.schema.contact import Drag as Drag
from carom.scene.schema.contact import Gravity as Gravity
from carom.scene.schema.contact import Material as Material
from carom.scene.schema.part_of_space import Region as Region
from carom.scene.schema.promise import Expect as Expect
from carom.scene.schema.promise import Promise as Promise
from carom.scene.schema.quantity import LARGEST as LARGEST
from carom.scene.schema.settings import Time as Time
