"""`Question`: bodies and a moment; `History`: every impulse of the window before it, which is run again."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np

from carom import Recording, Space
from carom.arrays import FloatArray, Records
from carom.contact_table import CONTACT_ROW, OPEN
from carom.errors import RecordingError
from carom.extend import (
    SI,
    TIME,
    Checkpoint,
    StepStatus,
    UnitSystem,
    body_number,
    every,
    named_event,
    names_of,
    recorded_scene,
    space_of,
)

Watcher = Callable[[StepStatus], None]

IMPULSE = np.dtype(
    [
        ("step", np.int64),
        ("instant", np.int64),  # number within the step; impulses of one instant act together
        ("time", np.float64),  # s
        ("i", np.int64),  # i < j
        ("j", np.int64),  # from n on: planes and walls
        ("x", np.float64),  # N s, the impulse on j; the impulse on i is the opposite
        ("y", np.float64),
        ("z", np.float64),
        ("holds", np.bool_),  # whether it holds a contact at rest
        ("impact", np.bool_),  # whether the contact closed faster than its rest speed; if neither, it is a stop
        ("lasts", np.bool_),  # whether it is a force over the whole step, as those of other engines are
    ]
)

_AUDIT = 1e-12  # makes the run audit its kicks; the bound itself is not used


@dataclass(frozen=True, slots=True)
class Step:
    """The data of one step."""

    step: int
    before_step: int  # the one before; for another engine, that of the exact state before
    time: float  # s, at its end
    began: float  # s
    before: FloatArray  # (n, 3) m/s, velocities at its beginning
    after: FloatArray  # (n, 3) m/s, velocities at its end
    impulses: Records  # (k,) `IMPULSE`, in order
    kicks: list[FloatArray]  # each (b, 3) m/s, changes of velocity by forces, of the bodies of the question
    contacts: Records  # (m,) `CONTACT_ROW`, the contacts of these bodies
    by_field: FloatArray = field(default_factory=lambda: np.zeros(3))  # (3,) m/s, of the kicks, by an engine's field


@dataclass(slots=True)
class History:
    """The steps between two moments of a run, and the impacts in them."""

    begin: Checkpoint
    inverse_mass: FloatArray  # (n + p,) 1/kg
    steps: list[Step] = field(default_factory=list)
    impacts: Records = field(default_factory=lambda: np.empty(0, CONTACT_ROW))
    differs: int | None = None  # the first recorded step with different bits

    @classmethod
    def replay(
        cls, recording: Recording, begin: Checkpoint, end: float, bodies: tuple[int, ...], watch: Watcher
    ) -> History:
        """Run a recording again from a checkpoint up to the step that contains a time (s).

        Raises
        ------
        RecordingError, SceneError
            If it cannot be run again.
        """
        scene = recorded_scene(recording)
        audited = scene.expect.model_copy(update={"contact_audit": _AUDIT})  # records the kicks of forces
        space = space_of(recording, scene.model_copy(update={"expect": audited}), begin, record_contacts=True)
        history = cls(begin, space.state.ends.inverse_mass.copy())
        table = recording.fingerprints()
        recorded = dict(zip(table["step"].to_pylist(), table["fingerprint"].to_pylist(), strict=True))
        before, began, found = space.state.velocity.copy(), space.time, [history.impacts]
        last = begin.step
        for frame in space.run(schedule=every(0.0)):
            bits = recorded.get(frame.step)
            if history.differs is None and bits is not None and bits != frame.fingerprint:
                history.differs = frame.step
            if frame.step > begin.step:
                kicks = [kick[list(bodies)] for kick in space.kicks()]
                touching = frame.contact_rows if frame.contact_rows is not None else history.impacts
                rows = _impulses(space, touching)
                own = touching[np.isin(touching["i"], bodies) | np.isin(touching["j"], bodies)]
                after = frame.velocity
                history.steps.append(Step(frame.step, last, frame.time, began, before, after, rows, kicks, own))
                if frame.impacts is not None and len(frame.impacts):
                    found.append(frame.impacts)
                before, began, last = frame.velocity, frame.time, frame.step
            watch(space.status)
            if frame.time >= end:
                break
        history.impacts = np.concatenate(found)
        return history


def _impulses(space: Space, touching: Records) -> Records:
    """Return the impulses of the last step, and the contacts without an impulse at its end."""
    parts = [*_given(space)]
    last = max((int(part["instant"][-1]) for part in parts if len(part)), default=0)
    silent = touching[(touching["mode"] == OPEN) & (touching["normal_impulse"] == 0.0)]
    rows = np.zeros(len(silent), IMPULSE)
    for name in ("i", "j", "time"):
        rows[name] = silent[name]
    rows["instant"], rows["holds"] = last, True
    parts.append(rows)
    joined = np.concatenate(parts)
    joined["step"] = space.step
    return joined


def _given(space: Space) -> Iterator[Records]:
    """Yield the impulses that are not zero. Those at the end of a step belong to one instant."""
    instant, time = -1, -np.inf
    for some in space.impulses():
        J = some.values[:, :1] * some.normal + some.values[:, 1:]
        chosen = np.flatnonzero(J.any(axis=1))
        if not len(chosen):
            continue
        rows = np.zeros(len(chosen), IMPULSE)
        rows["i"], rows["j"], rows["time"] = some.pairs[chosen, 0], some.pairs[chosen, 1], some.time[chosen]
        rows["x"], rows["y"], rows["z"] = J[chosen].T
        rows["holds"] = some.impact is None
        rows["impact"] = False if some.impact is None else some.impact[chosen]
        later = np.diff(rows["time"], prepend=time) > 0.0
        rows["instant"] = instant + np.cumsum(later)
        instant, time = int(rows["instant"][-1]), float(rows["time"][-1])
        yield rows


@dataclass(frozen=True, slots=True)
class Question:
    """A body at a time, or the two ends of an impact."""

    bodies: tuple[int, ...]  # the body, or the ends of the impact that are bodies
    ends: tuple[int, int] | None  # of the impact, i < j; planes have numbers from n on
    time: float  # s
    text: str  # the question in words
    event: str | None = None  # name of the event
    units: UnitSystem = SI  # units of the answer


def question_of(recording: Recording, body: str | None, at: float | None, event: str | None) -> Question:
    """Read a question.

    Parameters
    ----------
    recording
        The recording.
    body
        Number or name of a body.
    at
        s; by default the end of the recording.
    event
        Name of an event, as for `carom view`.

    Raises
    ------
    RecordingError
        If there is no such body, moment or event, or unless exactly one of a body and an event is given.
    """
    if (body is None) == (event is None):
        raise RecordingError("choose a body with --body, or an impact with --event")
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
        which = "no two bodies" if recording.shows_all else "no two bodies of this clip"
        raise RecordingError(f'the event "{event}" names {which}; ask about one with --body, at t = {when} with --at')
    j = pair.j if pair.j is not None else count + (pair.plane or 0)
    bodies = (pair.i,) if j >= count else (pair.i, j)
    text = f"Why do {names_of(recording).pair((pair.i, j))} touch at t = {when}?"
    return Question(bodies, (pair.i, j), time, text, event, recording.units)
