"""The longest arrow of each entity."""

from __future__ import annotations

from carom.recording.schema.header import Header
from carom.recording.schema.paths import ANGULAR_ACCELERATION, FORCE_FRICTION, FORCE_NORMAL, TORQUE
from carom.recording.style import arrows, impulse_scale

_REACH = {  # L_max in median body radii
    TORQUE: arrows.TORQUE_REACH,
    ANGULAR_ACCELERATION: arrows.ANGULAR_ACCELERATION_REACH,
    FORCE_NORMAL: impulse_scale.REACH,
    FORCE_FRICTION: impulse_scale.REACH,
}


def arrow_length(header: Header, path: str) -> float:
    """Return L_max (m) of the arrows at an entity."""
    return arrows.longest(header.radius, _REACH[path])
