"""The entities of a recording, the kinds of its events, and the version of the schema.

The entities of scalars are in the module `series`.
"""

from __future__ import annotations

SCHEMA_VERSION = 6  # schema of recordings; a version of carom reads only the schema that it writes

ABOUT = "about"  # texts for readers without carom
LEGEND = "legend"  # entity of the drawn legend, which a viewer gets in addition
SCENE = "scene"
SCENE_TOML = "scene/toml"
WORLD = "world"
MAGNIFIED = "magnified"  # transforms with which views magnify small scenes
BODIES = "world/bodies"
PLANES = "world/planes"
PLANE_LINES = 13  # lines, in each direction, of the grid that shows a plane
WALLS = "world/walls"  # walls of the domain
SHAPES = "world/shapes"  # walls of other shapes
MOVING = "world/moving"  # parent of an entity for each plane and wall, if any of them moves
PERIODIC_BOX = "world/box"
TORQUE = "world/torque"  # torques of contacts that last
ANGULAR_ACCELERATION = "world/angular_acceleration"
ANGULAR_IMPULSE = "world/angular_impulse"  # angular impulses of impacts
SPIN_CHANGE = "world/spin_change"
CONTACTS = "world/contacts"
FORCE_NORMAL = "world/forces/normal"
FORCE_FRICTION = "world/forces/friction"
IMPACTS = "impacts"
IMPACT_SPINS = "impacts/spins"  # exists on the timeline of impacts only
IMPACT_ENERGY = "impacts.energy"  # not an entity, but a key of the property `arrows`
ENERGY = "energy"
STEPS = "step"
DT_LIMIT = "step/limit"
PHASE = "phase"
EVENTS = "events"
FINGERPRINT = "state/fingerprint"
MOMENTUM = "state/momentum"
CHECKPOINT = "state/checkpoint"
START = "state/start"  # exact state before the first frame of a clip
STATIC_STATE = "state/bodies"
ENTRY = "entry_"  # prefix of the components that state how bodies enter
LIVES = "state/lives"  # steps of the first and the last frame of each body, if bodies come and go
GIVEN_STATE = "scene/bodies"  # the initial bodies of [[bodies]] tables

IMPACT_SUMS = "impact_sums"  # component of contacts: the sums over all impacts since the previous frame
NUMBERS, NUMBERS_AT = "numbers", "numbers_at"  # components of the arrows of few bodies: texts, and their places
FLOOR = "floor"  # component of arrows: the magnitude below which no arrow is drawn
OF_LASTING = (TORQUE, ANGULAR_ACCELERATION)
OF_IMPACTS = (ANGULAR_IMPULSE, SPIN_CHANGE)
PARALLEL = {TORQUE: ANGULAR_ACCELERATION, ANGULAR_IMPULSE: SPIN_CHANGE}  # arrows → arrows with the same directions
WITH_FLOOR = (*OF_LASTING, *OF_IMPACTS, FORCE_NORMAL)
MAGNITUDES = {  # component of an entity's arrows: magnitudes in SI, which lengths show by their cube roots
    TORQUE: "torque",
    ANGULAR_ACCELERATION: "angular_acceleration",
    ANGULAR_IMPULSE: "angular_impulse",
    SPIN_CHANGE: "spin_change",
    FORCE_NORMAL: "normal_impulse",
    FORCE_FRICTION: "tangential_impulse",
}

# components with the centres of drawn bodies
CENTRES = ("Ellipsoids3D:centers", "Points3D:positions", "InstancePoses3D:translations")
CLOSING = frozenset({"extreme", "end"})  # events written when a run ends; a resumed run writes its own
