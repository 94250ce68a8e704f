"""Paths of the entities of a recording, those of scalars apart (`series`), and the version of the schema."""

SCHEMA_VERSION = 3  # 3: impacts, and what contacts did; 2: runs can be resumed; 1: checkpoints could only be read

SCENE = "scene"
SCENE_TOML = "scene/toml"
WORLD = "world"
MAGNIFIED = "magnified"  # transforms, by which views magnify small scenes
BODIES = "world/bodies"
PLANES = "world/planes"
PLANE_LINES = 13  # of the grid that shows a plane, in each direction
WALLS = "world/walls"
PERIODIC_BOX = "world/box"
TORQUE = "world/torque"
ANGULAR_ACCELERATION = "world/angular_acceleration"
CONTACTS = "world/contacts"
FORCE_NORMAL = "world/forces/normal"
FORCE_FRICTION = "world/forces/friction"
IMPACTS = "impacts"
IMPACT_ENERGY = "impacts.energy"  # no entity: in the property `arrows`
ENERGY = "energy"
STEP = "step"
DT_LIMIT = "step/limit"
PHASE = "phase"
EVENTS = "events"
FINGERPRINT = "state/fingerprint"
MOMENTUM = "state/momentum"
CHECKPOINT = "state/checkpoint"
START = "state/start"  # in a clip: the exact state that its first frame follows from
STATIC_STATE = "state/bodies"
GIVEN_STATE = "scene/bodies"  # the bodies of [[bodies]] at time 0

CENTRES = ("Ellipsoids3D:centers", "Points3D:positions", "InstancePoses3D:translations")  # whichever it is drawn as
