"""What surrounds the bodies in a 3D view."""

from __future__ import annotations

from carom.recording.schema.header import Header
from carom.recording.schema.paths import PERIODIC_BOX, PLANES, WALLS


def surroundings(header: Header) -> list[str]:
    """Return the entities of planes, walls and periodic box that the scene has."""
    parts = ((PLANES, header.planes), (WALLS, header.walls), (PERIODIC_BOX, header.box))
    return [path for path, part in parts if part is not None]
