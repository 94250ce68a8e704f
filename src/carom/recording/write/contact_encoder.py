"""Encodes contacts and impacts: columns for the edges of the collision graph, arrows, and a row for each impact."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import rerun as rr
from numpy.typing import NDArray
from rerun import ComponentColumn

from carom.arrays import FloatArray, IntArray, Records, SingleArray
from carom.contact_table import CONTACT_ROW, NO_ROWS
from carom.errors import RecorderError
from carom.physics.aligned import joined, picked
from carom.recording.layout import drawing
from carom.recording.layout.drawing import part_of_longest, single
from carom.recording.read.recorded_impacts import RecordedImpacts
from carom.recording.schema.header import Header
from carom.recording.schema.paths import (
    FLOOR,
    FORCE_FRICTION,
    FORCE_NORMAL,
    IMPACT_ENERGY,
    IMPACT_SUMS,
    IMPACTS,
    MAGNITUDES,
    OF_IMPACTS,
)
from carom.recording.write import encoding_kernels as encoding
from carom.recording.write.encoding_kernels import EdgeColumns, FrameContacts
from carom.recording.write.impact_frames import Instant, instants, turns_of
from carom.recording.write.impact_plan import ImpactPlan, impact_rows, largest
from carom.recording.write.rows import Index, Rows, any_column, vector_column
from carom.state.checkpoint import Checkpoint
from carom.state.frame import Frame

_ROUNDING = 1e-9  # fraction of the largest magnitude in the recorded frames so far
NO_SUMS = np.empty(0)
_JOINED = 4096  # largest number of edges, contacts and impacts in a block of several frames: 0.6 MB fit into the cache


class BatchContacts:
    """The contacts and impacts of a batch of frames.

    Small frames are joined into blocks, since each call of a kernel takes microseconds; large frames are read in place.
    """

    def __init__(self, batch: Sequence[Frame]) -> None:
        graphs = [frame.contacts for frame in batch]
        rows = [NO_ROWS if frame.contact_rows is None else frame.contact_rows for frame in batch]
        impacts = [NO_ROWS if frame.impacts is None else frame.impacts for frame in batch]
        each = np.array([(len(g.overlaps), len(r), len(i)) for g, r, i in zip(graphs, rows, impacts, strict=True)])
        self.edges, self.contacts, self.impacts = each.T.copy()  # (frames,) numbers of edges, contacts and impacts
        self._frames = list[slice]()  # range of frames in each block
        self.blocks = list[FrameContacts]()  # the arrays of consecutive frames
        begin, size, sizes = 0, 0, each.sum(axis=1).tolist()
        for end, more in enumerate([*sizes[1:], np.inf], start=1):
            size += sizes[end - 1]
            if size + more > _JOINED:
                part = slice(begin, end)
                kept = [(g.pairs, g.normals, g.overlaps, g.colours) for g in graphs[part]]
                arrays = [_in_one(same) for same in zip(*kept, strict=True)]
                records = _in_one(rows[part]), _in_one(impacts[part])
                self.blocks.append(FrameContacts._make([*arrays, *records, each[part]]))
                self._frames.append(part)
                begin, size = end, 0

    def largest(self) -> FloatArray:
        """Return the largest normal impulse of each frame's contacts in N s, (frames,); 0 without contacts."""
        return self._largest([block.rows["normal_impulse"] for block in self.blocks], self.contacts, finite=True)

    def hardest(self) -> FloatArray:
        """Return the largest normal impulse of each frame's impacts in N s, (frames,); 0 without impacts."""
        return self._largest([block.impacts["normal_impulse"] for block in self.blocks], self.impacts, finite=False)

    def _largest(self, parts: Sequence[FloatArray], each: IntArray, *, finite: bool) -> FloatArray:
        found, some = np.zeros(len(each)), each > 0
        values = np.concatenate(parts)
        if finite:
            values[~np.isfinite(values)] = 0.0
        if len(values):
            first = np.cumsum(each) - each
            found[some] = np.maximum(np.maximum.reduceat(values, first[some]), 0.0)
        return found

    def parts(self, each: IntArray) -> Iterator[tuple[FrameContacts, slice, slice]]:
        """Yield each block, the slice of its frames, and its slice of an array that has ``each`` elements per frame."""
        ends = np.concatenate(([0], np.cumsum(each))).tolist()
        for block, frames in zip(self.blocks, self._frames, strict=True):
            yield block, frames, slice(ends[frames.start], ends[frames.stop])

    def middles(self) -> FloatArray:
        """Return the middle of each frame's scale in N s, (frames,): the median of its impulses that are not zero."""
        found, scratch = np.empty(len(self.contacts)), np.empty(self.contacts.max())
        for block, frames, _ in self.parts(self.contacts):
            encoding.find_middles(block, scratch, found[frames])
        return found

    def strongest_impacts(self, counts: IntArray) -> tuple[Records, IntArray]:
        """Return the impacts with the largest normal impulses, in order of time, and their indices in each frame.

        ``counts`` is the number of arrows in each frame, (frames,). Among equal impulses, the first are selected.
        """
        return self._strongest([block.impacts for block in self.blocks], self.impacts, counts)

    def strongest_contacts(self, counts: IntArray) -> Records:
        """Return each frame's contacts with the largest normal impulses, largest first; see `strongest_impacts`."""
        rows, _ = self._strongest([block.rows for block in self.blocks], self.contacts, counts)
        return picked(rows, np.lexsort((-rows["normal_impulse"], np.repeat(np.arange(len(counts)), counts))))

    def _strongest(self, rows: Sequence[Records], each: IntArray, counts: IntArray) -> tuple[Records, IntArray]:
        total, scratch = int(counts.sum()), np.empty(each.max())
        chosen, strongest = np.empty(total, dtype=np.int64), np.empty(total, CONTACT_ROW)
        for of_block, (_, frames, part) in zip(rows, self.parts(counts), strict=True):
            encoding.pick_strongest(of_block, each[frames], counts[frames], scratch, chosen[part], strongest[part])
        return strongest, chosen


def _in_one(arrays: Sequence[NDArray[Any]]) -> NDArray[Any]:
    """Join the arrays of consecutive frames; records are copied as bytes, which NumPy does much faster."""
    if len(arrays) == 1:
        return np.ascontiguousarray(arrays[0])
    kind = arrays[0].dtype
    return joined(arrays, kind) if kind.names else np.concatenate(arrays)


def contact_columns(contacts: BatchContacts, middle: FloatArray, radius: FloatArray) -> list[ComponentColumn]:
    """Return columns with one value per edge, given the middle of each frame's scale, (frames,) N s."""
    edges, widths = contacts.edges, drawing.edge_radii(radius)
    count = int(edges.sum())
    values = EdgeColumns(
        bodies=np.empty((count, 2), dtype=np.uint32),
        normal_impulse=np.empty(count, dtype=np.float32),
        tangential_impulse=np.empty(count, dtype=np.float32),
        mode=np.empty(count, dtype=np.uint8),
        colour=np.empty(count, dtype=np.uint32),
        width=np.empty(count, dtype=np.float32),
    )
    for block, frames, part in contacts.parts(edges):
        of_block = EdgeColumns._make(column[part] for column in values)
        done = encoding.write_contacts(block, middle[frames], drawing.COLOURS, widths, of_block)
        if done < len(block.pairs):
            i, j = block.pairs[done].tolist()
            raise RecorderError(f"the contact of {i} and {j} is in the collision graph, but has no row of its own")
    return [
        any_column("bodies", values.bodies.ravel(), 2 * edges),
        any_column("normal_impulse", values.normal_impulse, edges),
        any_column("tangential_impulse", values.tangential_impulse, edges),
        any_column("mode", values.mode, edges),
        any_column("impulse_colour", values.colour, edges),
        any_column("impulse_width", values.width, edges),
    ]


def force_rows(
    index: Index,
    contacts: BatchContacts,
    middle: FloatArray,
    drawn: IntArray,
    longest: float,
    origin: FloatArray,
    bodies: int,
    friction: bool,
    floors: FloatArray,
    columns: Sequence[ComponentColumn] = (),
) -> Iterable[Rows]:
    """Draw the normal impulses and, with friction, the friction impulses on body j as arrows at the contact point.

    If j is a plane or a wall (a number from ``bodies`` on), the arrows show impulses on body i: normals point out of
    surfaces.

    ``drawn``, (frames,), is the number of contacts in each frame that have arrows, the largest normal impulses first.
    Arrows are shorter than ``longest`` (m). ``middle`` is the middle of the frame's scale (N s); impulses below its
    floor (N s) have arrows without length. ``columns`` are further columns of the normal impulses.
    """
    rows = contacts.strongest_contacts(drawn)
    middle, floors = np.repeat(middle, drawn), np.repeat(floors, drawn)
    at = single(np.stack([rows["x"], rows["y"], rows["z"]], axis=1) - origin)
    ends = np.stack([rows["i"], rows["j"]], axis=1).astype(np.uint32)
    normal = np.stack([rows["nx"], rows["ny"], rows["nz"]], axis=1) * rows["normal_impulse"][:, None]
    tangential = np.stack([rows["friction_x"], rows["friction_y"], rows["friction_z"]], axis=1)
    for path, impulse in ((FORCE_NORMAL, normal), (FORCE_FRICTION, tangential)):
        if path == FORCE_FRICTION and not friction:
            continue
        size = np.sqrt(np.einsum("ki,ki->k", impulse, impulse))
        arrows = _drawn(np.where(rows["j"][:, None] < bodies, impulse, -impulse), size, middle, longest, floors)
        found = [
            vector_column(rr.Arrows3D.descriptor_vectors(), arrows, drawn),
            vector_column(rr.Arrows3D.descriptor_origins(), at, drawn),
            any_column("bodies", ends.ravel(), 2 * drawn),
            any_column(MAGNITUDES[path], single(size), drawn),
            *(columns if path == FORCE_NORMAL else ()),
        ]
        yield Rows(path, index, found)


def _drawn(
    impulse: FloatArray, size: FloatArray, middle: FloatArray, longest: float, floors: FloatArray
) -> SingleArray:
    """Return arrows (k, 3) m of impulses (k, 3) N s and their sizes, by the law of `carom.recording.layout.drawing`."""
    length = longest * part_of_longest(size, middle)
    scale = np.divide(length, size, out=np.zeros_like(size), where=(size > 0.0) & (size >= floors))
    return single(impulse * scale[:, None])


_ROUND_OFF = 1e-12  # fraction of J v_n; smaller energy losses are rounding errors


class ContactEncoder:
    """Converts the contacts and impacts of batches of frames to rows."""

    def __init__(
        self,
        header: Header,
        origin: FloatArray,  # (3,) m, origin of the drawing
        references: drawing.References,  # the first frame with something to draw determines missing references
        floors: ArrowFloors,
        before: RecordedImpacts,  # numbers of impacts before the first frame
        *,
        # whether to encode everything, whatever the scene requests, for a comparison with a recording
        everything: bool,
    ) -> None:
        self.header = header
        self._origin = origin
        self._references = references
        self._floors = floors
        self._plan = ImpactPlan.of(header, everything=everything)
        self._turning = OF_IMPACTS if header.has_torque else ()
        self._count, self._recorded = before.count, before.recorded
        self._shows_bodies = not everything

    @property
    def impacts(self) -> RecordedImpacts:
        """Numbers of impacts in all batches so far."""
        return RecordedImpacts(self._recorded, self._count - self._recorded)

    def columns(self, batch: Sequence[Frame], contacts: BatchContacts, position: FloatArray) -> list[ComponentColumn]:
        """Return the columns for the edges of a batch's frames; bodies are at ``position``, (frames, n, 3) m."""
        self._contacts, self._middle = contacts, contacts.middles()
        counts = contacts.edges, contacts.contacts, contacts.impacts
        self._kept = self._plan.choose(position, *counts, contacts.hardest())
        self._impacts, self._chosen = contacts.strongest_impacts(self._kept.impacts)
        columns = contact_columns(contacts, self._middle, self.header.radius)
        if self.header.engine:  # the engine's bodies may not be spheres: record points, normals and frictions
            rows = np.concatenate([block.rows for block in contacts.blocks])
            for name, prefix in (("point", ""), ("normal", "n"), ("friction", "friction_")):
                vectors = np.stack([rows[f"{prefix}{axis}"] for axis in "xyz"], axis=1)
                values = single(vectors - self._origin if name == "point" else vectors)
                columns.append(any_column(name, values.ravel(), 3 * contacts.contacts))
        numbers = self._count + np.cumsum(contacts.impacts + [frame.impacts_left_out for frame in batch])
        self._before = np.concatenate(([self._count], numbers[:-1]))
        self._count = int(numbers[-1])
        if not self.header.engine:
            sums = [NO_SUMS if frame.impact_sums is None else frame.impact_sums for frame in batch]
            columns.append(any_column(IMPACT_SUMS, np.concatenate(sums), np.array([len(each) for each in sums])))
        return [*columns, any_column("impact_count", numbers)]

    def rows(self, index: Index) -> Iterable[Rows]:
        """Return arrows and impacts of the last encoded batch."""
        header, kept, impacts = self.header, self._kept, self._impacts
        longest = drawing.arrow_length(header, FORCE_NORMAL)
        floors = self._floors.raised(FORCE_NORMAL, self._contacts.largest())
        # the row is written even without arrows, to clear the contacts of the previous frame
        yield from force_rows(
            *(index, self._contacts, self._middle, kept.arrows, longest),
            *(self._origin, header.bodies, header.has_friction, floors, [any_column(FLOOR, floors)]),
        )
        self._recorded += len(impacts)
        if len(impacts):
            # if the contact tap left some impacts out, the numbers apply to the stored impacts
            numbers = np.repeat(self._before, kept.impacts) + 1 + self._chosen
            yield impact_rows(impacts, numbers, self._references, header, self._origin)

    def instants(self, batch: Sequence[Frame], before: Frame | Checkpoint | None) -> list[Instant]:
        """Return the states at the impacts of the last batch that get a frame, given the frame before the batch."""
        found = list[Instant]()
        first = np.cumsum(self._kept.impacts) - self._kept.impacts  # index of the first chosen impact of each frame
        for f in np.flatnonzero(self._kept.scenes).tolist() if self._shows_bodies else ():
            frame, last, count = batch[f], batch[f - 1] if f else before, self._before[f]
            if last is None or frame.impacts is None or frame.time <= last.time:
                continue
            chosen = self._chosen[first[f] : first[f] + self._kept.impacts[f]]
            chosen = chosen[largest(frame.impacts[chosen], int(self._kept.scenes[f]))]
            found += instants(self.header, last, frame, frame.impacts, chosen, count + 1 + chosen)
        return found

    def look(self, impacts: Records | None) -> None:
        """Choose the references of arrows from the first impacts that have something to draw."""
        chosen, wanted = self._references.chosen, (IMPACTS, IMPACT_ENERGY, *self._turning)
        if impacts is None or len(impacts) == 0 or all(name in chosen for name in wanted):
            return
        lost = impacts["restitution_loss"] + impacts["friction_loss"]
        lost = lost[lost > _ROUND_OFF * impacts["normal_impulse"] * impacts["approach_speed"]]
        scales = {IMPACTS: impacts["normal_impulse"], IMPACT_ENERGY: lost}
        if self._turning:
            # N m s; ``most`` is the angular impulse that a coefficient of friction of 1 would give
            turns, most = turns_of(impacts), impacts["arm_i"] * impacts["normal_impulse"]
            size = drawing.magnitudes(turns.reshape(-1, 3)).reshape(-1, 2)
            size[size <= _ROUND_OFF * most[:, None]] = 0.0
            inertia = np.append(self.header.inertia, np.inf)  # a plane has infinite inertia
            ends = np.minimum(np.stack([impacts["i"], impacts["j"]], axis=1), self.header.bodies)
            scales |= dict(zip(self._turning, (size, size / inertia[ends]), strict=True))
        for name, values in scales.items():
            positive = values[values > 0.0]
            if name not in chosen and len(positive):
                self._references.choose(name, max(float(np.median(positive)), np.finfo(np.float64).tiny))


class ArrowFloors:
    """The magnitudes below which arrows of a recording are not drawn, by the entity of the arrows.

    The largest magnitude of a run is known only at its end, so floors rise with the largest magnitude so far. Each
    frame contains its floors, so a replay or a resumed run that begins at a later frame has the floors of the whole
    run.
    """

    def __init__(self, before: Mapping[str, float]) -> None:
        self._last = dict(before)

    def raised(self, path: str, largest: FloatArray) -> FloatArray:
        """Raise the floors by the largest magnitudes (frames,) of the next frames; return these frames' floors."""
        found = self.alone(largest)
        found[:1] = np.maximum(found[:1], self._last.get(path, 0.0))
        found = np.maximum.accumulate(found)
        self._last[path] = float(found[-1])
        return found

    def alone(self, largest: FloatArray) -> FloatArray:
        """Return floors for frames that do not depend on earlier frames."""
        return _ROUNDING * largest
