"""What each contact of a frame did, as columns beside the edges of the collision graph, and as arrows."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import rerun as rr
from numpy.typing import NDArray
from rerun import ComponentColumn

from carom.contact_table import CONTACT_ROW, NO_ROWS
from carom.physics.aligned import picked
from carom.physics.frame import Frame
from carom.recording.schema.paths import FORCE_FRICTION, FORCE_NORMAL
from carom.recording.style import impulse_scale
from carom.recording.style.arrows import part_of_longest
from carom.recording.style.single_precision import single
from carom.recording.write import encoding_kernels as encoding
from carom.recording.write.columns import any_column, vector_column
from carom.recording.write.rows import Index, Rows, array_bytes, frame_rows

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


class BatchContacts:
    """The contacts and impacts of a batch of frames, where they lie.

    Attributes
    ----------
    addresses
        (frames, 6), see `encoding_kernels.locate`.
    edges, contacts, impacts
        (frames,) how many edges of the graph, `CONTACT_ROW` of contacts and of impacts each frame has.
    """

    def __init__(self, batch: Sequence[Frame]) -> None:
        self.addresses = np.empty((len(batch), 6), dtype=np.int64)
        self._arrays = [_contiguous(frame) for frame in batch]  # kept as long as their addresses
        for arrays, addresses in zip(self._arrays, self.addresses, strict=True):
            pairs, normals, overlaps, colours, rows, impacts = arrays
            encoding.locate(pairs, normals, overlaps, colours, rows, impacts, addresses)
        counts = [(len(pairs), len(rows), len(impacts)) for pairs, *_, rows, impacts in self._arrays]
        self.edges, self.contacts, self.impacts = np.array(counts, dtype=np.int64).T.copy()

    def middles(self) -> FloatArray:
        """Return the middle of each frame's scale in N s, (frames,): the median of its impulses that are not zero."""
        middle = np.empty(len(self.contacts))
        encoding.middles(self.addresses, self.contacts, np.empty(self.contacts.max()), middle)
        return middle

    def strongest_impacts(self, counts: IntArray) -> tuple[NDArray[np.void], IntArray]:
        """Return the impacts of the largest normal impulses in order of time, and which of each frame they are.

        Of equal ones these are the first. ``counts`` says how many of each frame, (frames,).
        """
        return self._strongest(encoding.IMPACTS, self.impacts, counts)

    def strongest_contacts(self, counts: IntArray) -> NDArray[np.void]:
        """Return the contacts of the largest normal impulses of each frame, the largest first; of equal ones the first.

        ``counts`` says how many of each frame, (frames,).
        """
        rows, _ = self._strongest(encoding.ROWS, self.contacts, counts)
        return picked(rows, np.lexsort((-rows["normal_impulse"], np.repeat(np.arange(len(counts)), counts))))

    def _strongest(self, column: int, each: IntArray, counts: IntArray) -> tuple[NDArray[np.void], IntArray]:
        total = int(counts.sum())
        chosen, rows = np.empty(total, dtype=np.int64), np.empty(total, CONTACT_ROW)
        encoding.pick_strongest(self.addresses, column, each, counts, np.empty(each.max()), chosen)
        encoding.gather(self.addresses, column, counts, chosen, rows)
        return rows, chosen


def _contiguous(frame: Frame) -> tuple[NDArray[Any], ...]:
    graph = frame.contacts
    rows = NO_ROWS if frame.contact_rows is None else frame.contact_rows
    impacts = NO_ROWS if frame.impacts is None else frame.impacts
    arrays = graph.pairs, graph.normals, graph.overlaps, graph.colours, rows, impacts
    return tuple(map(np.ascontiguousarray, arrays))


def contact_columns(
    contacts: BatchContacts, middle: FloatArray, radius: FloatArray
) -> tuple[list[ComponentColumn], int]:
    """Return columns with a value for each edge, and their bytes.

    Contacts that opened within the step have no edge and are left out.

    Parameters
    ----------
    middle
        (frames,) N s, the middle of each frame's scale.
    radius
        (n,) m.
    """
    edges = contacts.edges
    count = int(edges.sum())
    ends, mode = np.empty((count, 2), dtype=np.uint32), np.empty(count, dtype=np.uint8)
    impulses = np.empty((2, count), dtype=np.float32)
    colour, width = np.empty(count, dtype=np.uint32), np.empty(count, dtype=np.float32)
    encoding.write_contacts(
        contacts.addresses,
        edges,
        contacts.contacts,
        middle,
        impulse_scale.COLOURS,
        impulse_scale.edge_radii(radius),
        *(ends, impulses[0], impulses[1], mode, colour, width),
    )
    columns: list[ComponentColumn] = [
        any_column("bodies", ends.ravel(), 2 * edges),
        any_column("normal_impulse", impulses[0], edges),
        any_column("tangential_impulse", impulses[1], edges),
        any_column("mode", mode, edges),
        any_column("impulse_colour", colour, edges),
        any_column("impulse_width", width, edges),
    ]
    return columns, array_bytes(ends, impulses, mode, colour, width)


def force_rows(
    index: Index,
    contacts: BatchContacts,
    middle: FloatArray,
    drawn: IntArray,
    longest: float,
    origin: FloatArray,
    friction: bool,
) -> Iterable[Rows]:
    """Draw the normal and the friction impulses on body j as arrows at the contact point.

    Parameters
    ----------
    middle
        (frames,) N s, the middle of each frame's scale.
    drawn
        (frames,) how many contacts of each frame, those of the largest normal impulses.
    longest
        m.
    origin
        (3,) m, of what is drawn.
    friction
        Whether friction is modelled.
    """
    rows = contacts.strongest_contacts(drawn)
    middle = np.repeat(middle, drawn)
    at = single(np.stack([rows["x"], rows["y"], rows["z"]], axis=1) - origin)
    ends = np.stack([rows["i"], rows["j"]], axis=1).astype(np.uint32)
    normal = np.stack([rows["nx"], rows["ny"], rows["nz"]], axis=1) * rows["normal_impulse"][:, None]
    tangential = np.stack([rows["friction_x"], rows["friction_y"], rows["friction_z"]], axis=1)
    for path, impulse in ((FORCE_NORMAL, normal), (FORCE_FRICTION, tangential)):
        if path == FORCE_FRICTION and not friction:
            continue
        arrows = _drawn(impulse, middle, longest)
        columns = [
            vector_column(rr.Arrows3D.descriptor_vectors(), arrows, drawn),
            vector_column(rr.Arrows3D.descriptor_origins(), at, drawn),
            any_column("bodies", ends.ravel(), 2 * drawn),
        ]
        yield frame_rows(path, index, columns, array_bytes(arrows, at, ends))


def _drawn(impulse: FloatArray, middle: FloatArray, longest: float) -> NDArray[np.float32]:
    """Return arrows (k, 3) m of impulses (k, 3) N s, by the law of `carom.recording.style.arrows`."""
    size = np.sqrt(np.einsum("ki,ki->k", impulse, impulse))
    length = longest * part_of_longest(size, middle)
    scale = np.divide(length, size, out=np.zeros_like(size), where=size > 0.0)
    return single(impulse * scale[:, None])
