"""`Pair`: the two ends of the contact in the close-up view, and how it is chosen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from carom.errors import RecordingError
from carom.physics.frame import Frame
from carom.recording.read.body_lookup import shown_body, split_at_commas
from carom.recording.read.recording import Recording


@dataclass(frozen=True, slots=True)
class Pair:
    """Two ends of a contact."""

    i: int
    j: int | None  # None if i touches a plane or a wall
    plane: int | None = None  # number of that plane or wall


def named_pair(recording: Recording, text: str) -> Pair:
    """Read two bodies from numbers or names with a comma between them.

    Raises
    ------
    RecordingError
        If they are not two bodies of the recording.
    """
    given = split_at_commas(text, recording.bodies.name)
    if len(given) != 2 or not all(given):
        raise RecordingError(f"bodies {text}: expected two bodies with a comma between them, such as 0,1")
    first, second = (shown_body(recording, part) for part in given)
    if first == second:
        raise RecordingError(f"bodies {text}: this is one body; give two")
    return Pair(min(first, second), max(first, second))


def hardest_pair(recording: Recording) -> Pair | None:
    """Return the pair of the run's hardest impact; None if none is recorded."""
    return pair_of_extreme(recording, "impact")


def pair_of_extreme(recording: Recording, name: str) -> Pair | None:
    """Return the pair of an extreme of the run; None if it names none that is shown."""
    closing = dict(recording.closing)
    found, planes = (_numbers(closing.get(f"moments.{name}.{what}", "")) for what in ("bodies", "planes"))
    shown = set(recording.shown)
    if not found or not all(body in shown for body in found):
        return None
    if len(found) > 1:
        return Pair(found[0], found[1])
    return Pair(found[0], None, planes[0] if planes else None)


def pair_of_step(frame: Frame, bodies: int) -> Pair | None:
    """Return the ends of the contact with the largest impulse (if unknown, of the first); None without contacts."""
    graph = frame.contacts
    if not len(graph):
        return None
    rows = frame.contact_rows
    row = graph.first if rows is None or len(rows) != len(graph) else int(np.argmax(rows["normal_impulse"]))
    i, j = (int(end) for end in graph.pairs[row])
    return Pair(i, j) if j < bodies else Pair(i, None, j - bodies)


def _numbers(text: object) -> list[int]:
    return [int(part) for part in str(text).split(",") if part.strip().isdigit()]
