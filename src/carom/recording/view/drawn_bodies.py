"""How the bodies are drawn in a view: in other colours than the recorded ones, and with a least size on the screen.

A sphere has its true radius in metres. Where that is less than two points of the screen at the camera's distance, the
view draws a dot of fixed size at the body's centre as well, from the recorded centres: it costs no byte of the
recording.
"""

from __future__ import annotations

import numpy as np
import rerun as rr
from numpy.typing import NDArray
from rerun.blueprint.api import VisualizerLike
from rerun.blueprint.encodings import ComponentSourceKind, VisualizerComponentMapping
from rerun.encodings import EntityPathLike

from carom.recording.schema import paths
from carom.recording.schema.header import Header
from carom.recording.view.camera import View
from carom.recording.view.canvas import Area
from carom.recording.write import encoder as entities

LEAST = 2.0  # points of the screen, the radius of a dot
_HIDDEN = 1e-12  # of a body's radius: the dot of a body that is large enough

Overrides = dict[EntityPathLike, VisualizerLike | list[VisualizerLike]]


def drawn_bodies(header: Header, view: View, area: Area, recoloured: bool = False) -> Overrides:
    """Return overrides that add dots to bodies that need one, and take the colours that were sent, if any were."""
    apparent = header.radius / view.height() * area.height  # points
    small = apparent < LEAST
    if not (small.any() or recoloured):
        return {}
    # Rerun takes negative radii as points of the screen
    dots = np.where(small, -LEAST, _HIDDEN * header.radius).astype(np.float32)
    sizes = np.where(small, -LEAST, header.radius).astype(np.float32)
    match entities.shape(header):
        case "ellipsoids":
            colours = "Points3D:colors" if recoloured else "Ellipsoids3D:colors"
            spheres = rr.Ellipsoids3D.from_fields().visualizer(mappings=_from({"Ellipsoids3D:colors": colours}))
            return {paths.BODIES: [spheres, *([_points(dots, "Ellipsoids3D:centers", colours)] if small.any() else [])]}
        case "points":
            colours = "Ellipsoids3D:colors" if recoloured else "Points3D:colors"
            return {paths.BODIES: _points(sizes, "Points3D:positions", colours)}
        case _ if recoloured:  # a mesh has one colour for all
            return {paths.BODIES: _points(sizes, "InstancePoses3D:translations", "Points3D:colors")}
        case _:
            return {}


def _points(radii: NDArray[np.float32], centres: str, colours: str) -> VisualizerLike:
    mappings = _from({"Points3D:positions": centres, "Points3D:colors": colours})
    return rr.Points3D.from_fields(radii=radii).visualizer(mappings=mappings)


def _from(sources: dict[str, str]) -> list[VisualizerComponentMapping]:
    """Say which component each component of a visualizer is taken from."""
    return [
        VisualizerComponentMapping(target, ComponentSourceKind.SourceComponent, source_component=source)
        for target, source in sources.items()
    ]
