"""Overrides by which a view draws bodies: in other colours than the recorded ones, and with a least size on the screen.

Spheres have their true radii in metres. If that is less than two points of the screen at the camera's distance, the
view also draws a dot of fixed size at the body's centre. It takes the recorded centres, so the file does not grow.
"""

from __future__ import annotations

import numpy as np
import rerun as rr
from numpy.typing import NDArray
from rerun.blueprint.api import VisualizerLike
from rerun.blueprint.encodings import ComponentSourceKind, VisualizerComponentMapping
from rerun.encodings import EntityPathLike

from carom.recording.layout.camera import View
from carom.recording.layout.canvas import Area
from carom.recording.schema import paths
from carom.recording.schema.header import Header
from carom.recording.style.body_shape import shape

LEAST = 2.0  # points of the screen, the radius of a dot
_HIDDEN = 1e-12  # of a body's radius; size of the dot if the body is large enough

Overrides = dict[EntityPathLike, VisualizerLike | list[VisualizerLike]]


def drawn_bodies(header: Header, view: View, area: Area, recoloured: bool = False) -> Overrides:
    """Return overrides that add dots to small bodies, and take the colours of a `Supplement` if ``recoloured``."""
    apparent = header.radius / view.height() * area.height  # points
    small = apparent < LEAST
    if not (small.any() or recoloured):
        return {}
    # negative radii are in points of the screen (Rerun)
    dots = np.where(small, -LEAST, _HIDDEN * header.radius).astype(np.float32)
    sizes = np.where(small, -LEAST, header.radius).astype(np.float32)
    match shape(header):
        case "ellipsoids":
            colours = "Points3D:colors" if recoloured else "Ellipsoids3D:colors"
            spheres = rr.Ellipsoids3D.from_fields().visualizer(mappings=_from({"Ellipsoids3D:colors": colours}))
            return {paths.BODIES: [spheres, *([_points(dots, "Ellipsoids3D:centers", colours)] if small.any() else [])]}
        case "points":
            colours = "Ellipsoids3D:colors" if recoloured else "Points3D:colors"
            return {paths.BODIES: _points(sizes, "Points3D:positions", colours)}
        case _ if recoloured:  # the instances of a mesh have one colour
            return {paths.BODIES: _points(sizes, "InstancePoses3D:translations", "Points3D:colors")}
        case _:
            return {}


def _points(radii: NDArray[np.float32], centres: str, colours: str) -> VisualizerLike:
    mappings = _from({"Points3D:positions": centres, "Points3D:colors": colours})
    return rr.Points3D.from_fields(radii=radii).visualizer(mappings=mappings)


def _from(sources: dict[str, str]) -> list[VisualizerComponentMapping]:
    """Map each component of a visualizer to the one that it is taken from."""
    return [
        VisualizerComponentMapping(target, ComponentSourceKind.SourceComponent, source_component=source)
        for target, source in sources.items()
    ]
