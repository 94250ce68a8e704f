"""Magnified spaces, in which views show small scenes.

Rerun's camera sees nothing nearer than 0.01 units (Rerun 0.41), and cannot be told otherwise: grains of a millimetre
would be invisible in metres. A view of such a scene therefore has an entity as its origin whose transform shrinks by a
power of ten, so that everything else is larger in the space of the view. The numbers in the file stay as they are.
"""

from __future__ import annotations

import math

import rerun as rr
import rerun.blueprint as rrb

from carom.recording.schema import paths

NEAREST = 0.5  # units, of the camera from what it looks at: the bodies are seen, and arrows in front of them, too
EVERYTHING = "/"


def space(distance: float) -> str:
    """Return the origin of a view whose camera is this far (m) from what it looks at."""
    if not 0.0 < distance < NEAREST:
        return EVERYTHING
    return f"/{paths.MAGNIFIED}/{math.ceil(math.log10(NEAREST / distance))}"


def scale(origin: str) -> float:
    """Return how much larger than in metres things are in a view with this origin."""
    return 1.0 if origin == EVERYTHING else 10.0 ** int(origin.rpartition("/")[2])


def log_spaces(stream: rr.RecordingStream, layout: rrb.Blueprint) -> None:
    """Write the transforms of the magnified spaces that a layout needs."""
    for origin in sorted(_origins(layout.root_container)):
        stream.log(origin, rr.Transform3D(scale=1.0 / scale(origin)), static=True)


def _origins(part: rrb.Container | rrb.View) -> set[str]:
    """Return the magnified spaces among the origins of the views of a part of a layout."""
    if isinstance(part, rrb.View):
        return {str(part.origin)} if str(part.origin).startswith(f"/{paths.MAGNIFIED}/") else set()
    return set().union(*(_origins(inner) for inner in part.contents))
