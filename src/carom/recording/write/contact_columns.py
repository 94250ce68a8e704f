"""What each contact of a frame did, as columns beside the edges of the collision graph, and as arrows."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
import rerun as rr
from numpy.typing import NDArray
from rerun import ComponentColumnList

from carom.physics.contact.contact_table import CONTACT_ROW
from carom.physics.frame import Frame
from carom.recording.schema.paths import FORCE_FRICTION, FORCE_NORMAL
from carom.recording.view import impulse_scale
from carom.recording.write import encoding_kernels as encoding
from carom.recording.write.rows import Rows, any_column, array_bytes, frame_rows

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


def contact_rows(batch: Sequence[Frame]) -> NDArray[np.void]:
    """Return the contacts of all frames, (k,) `CONTACT_ROW`, one frame's after another's."""
    found = [frame.contact_rows for frame in batch if frame.contact_rows is not None]
    return np.concatenate(found) if found else np.empty(0, CONTACT_ROW)


def contact_columns(
    batch: Sequence[Frame], rows: NDArray[np.void], pairs: IntArray, radius: FloatArray
) -> tuple[ComponentColumnList, int]:
    """Return columns with a value for each edge, and their bytes.

    Contacts that opened within the step have no edge and are left out.

    Parameters
    ----------
    rows
        (k,) `CONTACT_ROW` of all frames, those of each sorted by pair.
    pairs
        (m, 2), of the edges of all frames, likewise.
    radius
        (n,) m.
    """
    edges = np.array([len(frame.contacts.pairs) for frame in batch], dtype=np.int64)
    each = np.array([0 if f.contact_rows is None else len(f.contact_rows) for f in batch], dtype=np.int64)
    ends, mode = np.empty((len(pairs), 2), dtype=np.uint32), np.empty(len(pairs), dtype=np.uint8)
    impulses = np.empty((2, len(pairs)), dtype=np.float32)
    colour, width = np.empty(len(pairs), dtype=np.uint32), np.empty(len(pairs), dtype=np.float32)
    encoding.write_contacts(
        *(edges, pairs, each, rows, middles(batch), impulse_scale.COLOURS, impulse_scale.edge_radii(radius)),
        *(ends, impulses[0], impulses[1], mode, colour, width),
    )
    columns = [
        *any_column("bodies", ends.ravel()).partition(2 * edges),
        *any_column("normal_impulse", impulses[0]).partition(edges),
        *any_column("tangential_impulse", impulses[1]).partition(edges),
        *any_column("mode", mode).partition(edges),
        *any_column("impulse_colour", colour).partition(edges),
        *any_column("impulse_width", width).partition(edges),
    ]
    return ComponentColumnList(columns), array_bytes(ends, impulses, mode, colour, width)


def force_rows(
    batch: Sequence[Frame], drawn: Sequence[int], longest: float, origin: FloatArray, friction: bool
) -> Iterable[Rows]:
    """Draw the normal and the friction impulses on body j as arrows at the contact point.

    Parameters
    ----------
    drawn
        How many contacts of each frame, those of the largest normal impulses.
    longest
        m.
    origin
        (3,) m, of what is drawn.
    friction
        Whether friction is modelled.
    """
    chosen = [strongest(frame.contact_rows, count) for frame, count in zip(batch, drawn, strict=True)]
    rows = np.concatenate(chosen)
    each = np.array([len(part) for part in chosen], dtype=np.int64)
    middle = np.repeat(middles(batch), each)
    at = (np.stack([rows["x"], rows["y"], rows["z"]], axis=1) - origin).astype(np.float32)
    ends = np.stack([rows["i"], rows["j"]], axis=1).astype(np.uint32)
    normal = np.stack([rows["nx"], rows["ny"], rows["nz"]], axis=1) * rows["normal_impulse"][:, None]
    tangential = np.stack([rows["friction_x"], rows["friction_y"], rows["friction_z"]], axis=1)
    for path, impulse in ((FORCE_NORMAL, normal), (FORCE_FRICTION, tangential)):
        if path == FORCE_FRICTION and not friction:
            continue
        vectors = _drawn(impulse, middle, longest)
        columns = [
            *rr.Arrows3D.columns(vectors=vectors, origins=at).partition(each),
            *any_column("bodies", ends.ravel()).partition(2 * each),
        ]
        yield frame_rows(path, batch, ComponentColumnList(columns), array_bytes(vectors, at, ends))


def middles(batch: Sequence[Frame]) -> FloatArray:
    """Return the impulse (N s) in the middle of each frame's scale: the median of those that are not zero."""
    return np.array([_median(frame.contact_rows) for frame in batch])


def _median(rows: NDArray[np.void] | None) -> float:
    impulses = np.empty(0) if rows is None else rows["normal_impulse"]
    positive = impulses[impulses > 0.0]
    return max(float(np.median(positive)), np.finfo(np.float64).tiny) if len(positive) else 1.0


def strongest(rows: NDArray[np.void] | None, count: int) -> NDArray[np.void]:
    """Return the contacts of the largest normal impulses, the largest first; of equal ones the first."""
    if rows is None:
        return np.empty(0, CONTACT_ROW)
    return rows[np.argsort(-rows["normal_impulse"], kind="stable")[:count]]


def _drawn(impulse: FloatArray, middle: FloatArray, longest: float) -> NDArray[np.float32]:
    """Return arrows (k, 3) m of impulses (k, 3) N s, by the law of `carom.recording.view.arrows`."""
    size = np.sqrt(np.einsum("ki,ki->k", impulse, impulse))
    s = np.cbrt(size / middle)
    length = longest * (1.0 - 1.0 / (1.0 + s))
    scale = np.divide(length, size, out=np.zeros_like(size), where=size > 0.0)
    return np.asarray(impulse * scale[:, None], dtype=np.float32)
