"""The colours of the bodies in a recording. No other module decides the colour of a body in a view or plot.

The 3D views, the close-up, trails and curves of single bodies all use `BodyColours`. If colours change with time (by
speed, graph or island), curves have other colours.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import rerun as rr

from carom.arrays import ColourArray, FloatArray, IntArray, SingleArray
from carom.display.request import ShownStep
from carom.errors import RecordingError
from carom.recording.layout import drawing
from carom.recording.layout.drawing import shape
from carom.recording.read.entities import reading
from carom.recording.read.frame_rows import drawn_paths, times_of
from carom.recording.read.recorded_scene import header_of_recording
from carom.recording.read.recording import Recording
from carom.recording.schema import palette, paths
from carom.recording.schema.header import STATIC_COLOURS, Header
from carom.recording.timelines import STEP
from carom.recording.write.encoder import graph_colours
from carom.recording.write.rows import Index, Rows

_MOST = 30_000_000  # largest product of bodies and frames for which changing colours are computed
_CONTACT_ENDS = "LineStrips3D:strips"
_RECORDED = ("Ellipsoids3D:colors", "Points3D:colors")


@dataclass(frozen=True, slots=True)
class BodyColours:
    """The colours of all bodies that a recording shows, as its views draw them."""

    steps: IntArray  # (k,) steps of the frames at which colours may change; one frame if they are constant
    times: FloatArray  # (k,) s, times of these frames
    colours: ColourArray  # (k, n) 0xRRGGBBAA

    @property
    def fixed(self) -> ColourArray | None:
        """The colours (n,) if they are the same for the whole run; otherwise None."""
        return self.colours[0] if len(self.steps) == 1 else None

    def on(self, theme: str) -> BodyColours:
        """Return these colours adapted to a background, "dark" or "light"."""
        shown = palette.legible(self.colours.ravel(), theme).reshape(self.colours.shape)
        return BodyColours(self.steps, self.times, shown)

    def of(self, places: Sequence[int]) -> BodyColours:
        """Return the colours of the bodies at the given indices among the shown bodies."""
        return BodyColours(self.steps, self.times, self.colours[:, list(places)])

    def rows(self, header: Header) -> Rows:
        """Return rows that draw the bodies in these colours instead of the recorded colours."""
        flat, n = self.colours.ravel(), self.colours.shape[1]
        # static values of a component take precedence in Rerun, so these colours belong to another archetype
        archetype = rr.Points3D if shape(header) != "points" else rr.Ellipsoids3D
        columns = archetype.columns(colors=flat).partition([n] * len(self.steps))
        return Rows(paths.BODIES, Index(self.steps, self.times), columns)


def change_with_time(header: Header, by: str) -> bool:
    """Return whether the colours of bodies change with time."""
    return by not in STATIC_COLOURS and not (by == header.coloured_by and shape(header) == "mesh")


def body_colours(recording: Recording, header: Header, by: str, step: ShownStep | None = None) -> BodyColours:
    """Return the colours of the bodies by a property.

    If the recording was coloured by this property, the recorded colours are returned. Otherwise, colours are computed
    for all frames, and for the repeated steps of ``step``. Raises RecordingError if the recording lacks the data.
    """
    n = len(header.radius)
    own = by == header.coloured_by
    if own and shape(header) == "mesh":
        return _constant(recording, np.full(n, palette.SKY, dtype=np.uint32))
    if by == "material" and header.materials is None:
        raise RecordingError(f"{recording.path} has no [[material]] to colour by; use group")
    if by in STATIC_COLOURS:
        return _constant(recording, header.static_colours(by)[recording.shown])
    if own:
        return recorded_colours(recording, header, range(n))
    if n * recording.frames > _MOST:
        raise RecordingError(f"{recording.path} is too long to be coloured by {by}; cut an interval with `carom clip`")
    if step is None:
        raise ValueError(f"colours by {by} of steps that are not known")
    if by == "speed":
        found = _by_speed(recording, header, step)
    else:
        if not header.collides:
            raise RecordingError(f"{recording.path} has no contacts to colour by {by}; use group or speed")
        found = _by_contacts(recording, n, by, step)
    return _of_rows(recording, header, range(n), list(found))


def recorded_colours(recording: Recording, header: Header, places: Sequence[int]) -> BodyColours:
    """Return the recorded, changing colours of the bodies with these indices; without indices, nothing is read."""
    is_read = places and len(recording.shown) * recording.frames <= _MOST
    return _of_rows(recording, header, places, list(_as_recorded(recording, places)) if is_read else [])


_Row = tuple[int, float, ColourArray]  # step, time (s), colours of the bodies


def _of_rows(recording: Recording, header: Header, places: Sequence[int], rows: Sequence[_Row]) -> BodyColours:
    """Join the colours of all frames; without frames, as after a killed run, bodies have one colour."""
    if not rows:
        return _constant(recording, header.static_colours("group")[recording.shown][list(places)])
    steps, times, colours = (list(column) for column in zip(*rows, strict=True))
    return BodyColours(np.array(steps), np.array(times), np.stack(colours))


def trail_colours(recording: Recording, header: Header, by: str, theme: str) -> ColourArray:
    """Return the colours (n,) of trails: those of the bodies if they are constant, otherwise those of the groups."""
    fixed = header.static_colours(by if by in STATIC_COLOURS else "group")
    return palette.legible(fixed[recording.shown], theme)


def fixed_colours(recording: Recording) -> ColourArray:
    """Return the colours (n,) of the bodies on a dark background, or of their groups if bodies change colour."""
    header = header_of_recording(recording)
    if shape(header) == "mesh":
        return np.full(len(header.radius), palette.SKY, dtype=np.uint32)
    return trail_colours(recording, header, header.coloured_by, "dark")


def redrawn_for(header: Header, theme: str) -> bool:
    """Return whether bodies are redrawn for a theme, since their recorded colours are made for a dark background."""
    return theme == "light" and shape(header) != "mesh"


def _constant(recording: Recording, colours: ColourArray) -> BodyColours:
    first = recording.fingerprints()
    return BodyColours(first[STEP].to_numpy()[:1], first["time"].to_numpy()[:1], colours[None])


def _as_recorded(recording: Recording, places: Sequence[int]) -> Iterator[_Row]:
    """Yield the colours that the file holds."""
    n = len(recording.shown)
    entries = [e for e in recording.store.entries if e.entity_path == paths.BODIES and e.first_step is not None]
    with reading(recording.path):
        for chunk in recording.chunks(sorted(entries, key=lambda entry: entry.first_step or 0)):
            name = next((name for name in _RECORDED if name in chunk.components), None)
            if name is None:
                continue
            colours = np.asarray(chunk.batch[name].flatten().to_numpy(), dtype=np.uint32).reshape(-1, n)
            yield from zip(*_times(recording, chunk.batch[STEP].to_numpy()), colours[:, list(places)], strict=True)


def _by_speed(recording: Recording, header: Header, step: ShownStep) -> Iterator[_Row]:
    """Yield colours by speed: speeds follow from distances between frames, or are exact in repeated steps."""
    drawn = drawn_paths(recording, range(len(header.radius)))
    steps, times = _times(recording, drawn.steps)
    if len(times) < 2:
        raise RecordingError(f"{recording.path} has one frame, which does not show speeds; colour by another property")
    mass = header.mass[recording.shown]
    velocity = np.gradient(drawn.position.astype(np.float64), np.maximum.accumulate(times), axis=0)
    speed = np.stack([drawing.speeds(velocity[row], mass) for row in range(len(velocity))])
    reference = float(np.median(speed[np.isfinite(speed)]))
    for row, (number, time) in enumerate(zip(steps, times, strict=True)):
        yield number, time, drawing.speed_colours(speed[row], reference)
    for frame in step.added:
        exact = drawing.speeds(frame.velocity, mass)
        yield frame.step, frame.time, drawing.speed_colours(exact, reference)


def _by_contacts(recording: Recording, n: int, by: str, step: ShownStep) -> Iterator[_Row]:
    colours_of = graph_colours if by == "graph" else drawing.island_colours
    drawn = drawn_paths(recording, range(n))
    steps, times = _times(recording, drawn.steps)
    ends: dict[int, SingleArray] = {}  # ends of the drawn edges, (m, 2, 3), by step
    entries = [e for e in recording.store.entries if e.entity_path == paths.CONTACTS and e.first_step is not None]
    for chunk in recording.chunks(entries):
        if _CONTACT_ENDS not in chunk.components:
            continue
        column = chunk.batch[_CONTACT_ENDS]
        for row, number in enumerate(chunk.batch[STEP].to_pylist()):
            values = column[row].values.flatten().flatten()
            ends[number] = np.asarray(values.to_numpy(), dtype=np.float32).reshape(-1, 2, 3)
    for number, time, position in zip(steps, times, drawn.position, strict=True):
        yield number, time, colours_of(_pairs(ends.get(number), position), n)
    for frame in step.added:
        yield frame.step, frame.time, colours_of(frame.contacts.pairs, n)


def _times(recording: Recording, steps: IntArray) -> tuple[list[int], list[float]]:
    return steps.tolist(), times_of(recording, steps).tolist()


def _pairs(ends: SingleArray | None, position: SingleArray) -> IntArray:
    """Find the bodies that edges connect: an end of an edge equals a centre bit by bit, or lies on a plane."""
    if ends is None or len(ends) == 0:
        return np.zeros((0, 2), dtype=np.int64)
    n = len(position)
    known = {centre.tobytes(): body for body, centre in enumerate(position)}
    pairs = [(known.get(a.tobytes(), n), known.get(b.tobytes(), n)) for a, b in ends]
    joined = np.array(sorted((i, j) for i, j in pairs if i < n), dtype=np.int64).reshape(-1, 2)
    return np.asarray(np.sort(joined, axis=1))
