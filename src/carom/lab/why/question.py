"""`Question`: which bodies at which moment an answer is about."""

from __future__ import annotations

from dataclasses import dataclass

from carom.errors import RecordingError
from carom.recording.read.body_lookup import body_number, names_of
from carom.recording.read.recording import Recording
from carom.scene.units.dimension import TIME
from carom.scene.units.system import SI, UnitSystem
from carom.show.named_event import named_event


@dataclass(frozen=True, slots=True)
class Question:
    """A body at a time, or the two ends of an impact."""

    bodies: tuple[int, ...]  # one, or both of the impact that are no planes
    ends: tuple[int, int] | None  # of the impact, i < j; planes have numbers from n on
    time: float  # s
    text: str  # it, in words
    event: str | None = None  # its name
    units: UnitSystem = SI  # that it is answered in


def question_of(recording: Recording, body: str | None, at: float | None, event: str | None) -> Question:
    """Read a question.

    Parameters
    ----------
    recording
        What it is about.
    body
        Number or name of a body.
    at
        s; by default the end of the recording.
    event
        Name of an event, as `carom view` takes it.

    Raises
    ------
    RecordingError
        If there is no such body, moment or event, or not exactly one of a body and an event is given.
    """
    if (body is None) == (event is None):
        raise RecordingError("ask about a body with --body, or about an impact with --event; give one of them")
    recording.require_frames()
    if event is not None:
        if at is not None:
            raise RecordingError("give --at or --event, not both")
        return _of_event(recording, event)
    assert body is not None
    number = body_number(recording, body)
    time = recording.moment(float(recording.fingerprints()["time"][-1].as_py()) if at is None else at)
    name = names_of(recording).of(number)
    when = recording.units.text(time, TIME, ".9g")
    return Question((number,), None, time, f"Why does {name} move as it does at t = {when}?", units=recording.units)


def _of_event(recording: Recording, event: str) -> Question:
    found = named_event(recording, event)
    time, pair = found.time, found.pair
    when, count = recording.units.text(time, TIME, ".9g"), len(recording.bodies.mass)
    if pair is None or (pair.j is None and pair.plane is None):
        which = "no two bodies" if recording.shows_all else "no two bodies that this clip shows"
        raise RecordingError(f'the event "{event}" names {which}; ask about one with --body, at t = {when} with --at')
    j = pair.j if pair.j is not None else count + (pair.plane or 0)
    bodies = (pair.i,) if j >= count else (pair.i, j)
    text = f"Why do {names_of(recording).pair((pair.i, j))} touch at t = {when}?"
    return Question(bodies, (pair.i, j), time, text, event, recording.units)
