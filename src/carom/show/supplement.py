"""`Supplement`: rows and a layout that a viewer gets on top of a recording; the file does not change.

Among them are trails, the paths of a few bodies up to the moment that is shown, and other colours of the bodies.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from carom.arrays import ColourArray, IntArray, SingleArray
from carom.errors import RecordingError
from carom.recording.layout import colouring
from carom.recording.layout.bodies_view import TRAILS
from carom.recording.layout.camera import FEW, CameraFit
from carom.recording.layout.drawing import shape
from carom.recording.read.frame_rows import drawn_paths
from carom.recording.read.recording import Recording
from carom.recording.schema import paths
from carom.recording.schema.header import STATIC_COLOURS, Header
from carom.recording.schema.paths import STEP
from carom.recording.schema.time_scale import TimeScale
from carom.recording.write.durable_sink import FLUSH
from carom.recording.write.rerun_compat import send_layout
from carom.recording.write.rows import Index, Rows
from carom.show.shown_step import ShownStep

Static = tuple[str, rr.AsComponents]


@dataclass(frozen=True, slots=True)
class Supplement:
    """Rows, static data and a layout, sent to a viewer that shows the recording."""

    layout: rrb.Blueprint
    clock: TimeScale  # of the recording
    rows: Sequence[Rows] = ()
    statics: Sequence[Static] = ()

    def send(self, address: str, application: str, recording_id: str) -> None:
        """Send it to the recording of these ids in the viewer at an address."""
        self._put(rr.GrpcSink(address), application, recording_id)

    def save(self, path: Path, application: str, recording_id: str) -> None:
        """Write it to a file, which a viewer loads on top of the recording of these ids."""
        self._put(rr.FileSink(path), application, recording_id)

    def _put(self, sink: rr.GrpcSink | rr.FileSink, application: str, recording_id: str) -> None:
        with rr.RecordingStream(application, recording_id=recording_id, send_properties=False) as stream:
            stream.set_sinks(sink)
            for path, archetype in self.statics:
                stream.log(path, archetype, static=True)
            for rows in self.rows:
                stream.send_columns(rows.path, self.clock.columns(*rows.index), rows.columns)
            send_layout(stream, application, self.layout)
            stream.flush(timeout_sec=FLUSH)
            stream.disconnect()


_MOST_FRAMES = 2000  # longer paths take every k-th frame
_POINTS = 1000  # of a path that is drawn as a curve through fewer frames: integrators of high order take long steps


class Trails:
    """The paths of all bodies of a recording, as pieces from frame to frame.

    Where nothing ever touched, a piece is a part of the cubic spline through all frames.
    """

    def __init__(self, recording: Recording, header: Header) -> None:
        drawn = drawn_paths(recording, range(len(header.radius)))
        table = recording.fingerprints()
        rows = np.minimum(np.searchsorted(table[STEP].to_numpy(), drawn.steps), table.num_rows - 1)
        every = -(-len(drawn.steps) // _MOST_FRAMES)
        self._steps = drawn.steps[::every]
        self._times = table["time"].to_numpy()[rows][::every]
        self._position = drawn.position[::every]
        self._box = header.box
        untouched = recording.closing.get("contacts.total") == 0 and header.box is None
        self._is_smooth = untouched and bool((np.diff(self._times) > 0.0).all())
        by = header.coloured_by
        self._colours = header.static_colours(by if by in STATIC_COLOURS else "group")[recording.shown]

    def show(self, camera: CameraFit, until: float = np.inf) -> None:
        """Fit a camera to the paths up to a time (s), which are drawn, in a direction that suits all of the motion."""
        position, past = self._position.astype(np.float64), self._times <= until
        camera.look(position[past])
        camera.look(position[~past], inside=False)

    def statics(self) -> Iterable[Static]:
        """Yield the colours of the bodies."""
        yield TRAILS, rr.LineStrips3D.from_fields(colors=self._colours, radii=rr.Radius.ui_points(0.75))

    def rows(self) -> Iterable[Rows]:
        """Yield the pieces, each at the frame where it ends; pieces through the border of a box have no length."""
        pieces, bodies = len(self._times) - 1, self._position.shape[1]
        if pieces < 1:
            return
        points = self._points(-(-_POINTS // pieces) if self._is_smooth else 1)
        strips = points.transpose(0, 2, 1, 3).reshape(pieces * bodies, -1, 3)
        columns = rr.LineStrips3D.columns(strips=list(strips)).partition([bodies] * pieces)
        yield Rows(TRAILS, Index(self._steps[1:], self._times[1:]), columns, strips.nbytes)

    def _points(self, parts: int) -> SingleArray:
        """Return the points of all pieces, (pieces, parts + 1, n, 3) m."""
        begin, end = self._position[:-1], self._position[1:]
        if self._box is not None:
            end = np.where(np.abs(end - begin) > self._box / 2, begin, end)
        if parts == 1:
            return np.stack([begin, end], axis=1)
        from scipy.interpolate import CubicSpline  # noqa: PLC0415 - slow to import, and most commands draw no trails

        times = self._times[:-1, np.newaxis] + np.diff(self._times)[:, np.newaxis] * np.linspace(0.0, 1.0, parts + 1)
        curve: SingleArray = CubicSpline(self._times, self._position)(times).astype(np.float32)
        return curve


def has_trails(recording: Recording) -> bool:
    """Return whether a recording has few enough bodies for their paths to be legible."""
    return len(recording.shown) <= FEW and recording.frames > 1


_MOST = 30_000_000  # bodies times frames
_CONTACT_ENDS = "LineStrips3D:strips"


def colour_rows(recording: Recording, header: Header, by: str, step: ShownStep) -> list[Rows]:
    """Return the colours of the bodies at all frames and at repeated steps.

    Raises
    ------
    RecordingError
        If the recording lacks the data for them.
    """
    n = len(header.radius)
    if n * recording.frames > _MOST:
        raise RecordingError(f"{recording.path} is too long to be coloured by {by}; cut a piece with `carom clip`")
    if by == "material" and header.materials is None:
        raise RecordingError(f"{recording.path} has no [[material]] to colour by; take group")
    if by in STATIC_COLOURS:
        first = recording.fingerprints()
        fixed = header.static_colours(by)[recording.shown]
        found = iter([(int(first[STEP][0].as_py()), float(first["time"][0].as_py()), fixed)])
    elif by == "speed":
        found = _by_speed(recording, header, step)
    else:
        if not header.collides:
            raise RecordingError(f"{recording.path} has no contacts to colour by {by}; take group or speed")
        found = _by_contacts(recording, n, by, step)
    steps, times, colours = (list(column) for column in zip(*found, strict=True))
    flat = np.concatenate(colours)
    # Rerun prefers static values of the same component, so these colours belong to another archetype
    archetype = rr.Points3D if shape(header) != "points" else rr.Ellipsoids3D
    return [
        Rows(
            paths.BODIES,
            Index(np.array(steps), np.array(times)),
            archetype.columns(colors=flat).partition([n] * len(steps)),
            flat.nbytes,
        )
    ]


def _by_speed(recording: Recording, header: Header, step: ShownStep) -> Iterator[tuple[int, float, ColourArray]]:
    """Yield speeds from distances between frames; speeds of repeated steps are exact."""
    drawn = drawn_paths(recording, range(len(header.radius)))
    steps, times = _times(recording, drawn.steps)
    if len(times) < 2:
        raise RecordingError(f"{recording.path} has only one frame, which tells no speed; colour by something else")
    mass = header.mass[recording.shown]
    velocity = np.gradient(drawn.position.astype(np.float64), np.maximum.accumulate(times), axis=0)
    speed = np.stack([colouring.speeds(velocity[row], mass) for row in range(len(velocity))])
    reference = float(np.median(speed[np.isfinite(speed)]))
    for row, (number, time) in enumerate(zip(steps, times, strict=True)):
        yield number, time, colouring.speed_colours(speed[row], reference)
    for frame in step.added:
        exact = colouring.speeds(frame.velocity, mass)
        yield frame.step, frame.time, colouring.speed_colours(exact, reference)


def _by_contacts(recording: Recording, n: int, by: str, step: ShownStep) -> Iterator[tuple[int, float, ColourArray]]:
    colours_of = colouring.graph_colours if by == "graph" else colouring.island_colours
    drawn = drawn_paths(recording, range(n))
    steps, times = _times(recording, drawn.steps)
    ends = _contact_ends(recording)
    for number, time, position in zip(steps, times, drawn.position, strict=True):
        yield number, time, colours_of(_pairs(ends.get(number), position), n)
    for frame in step.added:
        yield frame.step, frame.time, colours_of(frame.contacts.pairs, n)


def _times(recording: Recording, steps: IntArray) -> tuple[list[int], list[float]]:
    table = recording.fingerprints()
    rows = np.searchsorted(table[STEP].to_numpy(), steps)
    times = table["time"].to_numpy()[np.minimum(rows, table.num_rows - 1)]
    return steps.tolist(), times.tolist()


def _contact_ends(recording: Recording) -> dict[int, SingleArray]:
    """Return the ends of the drawn edges, (m, 2, 3), by step."""
    found: dict[int, SingleArray] = {}
    entries = [e for e in recording.store.entries if e.entity_path == paths.CONTACTS and e.first_step is not None]
    for chunk in recording.chunks(entries):
        if _CONTACT_ENDS not in chunk.components:
            continue
        column = chunk.batch[_CONTACT_ENDS]
        for row, number in enumerate(chunk.batch[STEP].to_pylist()):
            values = column[row].values.flatten().flatten()
            found[number] = np.asarray(values.to_numpy(), dtype=np.float32).reshape(-1, 2, 3)
    return found


def _pairs(ends: SingleArray | None, position: SingleArray) -> IntArray:
    """Find the bodies that edges join: the ends of an edge equal their centres bit by bit, or lie on a plane."""
    if ends is None or len(ends) == 0:
        return np.zeros((0, 2), dtype=np.int64)
    n = len(position)
    known = {centre.tobytes(): body for body, centre in enumerate(position)}
    pairs = [(known.get(a.tobytes(), n), known.get(b.tobytes(), n)) for a, b in ends]
    joined = np.array(sorted((i, j) for i, j in pairs if i < n), dtype=np.int64).reshape(-1, 2)
    return np.asarray(np.sort(joined, axis=1))
