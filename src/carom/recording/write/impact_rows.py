"""Impacts, each as a row at its own time, and the bodies at the moments of some of them."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from carom.recording.schema.paths import IMPACT_ENERGY, IMPACTS
from carom.recording.style import impulse_scale
from carom.recording.style.single_precision import single
from carom.recording.write.columns import any_column, plain_column, vector_column
from carom.recording.write.rows import Index, Rows, array_bytes

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

_INDEX_BYTES = 24  # of a row: step, time and number


def impact_rows(
    impacts: NDArray[np.void],
    numbers: IntArray,
    references: Mapping[str, float],
    radius: FloatArray,
    origin: FloatArray,
) -> Rows:
    """Return one row for each impact.

    Parameters
    ----------
    impacts
        (k,) `CONTACT_ROW`, at least one.
    numbers
        (k,) their places among all impacts of the run, from 1 on.
    references
        The impulse (N s) and the energy (J) in the middle of their scales.
    radius
        (n,) m.
    origin
        (3,) m, of what is drawn.
    """
    point = np.stack([impacts["x"], impacts["y"], impacts["z"]], axis=1) - origin
    friction = np.stack([impacts["friction_x"], impacts["friction_y"], impacts["friction_z"]])
    lost = impacts["restitution_loss"] + impacts["friction_loss"]
    sizes = impulse_scale.point_radii(radius)
    positions = single(point)
    radii = sizes[impulse_scale.level(impacts["normal_impulse"], references.get(IMPACTS, 1.0))]
    colours = impulse_scale.COLOURS[impulse_scale.level(lost, references.get(IMPACT_ENERGY, np.inf))]
    bodies = np.stack([impacts["i"], impacts["j"]], axis=1).astype(np.uint32)
    normal = single(np.stack([impacts["nx"], impacts["ny"], impacts["nz"]], axis=1))
    scalars = {
        "approach_speed": impacts["approach_speed"],
        "normal_impulse": impacts["normal_impulse"],
        "tangential_impulse": np.sqrt(np.sum(friction * friction, axis=0)),
        "energy_lost": lost,
    }
    rounded = {name: single(values) for name, values in scalars.items()}
    mode = np.ascontiguousarray(impacts["mode"])
    columns = [
        vector_column(rr.Points3D.descriptor_positions(), positions),
        plain_column(rr.Points3D.descriptor_radii(), radii),
        plain_column(rr.Points3D.descriptor_colors(), colours),
        any_column("bodies", bodies.ravel(), 2),
        any_column("normal", normal.ravel(), 3),
        *(any_column(name, values) for name, values in rounded.items()),
        any_column("mode", mode),
    ]
    size = array_bytes(positions, radii, colours, bodies, normal, mode, *rounded.values()) + _INDEX_BYTES * len(impacts)
    steps, times = np.ascontiguousarray(impacts["step"]), np.ascontiguousarray(impacts["time"])
    return Rows(IMPACTS, Index(steps, times, numbers), columns, size)
