"""What is drawn at a moment of a recording or during the whole run, so that the legend names nothing else."""

from __future__ import annotations

from itertools import product

import numpy as np
import pyarrow as pa

from carom.arrays import FloatArray
from carom.physics.frame import Frame
from carom.recording.layout import bodies_view, drawing
from carom.recording.read.recording import Recording
from carom.recording.schema import paths
from carom.recording.schema.header import Header
from carom.show.legend import Drawn

_AROUND = np.array([v for v in product((-1.0, 0.0, 1.0), repeat=3) if any(v)])
_AROUND /= np.linalg.norm(_AROUND, axis=1)[:, None]
_ROUNDING = 1e-9  # of the largest normal impulse; friction below it is rounding, and not drawn


def drawn_during(recording: Recording, header: Header) -> Drawn:
    """Return what is drawn at some time of a run; ``header`` is that of its layout."""
    records = header.records_contacts
    impacts = records and any(entry.rows for entry in recording.store.frames_of(paths.IMPACTS))
    rubs = records and header.has_friction and _has_arrows(recording, paths.FORCE_FRICTION)
    torques = header.has_torque and _has_arrows(recording, paths.TORQUE)
    return Drawn(header.collides, records, rubs, impacts, torques)


def _has_arrows(recording: Recording, path: str) -> bool:
    """Return whether a recorded arrow of an entity has a length."""
    entries = [entry for entry in recording.store.entries if entry.entity_path == path and not entry.is_static]
    for chunk in recording.chunks(entries):
        vectors: pa.Array = chunk.batch["Arrows3D:vectors"].flatten().flatten()
        if np.any(vectors.to_numpy()):
            return True
    return False


def drawn_at(frame: Frame, header: Header) -> Drawn:
    """Return what is drawn at the end of a step, or at an instant, but for points of impacts."""
    rows = frame.contact_rows if header.records_contacts else None
    largest = 0.0 if rows is None or not len(rows) else float(rows["normal_impulse"].max())
    rubs = False
    if rows is not None and largest > 0.0 and header.has_friction:
        friction = np.stack([rows["friction_x"], rows["friction_y"], rows["friction_z"]])
        rubs = bool(np.abs(friction).max() > _ROUNDING * largest)
    torques = header.has_torque and frame.torque is not None and bool(np.any(frame.torque))
    return Drawn(len(frame.contacts.pairs) > 0, largest > 0.0, rubs, torques=torques)


def impact_marks(recording: Recording, header: Header, moment: float | None = None) -> FloatArray:
    """Return points (k, 3) m around the points that views draw at impacts, at a time (s) or during the whole run."""
    if not header.records_contacts:
        return np.zeros((0, 3))
    since = None if moment is None else max(0.0, moment - bodies_view.OF_LATE * header.duration)
    table = recording.impacts(since, moment)
    places = np.stack([table[axis].to_numpy() for axis in "xyz"], axis=1) - recording.origin
    reference = recording.arrow_references.get(paths.IMPACTS, 1.0)
    radii = drawing.point_radii(header.radius)[drawing.level(table["normal_impulse"].to_numpy(), reference)]
    return np.asarray(places[:, None] + radii[:, None, None] * _AROUND, dtype=np.float64).reshape(-1, 3)
