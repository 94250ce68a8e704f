"""What each contact of a frame did, as columns beside the edges of the collision graph, and as arrows."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
import rerun as rr
from numpy.typing import NDArray
from rerun import ComponentColumnList

from carom.physics.aligned import joined, picked
from carom.physics.contact.contact_table import CONTACT_ROW
from carom.physics.frame import Frame
from carom.recording.schema.paths import FORCE_FRICTION, FORCE_NORMAL
from carom.recording.view import impulse_scale
from carom.recording.write import encoding_kernels as encoding
from carom.recording.write.rows import Rows, any_column, array_bytes, frame_rows, single

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

_NOTHING = np.empty(0, dtype=np.int64)


class BatchContacts(NamedTuple):
    """The contacts of a batch of frames."""

    rows: NDArray[np.void]  # (k,) CONTACT_ROW, one frame's after another's; those of each sorted by pair
    each: IntArray  # (frames,) how many each has
    middle: FloatArray  # (frames,) N s, the middle of its scale: the median of the impulses that are not zero

    @classmethod
    def of(cls, batch: Sequence[Frame]) -> BatchContacts:
        """Gather the contacts of a batch."""
        parts = [frame.contact_rows for frame in batch if frame.contact_rows is not None]
        rows = joined(parts, CONTACT_ROW)
        each = np.array([0 if f.contact_rows is None else len(f.contact_rows) for f in batch], dtype=np.int64)
        middle = np.empty(len(batch))
        encoding.middles(rows, each, np.empty(len(rows)), middle)
        return cls(rows, each, middle)

    def strongest(self, counts: Sequence[int]) -> list[IntArray]:
        """Return of each frame the rows of the largest normal impulses, the largest first; of equal ones the first."""
        impulses, ends = -self.rows["normal_impulse"], np.cumsum(self.each).tolist()
        starts = [0, *ends[:-1]]
        return [
            lo + np.argsort(impulses[lo:hi], kind="stable")[:count] if count else _NOTHING
            for lo, hi, count in zip(starts, ends, counts, strict=True)
        ]


def contact_columns(
    batch: Sequence[Frame], contacts: BatchContacts, pairs: IntArray, radius: FloatArray
) -> tuple[ComponentColumnList, int]:
    """Return columns with a value for each edge, and their bytes.

    Contacts that opened within the step have no edge and are left out.

    Parameters
    ----------
    pairs
        (m, 2), of the edges of all frames, sorted in each.
    radius
        (n,) m.
    """
    edges = np.array([len(frame.contacts.pairs) for frame in batch], dtype=np.int64)
    ends, mode = np.empty((len(pairs), 2), dtype=np.uint32), np.empty(len(pairs), dtype=np.uint8)
    impulses = np.empty((2, len(pairs)), dtype=np.float32)
    colour, width = np.empty(len(pairs), dtype=np.uint32), np.empty(len(pairs), dtype=np.float32)
    encoding.write_contacts(
        edges,
        pairs,
        contacts.each,
        contacts.rows,
        contacts.middle,
        impulse_scale.COLOURS,
        impulse_scale.edge_radii(radius),
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
    batch: Sequence[Frame],
    contacts: BatchContacts,
    drawn: Sequence[int],
    longest: float,
    origin: FloatArray,
    friction: bool,
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
    chosen = contacts.strongest(drawn)
    rows, each = picked(contacts.rows, np.concatenate(chosen)), np.array([len(part) for part in chosen], dtype=np.int64)
    middle = np.repeat(contacts.middle, each)
    at = single(np.stack([rows["x"], rows["y"], rows["z"]], axis=1) - origin)
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


def _drawn(impulse: FloatArray, middle: FloatArray, longest: float) -> NDArray[np.float32]:
    """Return arrows (k, 3) m of impulses (k, 3) N s, by the law of `carom.recording.view.arrows`."""
    size = np.sqrt(np.einsum("ki,ki->k", impulse, impulse))
    s = np.cbrt(size / middle)
    length = longest * (1.0 - 1.0 / (1.0 + s))
    scale = np.divide(length, size, out=np.zeros_like(size), where=size > 0.0)
    return single(impulse * scale[:, None])
