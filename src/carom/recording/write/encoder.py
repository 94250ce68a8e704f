"""Frames encoded as rows of a recording."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pyarrow as pa
import rerun as rr
from numpy.typing import NDArray
from rerun import ComponentColumn

from carom.arrays import ColourArray, FloatArray, IntArray, Records, SingleArray
from carom.errors import RecorderError
from carom.physics.contact.graph import colour_bodies
from carom.physics.frame_store import FrameStore
from carom.physics.vector import minimum_images
from carom.recording.layout import drawing, is_crowded
from carom.recording.layout.drawing import arrow_length, shape, single
from carom.recording.read.recorded_impacts import RecordedImpacts
from carom.recording.schema import checkpoint_columns, palette, paths
from carom.recording.schema.curve_outline import CurveOutline
from carom.recording.schema.header import Header
from carom.recording.schema.paths import FLOOR
from carom.recording.schema.series import IN_PLOT, Sample, Series, recorded
from carom.recording.write import encoding_kernels as encoding
from carom.recording.write.contact_encoder import (
    ArrowFloors,
    BatchContacts,
    ContactEncoder,
    contact_columns,
    force_rows,
)
from carom.recording.write.encoding_kernels import Arrows, TorqueList
from carom.recording.write.impact_frames import STEPPING, Instant, spin_rows
from carom.recording.write.rows import (
    NO_STEPS,
    BatchColumn,
    Index,
    Rows,
    any_column,
    event_rows,
    line_column,
    plain_column,
    state_rows,
    vector_column,
)
from carom.recording.write.wall_places import moving_walls, piston_rows, wall_rows
from carom.state.checkpoint import Checkpoint
from carom.state.frame import Frame

SPEED = "speed"  # key in the property `arrows`: the speed (m/s) in the middle of the colour scale
NO_IMPACTS = RecordedImpacts()
_LABELLED = 6  # largest number of arrows in a frame with labels of their magnitudes; more would cover other arrows
_BEYOND = 0.8  # distance of a label beyond the tip, in radii, since a viewer draws a label below its place


class BatchEncoder:
    """Converts batches of frames to rows, entity by entity.

    Besides the batch, the rows depend only on the state of the encoder: the origin, the last written phase and dt
    limit, the references of the arrows, the last frame, and the numbers of recorded contacts. ``curves`` are the
    outlines of the series encoded so far.
    """

    def __init__(
        self,
        header: Header,
        origin: FloatArray,  # (3,) m, origin of the drawing
        # state after the earlier rows, for a resumed run
        arrow_references: Mapping[str, float] | None = None,
        last_state: Mapping[str, str] | None = None,
        before: Checkpoint | None = None,
        *,
        impacts_before: RecordedImpacts = NO_IMPACTS,
        floors_before: Mapping[str, float] | None = None,
        everything: bool = False,  # whether to encode every impact, for a comparison with a recording
    ) -> None:
        self.header = header
        self.origin = origin
        self.arrow_references = drawing.References(arrow_references or {})
        self._floors = ArrowFloors(floors_before or {})
        self._last_state = dict(last_state or {})
        self._recorded = tuple(recorded(header))
        self.curves = {series.path: CurveOutline() for series in self._recorded}
        self._before: Frame | Checkpoint | None = before
        self._contacts = (
            ContactEncoder(header, origin, self.arrow_references, self._floors, impacts_before, everything=everything)
            if header.records_contacts
            else None
        )
        self._walls = moving_walls(header) if header.drives else {}
        self._box = np.zeros(3) if header.box is None else np.asarray(header.box, dtype=np.float64)

    def extend(self, header: Header) -> None:
        """Encode later frames with more bodies, which are drawn like the bodies so far."""
        self.header = replace(header, drawn_as=drawing.shape(self.header))
        if self._contacts:
            self._contacts.header = self.header

    @property
    def impacts(self) -> RecordedImpacts | None:
        """Number of impacts recorded so far; None if the scene records none."""
        return self._contacts.impacts if self._contacts else None

    def rows(self, batch: Sequence[Frame], store: FrameStore | None = None) -> Iterable[Rows]:
        """Return the rows of all entities of a batch, without checkpoints. In a ``store``, frames are consecutive."""
        refuse_wrong_arrays(self.header, batch, self._before)
        index, position = Index.of(batch), _stacked("position", batch, store)
        points = np.empty((len(batch), self.header.bodies, 3), dtype=np.float32)
        encoding.cast_positions(position, self.origin, points)
        _leave_out(batch, points)
        turned = None
        if self.header.has_orientation:
            turned = np.empty((len(batch) * self.header.bodies, 4), dtype=np.float32)
            encoding.cast_orientations(_stacked("orientation", batch, store), turned.reshape(len(batch), -1, 4))
        yield Rows(paths.BODIES, index, self._drawn(points.reshape(-1, 3), turned, self._node_colours(batch)))
        yield from wall_rows(self._walls, index, self.origin)
        yield from piston_rows(self.header, index, batch)
        self._look(frame.impacts for frame in batch)
        yield from self._turning(index, batch, points, store)
        extremes = np.zeros((len(batch), 3))
        if self.header.collides:
            contacts = BatchContacts(batch)
            columns = self._edges(contacts, points, extremes, index.times.tolist())
            columns += self._contacts.columns(batch, contacts, position) if self._contacts else []
            yield Rows(paths.CONTACTS, index, columns)
        found = list[Instant]()
        if self._contacts:
            yield from self._contacts.rows(index)
            found = self._contacts.instants(batch, self._before)
        yield from self._series(index, batch, extremes)
        for rows in self.at_impacts(found):
            if rows.path in self.curves:
                column, *_ = rows.columns
                self.curves[rows.path].insert(rows.index.times, column.as_arrow_array().flatten().to_numpy())
            yield rows
        yield from self._changes(paths.DT_LIMIT, batch, lambda frame: frame.dt_limit)
        yield from self._changes(paths.PHASE, batch, lambda frame: frame.phase)
        if events := [event for frame in batch for event in frame.events]:
            yield event_rows(events)
        bits = np.array([frame.fingerprint for frame in batch], dtype=np.uint64)
        yield Rows(paths.FINGERPRINT, index, [any_column("fingerprint", bits), any_column("time", index.times)])
        # an error is NaN where it is not defined
        linear = np.array([f.momentum_error for f in batch], dtype=np.float64)
        angular = np.array([f.angular_momentum_error for f in batch], dtype=np.float64)
        columns = [
            any_column("momentum", np.concatenate([frame.momentum for frame in batch]), 3),
            any_column("momentum_error", linear),
            any_column("angular_momentum", np.concatenate([frame.angular_momentum for frame in batch]), 3),
            any_column("angular_momentum_error", angular),
        ]
        yield Rows(paths.MOMENTUM, index, columns)

    def checkpoints(self, frames: Sequence[Frame]) -> Rows:
        """Encode the exact state of some frames."""
        encoded = checkpoint_columns.encode([frame.checkpoint for frame in frames])
        columns = [any_column(name, values, np.array(each)) for name, (values, each) in encoded.items()]
        return Rows(paths.CHECKPOINT, Index.of(frames), columns)

    def at_impacts(self, found: Sequence[Instant]) -> Iterable[Rows]:
        """Draw the states at some impacts; these rows have a time and the number of an impact, but no step."""
        if not found:
            return
        numbers, ends = np.array([one.number for one in found]), np.array([one.end for one in found])
        frames = [one.frame for one in found]
        index = Index(NO_STEPS, np.array([frame.time for frame in frames]), numbers, ends)
        points = single(np.stack([frame.position for frame in frames]) - self.origin)
        _leave_out(frames, points)
        turned = [frame.orientation for frame in frames if frame.orientation is not None]
        turns = single(np.concatenate(turned)) if turned else None
        yield Rows(paths.BODIES, index, self._drawn(points.reshape(-1, 3), turns, None))
        yield from wall_rows(self._walls, index, self.origin)
        contacts = BatchContacts(frames)
        edges = self._edges(contacts, points, np.zeros((len(found), 3)), index.times.tolist())
        self._look(frame.contact_rows for frame in frames)
        yield from self._turning(index, frames, points)
        middle = contacts.middles()
        yield Rows(paths.CONTACTS, index, [*edges, *contact_columns(contacts, middle, self.header.radius)])
        longest = arrow_length(self.header, paths.FORCE_NORMAL)
        rubs, floors = self.header.has_friction, self._floors.alone(contacts.largest())
        drawn = contacts.contacts, longest, self.origin, self.header.bodies
        yield from force_rows(index, contacts, middle, *drawn, rubs, floors)
        twice = Index(NO_STEPS, np.repeat(index.times, 2), np.repeat(numbers, 2), np.repeat(ends, 2))
        energies = np.concatenate([one.energies for one in found])
        for series in self._recorded:
            if series.path in STEPPING:
                values = np.ascontiguousarray(energies[:, STEPPING.index(series.path)])
                yield Rows(series.path, twice, self._scalars(series, values))
        yield from spin_rows(self.header, found, points)

    def _look(self, impacts: Iterable[Records | None]) -> None:
        """Choose the references of impact arrows from the first impacts."""
        if self._contacts:
            for each in impacts:
                self._contacts.look(each)

    def _drawn(
        self, centres: SingleArray, turned: SingleArray | None, colours: NDArray[np.uint32] | None
    ) -> list[ComponentColumn]:
        """Return the columns that draw all bodies, row after row."""
        n = self.header.bodies
        scales = None
        match shape(self.header):
            case "ellipsoids":
                kind: Any = rr.Ellipsoids3D
                places = kind.descriptor_centers()
            case "points":
                kind, turned = rr.Points3D, None
                places = kind.descriptor_positions()
            case _:
                # each instance needs a scale, since the default is 1; one colour is enough for all
                kind, colours = rr.InstancePoses3D, None
                places = kind.descriptor_translations()
                scales = single(np.tile(np.repeat(self.header.radius, 3), len(centres) // n).reshape(-1, 3))
        columns: list[ComponentColumn] = [vector_column(places, centres, n)]
        if turned is not None:
            columns.append(vector_column(kind.descriptor_quaternions(), turned, n))
        if colours is not None:
            columns.append(plain_column(kind.descriptor_colors(), colours, n))
        if scales is not None:
            columns.append(vector_column(kind.descriptor_scales(), scales, n))
        return columns

    def _node_colours(self, batch: Sequence[Frame]) -> NDArray[np.uint32] | None:
        n = self.header.bodies
        match self.header.coloured_by:
            case "group" | "material":
                return None
            case "speed":
                speeds = [drawing.speeds(frame.velocity, self.header.mass) for frame in batch]
                if SPEED not in self.arrow_references.chosen:
                    self.arrow_references.choose(SPEED, float(np.median(speeds[0])))
                return np.concatenate([drawing.speed_colours(each, self.arrow_references[SPEED]) for each in speeds])
            case "island":
                return np.concatenate([drawing.island_colours(frame.contacts.pairs, n) for frame in batch])
        if not self.header.body_colouring:
            return np.concatenate([graph_colours(frame.contacts.pairs, n) for frame in batch])
        nobody = np.full(n, -1, dtype=np.int64)
        nodes = [f.contacts.body_colours if f.contacts.body_colours is not None else nobody for f in batch]
        return palette.node_colours(np.concatenate(nodes))

    def _turning(
        self, index: Index, frames: Sequence[Frame], points: SingleArray, store: FrameStore | None = None
    ) -> Iterable[Rows]:
        """Return the arrows that show what turns bodies: torques of lasting contacts, and angular impulses of impacts.

        The arrows of τ/I and of the changes of spin are drawn beside them. Frames of the run raise the floors of later
        frames; frames at impacts do not, since no body has a torque there.
        """
        raises = len(index.steps) > 0
        if self.header.has_torque:
            torques = _listed("torque", frames, store)
            for path in paths.OF_LASTING:
                yield self._arrow_rows(path, index, frames, torques, points, raises=raises)
        if self.header.has_torque and self.header.records_contacts:
            turns = _listed("angular_impulse", frames)
            for path in paths.OF_IMPACTS:
                yield self._arrow_rows(path, index, frames, turns, points, raises=raises)

    def _arrow_rows(
        self,
        path: str,
        index: Index,
        frames: Sequence[Frame],
        turning: TorqueList,
        points: SingleArray,
        *,
        raises: bool,  # whether these frames raise the floors of later frames
    ) -> Rows:
        """Return arrows of one kind, without arrows of rounding noise."""
        inertia = np.ones(self.header.bodies) if path in (paths.TORQUE, paths.ANGULAR_IMPULSE) else self.header.inertia
        turning, floors = self._above_floor(path, turning, inertia, raises)
        each, body, magnitude = turning.each, turning.body, turning.magnitude
        if len(body) and path in paths.OF_LASTING and path not in self.arrow_references.chosen:
            k = int(np.flatnonzero(each)[0])
            first, frame, natural = magnitude[: each[k]] / inertia[body[: each[k]]], frames[k], 0.0
            if frame.dt > 0:  # reference: the torque that stops a body in one step, or its angular acceleration
                drift = frame.velocity - np.average(frame.velocity, axis=0, weights=self.header.mass)
                natural = float(
                    np.median(self.header.mass * self.header.radius * drawing.magnitudes(drift) / frame.dt / inertia)
                )
            self.arrow_references.choose(path, drawing.reference(first, natural))
        unit, longest = self.arrow_references.get(path, 1.0) * inertia, arrow_length(self.header, path)
        arrows = Arrows(*np.empty((2, len(body), 3), dtype=np.float32))
        encoding.draw_arrows(turning, points, self.header.radius, unit, longest, arrows)
        columns = [
            vector_column(rr.Arrows3D.descriptor_vectors(), arrows.vector, each),
            vector_column(rr.Arrows3D.descriptor_origins(), arrows.origin, each),
            any_column("body", body, each),
            any_column(paths.MAGNITUDES[path], single(magnitude / inertia[body]), each),
            any_column(FLOOR, floors),
        ]
        if path in paths.PARALLEL and not is_crowded(self.header):
            columns += self._numbers(path, turning, arrows)
        return Rows(path, index, columns)

    def _numbers(self, path: str, turning: TorqueList, arrows: Arrows) -> list[ComponentColumn]:
        """Return both magnitudes of each arrow as a text; in a frame with many arrows, only the largest have a text."""
        written, units = [""] * len(turning.body), self.header.units
        other, ends = paths.PARALLEL[path], np.cumsum(turning.each)
        turns = turning.magnitude / self.header.inertia[turning.body]
        for start, end in zip((ends - turning.each).tolist(), ends.tolist(), strict=True):
            for k in start + np.argsort(-turning.magnitude[start:end], kind="stable")[:_LABELLED]:
                both = ((path, turning.magnitude[k]), (other, turns[k]))
                written[k] = ", ".join(units.text(size, drawing.DIMENSIONS[which], ".3g") for which, size in both)
        radius = self.header.radius[turning.body]
        reach = 1.0 + _BEYOND * radius / np.maximum(drawing.magnitudes(arrows.vector.astype(np.float64)), radius)
        places = arrows.origin + single(reach)[:, None] * arrows.vector
        return [
            BatchColumn(rr.ComponentDescriptor(paths.NUMBERS), pa.array(written, pa.utf8()), turning.each),
            vector_column(rr.ComponentDescriptor(paths.NUMBERS_AT), places, turning.each),
        ]

    def _above_floor(
        self, path: str, turning: TorqueList, inertia: FloatArray, raises: bool
    ) -> tuple[TorqueList, FloatArray]:
        """Keep the torques τ whose τ/I reaches the floor of their arrows; return them and the floors, (frames,)."""
        frame = np.repeat(np.arange(len(turning.each)), turning.each)
        with np.errstate(over="ignore"):
            size = turning.magnitude / inertia[turning.body]
        largest = np.zeros(len(turning.each))
        np.maximum.at(largest, frame, np.where(np.isfinite(size), size, 0.0))
        floors = self._floors.raised(path, largest) if raises else self._floors.alone(largest)
        kept = size >= floors[frame]
        if kept.all():
            return turning, floors
        each = np.bincount(frame[kept], minlength=len(largest))
        return TorqueList(turning.torque, each, turning.body[kept], turning.magnitude[kept]), floors

    def _edges(
        self, contacts: BatchContacts, points: SingleArray, extremes: FloatArray, times: Sequence[float]
    ) -> list[ComponentColumn]:
        """Return the columns that draw edges; fill in the extremes of each frame, see `encoding_kernels.draw_edges`."""
        count = int(contacts.edges.sum())
        strips, shown = np.empty((count, 6), dtype=np.float32), np.empty(count, dtype=np.uint32)
        for block, frames, part in contacts.parts(contacts.edges):
            encoding.draw_edges(
                *(block, points[frames], self.header.radius, self._box, palette.STAGE_COLOURS),
                *(strips[part], shown[part], extremes[frames]),
            )
            last = part.start
            for f in range(frames.start, frames.stop) if self.header.shear else ():
                first, last = last, last + int(contacts.edges[f])
                i, j = block.pairs[first - part.start : last - part.start].T
                cell, ends = self.header.cell(times[f]), points[f].astype(np.float64)
                assert cell is not None
                strips[first:last, 3:] = ends[i] + minimum_images(ends[j] - ends[i], cell)
        colours = plain_column(rr.LineStrips3D.descriptor_colors(), shown, contacts.edges)
        return [line_column(strips, contacts.edges), colours]

    def _series(self, index: Index, batch: Sequence[Frame], extremes: FloatArray) -> Iterable[Rows]:
        before, self._before = [self._before, *batch[:-1]], batch[-1]
        energies = [frame.energy for frame in batch]
        rows = zip(batch, before, extremes.tolist(), energies, strict=True)
        mass, radius = self.header.mass, self.header.radius
        samples = [
            Sample(frame, last, overlap, relative, colours, energy, mass, radius)
            for frame, last, (overlap, relative, colours), energy in rows
        ]
        for series in self._recorded:
            try:
                values = np.array([series.value(sample) for sample in samples], dtype=np.float64)
            except Exception as error:
                # the function of the series may belong to another package
                raise RecorderError(f"the series {series.path}: {type(error).__name__}: {error}") from error
            self.curves[series.path].see(index.times, values)
            yield Rows(series.path, index, self._scalars(series, values))

    def _scalars(self, series: Series, values: FloatArray) -> list[ComponentColumn]:
        """Return the columns of a series: its values, and the values in the unit of its plot if that unit differs."""
        columns = [plain_column(rr.Scalars.descriptor_scalars(), values)]
        factor = self.header.plot_factor(series.unit)
        in_plot = factor != 1.0 and series.plot is not None
        return [*columns, any_column(IN_PLOT, values / factor)] if in_plot else columns

    def _changes(self, path: str, batch: Sequence[Frame], state: Callable[[Frame], str]) -> Iterable[Rows]:
        """Yield rows only for frames whose state differs from the state of the previous frame."""
        changed = []
        for frame in batch:
            if self._last_state.get(path) != state(frame):
                self._last_state[path] = state(frame)
                changed.append(frame)
        if changed:
            yield state_rows(path, Index.of(changed), [state(frame) for frame in changed])


def _leave_out(frames: Sequence[Frame], points: SingleArray) -> None:
    """Remove waiting bodies from the drawn centres, (frames, n, 3)."""
    for frame, drawn in zip(frames, points, strict=True):
        if (waits := frame.waits) is not None:
            drawn[waits] = np.nan


def graph_colours(pairs: IntArray, bodies: int) -> ColourArray:
    """Return the colours of the reference engine: touching bodies differ, and bodies without contacts are grey."""
    return palette.node_colours(colour_bodies(np.ascontiguousarray(pairs, dtype=np.int64), bodies)[1])


def _listed(name: str, frames: Sequence[Frame], store: FrameStore | None = None) -> TorqueList:
    """List the bodies with a torque or an angular impulse, frame by frame; most frames have no angular impulses."""
    there = [each for frame in frames if (each := getattr(frame, name)) is not None]
    if len(there) < len(frames) or not (store is not None or any(each.any() for each in there)):
        none = np.zeros((0, 0, 3)), np.zeros(len(frames), dtype=np.int64), np.empty(0, dtype=np.uint32), np.empty(0)
        return TorqueList(*none)
    vectors = _stacked(name, frames, store)
    most = vectors.shape[0] * vectors.shape[1]
    each, body, magnitude = np.zeros(len(vectors), dtype=np.int64), np.empty(most, dtype=np.uint32), np.empty(most)
    total = encoding.list_torques(TorqueList(vectors, each, body, magnitude))
    return TorqueList(vectors, each, body[:total], magnitude[:total])


def _stacked(name: str, batch: Sequence[Frame], store: FrameStore | None) -> FloatArray:
    """Return one of the arrays of all frames, (frames, n, …), as a view of the store or a copy."""
    first = batch[0].slot
    if store is not None and first is not None:
        lying: FloatArray = getattr(store, name)[first : first + len(batch)]
        return lying
    return np.stack([getattr(frame, name) for frame in batch])


def refuse_wrong_arrays(header: Header, batch: Sequence[Frame], before: Frame | Checkpoint | None) -> None:
    """Raise RecorderError if an array has a wrong length, or a contact names no body; ``before`` is the last frame."""
    n = header.bodies
    expected: list[tuple[str, Any, tuple[int, ...]]]  # the name of each array, its values and their shape
    expected = [(f"the recording's {name}", getattr(header, name), (n,)) for name in ("radius", "inertia")]
    widths = {"position": 3, "velocity": 3}
    widths |= {"orientation": 4} if header.has_orientation else {}
    widths |= {"torque": 3} if header.has_torque else {}
    for frame in batch:
        graph, step, edges = frame.contacts, f"step {frame.step}: ", len(frame.contacts.pairs)
        expected += [(step + name, getattr(frame, name), (n, width)) for name, width in widths.items()]
        for name, inner in (("pairs", (2,)), ("normals", (3,)), ("overlaps", ()), ("colours", ())):
            expected.append((f"{step}{name} of contacts", getattr(graph, name), (edges, *inner)))
        if graph.body_colours is not None:
            expected.append((f"{step}colours of bodies", graph.body_colours, (n,)))
        if frame.impacts is not None and len(frame.impacts) and before is not None:
            expected.append((f"step {before.step}, before impacts: position", before.position, (n, 3)))
        for called, values, wanted in expected:
            if values is None or values.shape != wanted:
                raise RecorderError(f"{called} has the shape {getattr(values, 'shape', None)} instead of {wanted}")
        if edges and (graph.pairs.min() < 0 or graph.pairs[:, 0].max() >= n):  # planes and walls come second in a pair
            raise RecorderError(f"{step}a contact has a wrong body number; bodies are 0 to {n - 1}")
        before, expected = frame, []
