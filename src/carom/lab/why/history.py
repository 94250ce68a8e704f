"""`Question`: bodies and a moment; `History`: every impulse in the window before that moment.

The window of a recording of carom is run again. For another engine, the impulses follow from the recorded states and
contact forces.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from carom.arrays import BoolArray, FloatArray, Records
from carom.contact_table import CONTACT_ROW, IMPACT_MODE, OPEN
from carom.errors import ExperimentError, RecordingError
from carom.physics.schedule import every
from carom.physics.simulation import StepStatus
from carom.physics.space import Space
from carom.recording.read.lookup import body_number, names_of, tolerance
from carom.recording.read.named_events import named_event
from carom.recording.read.recorded_contacts import closing_speeds, rows_by_frame
from carom.recording.read.recorded_scene import fixed_of, recorded_scene
from carom.recording.read.recording import Recording
from carom.runs.window import space_of
from carom.scene.start import EntryStates
from carom.scene.units.dimension import TIME
from carom.scene.units.system import SI, UnitSystem
from carom.state.checkpoint import Checkpoint

Watcher = Callable[[StepStatus], None]

IMPULSE = np.dtype(
    [
        ("step", np.int64),
        ("instant", np.int64),  # number of the instant within the step; impulses of one instant act together
        ("time", np.float64),  # s
        ("i", np.int64),  # i < j
        ("j", np.int64),  # the second end; numbers ≥ n are planes and walls
        ("x", np.float64),  # N s, the impulse on j; the impulse on i is the opposite
        ("y", np.float64),
        ("z", np.float64),
        ("holds", np.bool_),  # whether the impulse holds a contact at rest
        # whether the contact closed faster than its rest speed; if neither flag is set, the contact was stopped
        ("impact", np.bool_),
        ("approach", np.float64),  # m/s, closing speed of an impact; 0 if unknown
        ("lasts", np.bool_),  # whether the impulse is a force over the whole step, as in other engines
    ]
)

_AUDIT = 1e-12  # any bound makes the run audit its kicks; the bound itself is not used


MOST_FRAMES = 2_000  # largest number of frames that are read by default, in a few seconds
MOST_BODY_FRAMES = 100_000
_ROUNDED = 1e-5  # relative rounding of Σ |J| / m: contacts are recorded in float32, and some engines compute in float32


@dataclass(frozen=True, slots=True)
class Step:
    """The data of one step."""

    step: int
    before_step: int  # the previous step; for another engine, the step of the previous exact state
    time: float  # s, time at the end of the step
    began: float  # s, time at the beginning of the step
    before: FloatArray  # (n, 3) m/s, velocities at the beginning of the step
    after: FloatArray  # (n, 3) m/s, velocities at the end of the step
    impulses: Records  # (k,) `IMPULSE`, in order
    kicks: list[FloatArray]  # arrays (b, 3) in m/s: velocity changes, by forces, of the bodies in question
    contacts: Records  # (m,) `CONTACT_ROW`, the contacts of the bodies in question
    # (3,) m/s, part of the kicks that is due to an engine's uniform field
    by_field: FloatArray = field(default_factory=lambda: np.zeros(3))


@dataclass(slots=True)
class History:
    """The steps between two moments of a run, and the impacts in them."""

    begin: Checkpoint
    inverse_mass: FloatArray  # (n + p,) 1/kg
    drives: BoolArray  # (n + p,) whether a plane or wall moves on its own
    steps: list[Step] = field(default_factory=list)
    impacts: Records = field(default_factory=lambda: np.empty(0, CONTACT_ROW))
    differs: int | None = None  # first recorded step whose bits differ

    @classmethod
    def replay(
        cls, recording: Recording, begin: Checkpoint, end: float, bodies: tuple[int, ...], watch: Watcher
    ) -> History:
        """Run a recording again from a checkpoint up to the step that contains a time (s)."""
        scene = recorded_scene(recording)
        audited = scene.expect.model_copy(update={"contact_audit": _AUDIT})  # makes the run record the kicks by forces
        space = space_of(recording, scene.model_copy(update={"expect": audited}), begin, record_contacts=True)
        inverse_mass, entries = space.state.ends.inverse_mass.copy(), recording.entries
        if entries is not None:  # before bodies enter, they count as moving with their velocities of entry
            n = len(space.mass)
            inverse_mass[:n] = np.divide(1.0, space.mass, out=np.zeros(n), where=~fixed_of(scene))
            begin = replace(begin, velocity=_with_entries(begin.velocity, space.frame().waits, entries))
        history = cls(begin, inverse_mass, np.append(np.zeros(len(space.state), dtype=np.bool_), space.planes.driven))
        table = recording.fingerprints()
        recorded = dict(zip(table["step"].to_pylist(), table["fingerprint"].to_pylist(), strict=True))
        before = space.state.velocity.copy() if entries is None else begin.velocity
        began, found = space.time, [history.impacts]
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
                after = frame.velocity if entries is None else _with_entries(frame.velocity, frame.waits, entries)
                history.steps.append(Step(frame.step, last, frame.time, began, before, after, rows, kicks, own))
                if frame.impacts is not None and len(frame.impacts):
                    found.append(frame.impacts)
                before, began, last = after, frame.time, frame.step
            watch(space.status)
            if frame.time >= end:
                break
        history.impacts = np.concatenate(found)
        return history


def _with_entries(velocity: FloatArray, waits: BoolArray | None, entries: EntryStates) -> FloatArray:
    """Return velocities, (n, 3) m/s; bodies that wait have the velocities with which they will enter."""
    return velocity if waits is None else np.where(waits[:, None], entries.velocity, velocity)


def _impulses(space: Space, touching: Records) -> Records:
    """Return the impulses of the last step, and contacts without an impulse at its end; the end is one instant."""
    instant, time, parts = -1, -np.inf, list[Records]()
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
        rows["approach"] = 0.0 if some.approach is None else some.approach[chosen]
        rows["instant"] = instant + np.cumsum((np.diff(rows["time"], prepend=time) > 0.0) | some.ordered)
        instant, time = int(rows["instant"][-1]), float(rows["time"][-1])
        parts.append(rows)
    silent = touching[(touching["mode"] == OPEN) & (touching["normal_impulse"] == 0.0)]
    rows = np.zeros(len(silent), IMPULSE)
    for name in ("i", "j", "time"):
        rows[name] = silent[name]
    rows["instant"], rows["holds"] = max(instant, 0), True
    joined = np.concatenate([*parts, rows])
    joined["step"] = space.step
    return joined


@dataclass(frozen=True, slots=True)
class Question:
    """The subject of a question: a body at a given time, or both ends of an impact."""

    bodies: tuple[int, ...]  # the body, or both bodies of the impact
    ends: tuple[int, int] | None  # ends i < j of the impact; planes have numbers ≥ n
    time: float  # s
    text: str  # the question in words
    event: str | None = None  # name of the event
    units: UnitSystem = SI  # units of the answer


def question_of(recording: Recording, body: str | None, at: float | None, event: str | None) -> Question:
    """Return a question about a body, given by number or name, or about an event, named as for `carom view`.

    The time ``at`` is in s; by default it is the end of the recording. Exactly one of a body and an event is required.
    Raises RecordingError if the body, the event or the moment does not exist.
    """
    if (body is None) == (event is None):
        raise RecordingError("choose a body with --body, or an impact with --event")
    recording.require_frames()
    if event is not None:
        if at is not None:
            raise RecordingError("give --at or --event, not both")
        found = named_event(recording, event)
        time, pair = found.time, found.pair
        when, count = recording.units.text(time, TIME, ".9g"), len(recording.bodies.mass)
        if pair is None or (pair.j is None and pair.plane is None):
            which = "no two bodies" if recording.shows_all else "no two bodies of this clip"
            raise RecordingError(
                f'the event "{event}" names {which}; ask about one with --body, at t = {when} with --at'
            )
        j = pair.j if pair.j is not None else count + (pair.plane or 0)
        bodies = (pair.i,) if j >= count else (pair.i, j)
        text = f"Why do {names_of(recording).pair((pair.i, j))} touch at t = {when}?"
        return Question(bodies, (pair.i, j), time, text, event, recording.units)
    assert body is not None
    number = body_number(recording, body)
    time = recording.moment(float(recording.fingerprints()["time"][-1].as_py()) if at is None else at)
    name = names_of(recording).of(number)
    when = recording.units.text(time, TIME, ".9g")
    return Question((number,), None, time, f"Why does {name} move as it does at t = {when}?", units=recording.units)


def recorded_history(recording: Recording, question: Question, start: float | None) -> History:
    """Return the history of the frames up to the moment of a question, for a recording of another engine.

    A step lasts from one exact state to the next. An impulse is a contact's force times the time between frames. A kick
    is the change of velocity that these impulses do not explain: it is due to forces, and to contacts that the engine
    does not report. A contact is an impact as long as it closes or separates faster than the kicks explain; otherwise
    it is a contact at rest.

    The history begins with the last exact state before ``start`` (s). By default, the history goes back by
    `MOST_FRAMES` frames, or by fewer if there are many bodies.

    Raises
    ------
    RecordingError
        If the recording lacks forces of contacts or exact states.
    ExperimentError
        If the bodies do not exist at that moment.
    """
    if not recording.records_contacts:
        raise RecordingError(
            f"{recording.path}: forces of contacts are not in this recording of {recording.engine}, so that what moved "
            "a body is unknown"
        )
    recording.refuse_some_bodies()
    steps = _steps(recording, question, start)
    states = recording.checkpoints(steps)
    begin = next(states)
    found: dict[int, list[Records]] = {step: [] for step in steps}
    for step, _, rows in rows_by_frame(recording, steps[0] + 1, steps[-1]):
        found[steps[int(np.searchsorted(steps, step))]].append(rows)
    n, ends = len(recording.bodies.mass), [rows["j"] for each in found.values() for rows in each]
    inverse_mass = np.zeros(max((int(end.max()) + 1 for end in ends if len(end)), default=0) + n)
    moves = ~recording.fixed & (recording.bodies.mass > 0.0)
    inverse_mass[:n] = np.divide(1.0, recording.bodies.mass, out=np.zeros(n), where=moves)
    history = History(begin, inverse_mass, np.zeros(len(inverse_mass), dtype=np.bool_))
    impacts = [np.empty(0, CONTACT_ROW)]
    before = begin
    for after in states:
        one, struck = _step(before, after, found[after.step], inverse_mass, question.bodies)
        if recording.uniform_field is not None:
            one = replace(one, by_field=(after.time - before.time) * recording.uniform_field)
        history.steps.append(one)
        impacts.append(struck)
        before = after
    history.impacts = np.concatenate(impacts)
    return history


def _steps(recording: Recording, question: Question, start: float | None) -> list[int]:
    """Return the steps of the exact states from the beginning of the history to the moment, in order of time."""
    times = recording.checkpoint_times
    if not times:
        raise RecordingError(f"{recording.path} has no exact state: {recording.outcome}")
    known = list(times)
    last = next((k for k, step in enumerate(known) if times[step] >= question.time - tolerance(question.time)), -1)
    known = known[: last + 1] if last >= 0 else known
    for body in question.bodies:
        if not recording.present(known[-1])[body]:
            moment = recording.units.text(question.time, TIME, ".9g")
            raise ExperimentError(f"{names_of(recording).of(body)} does not exist at t = {moment}")
    if recording.lives is not None:  # an account cannot begin before its body has entered
        came = max(int(recording.lives[body, 0]) for body in question.bodies)
        known = [step for step in known if step >= came]
    if start is None:
        return known[-1 - max(1, min(MOST_FRAMES, MOST_BODY_FRAMES // len(recording.bodies.mass))) :]
    first = next((k for k, step in enumerate(known) if times[step] > start + tolerance(start)), len(known))
    return known[max(0, min(first, len(known) - 1) - 1) :]


def _step(
    before: Checkpoint, after: Checkpoint, frames: list[Records], inverse_mass: FloatArray, bodies: tuple[int, ...]
) -> tuple[Step, Records]:
    """Return a step and its impacts, (k,) `CONTACT_ROW`."""
    n = len(before.position)
    contacts = np.concatenate([np.empty(0, CONTACT_ROW), *frames])
    rows = np.zeros(len(contacts), IMPULSE)
    for name in ("i", "j", "time"):
        rows[name] = contacts[name]
    rows["step"], rows["lasts"] = after.step, True
    rows["instant"] = np.repeat(np.arange(len(frames)), [len(each) for each in frames])
    normal = np.stack([contacts[name] for name in ("nx", "ny", "nz")], axis=1)
    friction = np.stack([contacts[f"friction_{axis}"] for axis in "xyz"], axis=1)
    J = contacts["normal_impulse"][:, None] * normal + friction
    rows["x"], rows["y"], rows["z"] = J.T
    given, acted = np.zeros((len(inverse_mass), 3)), np.zeros(len(inverse_mass))  # m/s, Σ J / m and Σ |J| / m
    for end, sign in (("i", -1.0), ("j", 1.0)):
        np.add.at(given, rows[end], sign * inverse_mass[rows[end], None] * J)
        np.add.at(acted, rows[end], inverse_mass[rows[end]] * np.linalg.norm(J, axis=1))
    # a new body starts with the part of its velocity that contacts do not explain; a body that leaves keeps its
    # velocity
    began = np.where(np.isnan(before.velocity), after.velocity - given[:n], before.velocity)
    ended = np.where(np.isnan(after.velocity), began + given[:n], after.velocity)
    began, ended = np.nan_to_num(began), np.nan_to_num(ended)
    kick = ended - began - given[:n]
    kick[inverse_mass[:n] == 0.0] = 0.0
    noise = _ROUNDED * acted
    noise[:n] += np.linalg.norm(kick, axis=1)
    closing = [closing_speeds(contacts, state, inverse_mass[:n] > 0.0) for state in (before, after)]
    limit = noise[rows["i"]] + noise[rows["j"]]
    rows["impact"] = J.any(axis=1) & (np.maximum(np.abs(closing[0]), np.abs(closing[1])) > limit)
    rows["holds"] = ~rows["impact"]
    struck = contacts[rows["impact"]]
    struck["step"], struck["mode"] = after.step, IMPACT_MODE
    struck["approach_speed"] = np.maximum(0.0, closing[0][rows["impact"]])
    kicks = [np.zeros((len(bodies), 3)), kick[list(bodies)]]
    return Step(after.step, before.step, after.time, before.time, began, ended, rows, kicks, contacts[:0]), struck
