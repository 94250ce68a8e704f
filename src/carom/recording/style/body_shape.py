"""How bodies are drawn: as ellipsoids, or if there are many as a mesh or points."""

from __future__ import annotations

from carom.recording.schema.header import Header

MOST_ELLIPSOIDS = 2000  # above, wireframes cost the viewer 16 to 25 times what points cost


def shape(header: Header) -> str:
    """Return how bodies are drawn: "ellipsoids", or if there are many "mesh" (with orientations) or "points"."""
    if header.bodies <= MOST_ELLIPSOIDS:
        return "ellipsoids"
    return "mesh" if header.has_orientation else "points"
