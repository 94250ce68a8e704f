"""Gives bodies that are too small to be seen a least size on the screen.

A sphere has its true radius in metres. Where that is less than a point of the screen at the camera's distance, the view
draws a dot of fixed size at the body's centre as well, from the recorded centres: it costs no byte of the recording.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import rerun as rr
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

Overrides = Mapping[EntityPathLike, VisualizerLike | list[VisualizerLike]]


def with_specks(header: Header, view: View, area: Area) -> Overrides:
    """Return overrides that add dots, if there are bodies that need one."""
    apparent = header.radius / view.height() * area.height  # points
    small = apparent < LEAST
    if not small.any():
        return {}
    # Rerun takes negative radii as points of the screen
    radii = np.where(small, -LEAST, _HIDDEN * header.radius).astype(np.float32)
    match entities.shape(header):
        case "ellipsoids":
            return {paths.BODIES: [rr.Ellipsoids3D.from_fields().visualizer(), dots(radii, "Ellipsoids3D")]}
        case "points":
            size = np.where(small, -LEAST, header.radius).astype(np.float32)
            return {paths.BODIES: rr.Points3D.from_fields(radii=size)}
        case _:
            return {}


def dots(radii: np.ndarray[tuple[int], np.dtype[np.float32]], drawn_as: str) -> VisualizerLike:
    """Return a visualizer that draws the centres of ellipsoids as points."""
    sources = (("Points3D:positions", f"{drawn_as}:centers"), ("Points3D:colors", f"{drawn_as}:colors"))
    mappings = [
        VisualizerComponentMapping(target, ComponentSourceKind.SourceComponent, source_component=source)
        for target, source in sources
    ]
    return rr.Points3D.from_fields(radii=radii).visualizer(mappings=mappings)
