"""The colours of the bodies of a recording, by frame."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import rerun as rr

from carom.arrays import ColourArray, IntArray, SingleArray
from carom.errors import RecordingError
from carom.recording.layout import colouring
from carom.recording.layout.drawing import shape
from carom.recording.read.frame_rows import drawn_paths
from carom.recording.read.recording import Recording
from carom.recording.schema import paths
from carom.recording.schema.header import STATIC_COLOURS, Header
from carom.recording.schema.paths import STEP
from carom.recording.write.rows import Index, Rows
from carom.show.shown_step import ShownStep

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
