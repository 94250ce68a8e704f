"""The `History` of another engine's run, from its recorded states and contact forces: nothing is run again."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from carom import Recording
from carom.arrays import FloatArray, Records
from carom.contact_table import CONTACT_ROW, IMPACT_MODE
from carom.errors import ExperimentError, RecordingError
from carom.extend import TIME, Checkpoint, closing_speeds, names_of, rows_by_frame, tolerance
from carom.lab.why.history import IMPULSE, History, Question, Step

MOST_FRAMES = 2_000  # read by default; a few seconds
MOST_BODY_FRAMES = 100_000
_ROUNDED = 1e-5  # of Σ |J| / m: contacts are recorded in float32, and some engines compute in it


def recorded_history(recording: Recording, question: Question, start: float | None) -> History:
    """Return the history of the frames up to the moment of a question.

    A step lasts from one exact state to the next. An impulse is a contact's force times the time between frames. What
    changes a velocity beyond these impulses is a kick: forces, and contacts that the engine does not report. A contact
    is an impact while it closes or parts faster than these kicks could make it, and otherwise holds.

    Parameters
    ----------
    start
        s; the history begins with the last exact state before it. By default it goes back `MOST_FRAMES` frames, or
        fewer with many bodies.

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
    history, impacts = History(begin, inverse_mass), [np.empty(0, CONTACT_ROW)]
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
    """Return the steps of the exact states from the beginning of the history to the moment, ascending."""
    times, units = recording.checkpoint_times, recording.units
    if not times:
        raise RecordingError(f"{recording.path} has no exact state: {recording.outcome}")
    moment = units.text(question.time, TIME, ".9g")
    if start is not None and start > question.time:
        begin = units.text(start, TIME, "g")
        raise ExperimentError(f"--from {begin} is later than {moment}, the time of the question")
    known = list(times)
    last = next((k for k, step in enumerate(known) if times[step] >= question.time - tolerance(question.time)), -1)
    known = known[: last + 1] if last >= 0 else known
    for body in question.bodies:
        if not recording.present(known[-1])[body]:
            raise ExperimentError(f"{names_of(recording).of(body)} does not exist at t = {moment}")
    if recording.lives is not None:  # an account begins when its body has come
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
    # bodies that come in this step begin with the velocity that their contacts leave unexplained, bodies that go keep
    # theirs
    began = np.where(np.isnan(before.velocity), after.velocity - given[:n], before.velocity)
    ended = np.where(np.isnan(after.velocity), began + given[:n], after.velocity)
    began, ended = np.nan_to_num(began), np.nan_to_num(ended)
    kick = ended - began - given[:n]
    kick[inverse_mass[:n] == 0.0] = 0.0
    noise = np.zeros(len(inverse_mass))
    noise[:n] = np.linalg.norm(kick, axis=1)
    noise += _ROUNDED * acted
    closing = [closing_speeds(contacts, state, inverse_mass[:n] > 0.0) for state in (before, after)]
    limit = noise[rows["i"]] + noise[rows["j"]]
    rows["impact"] = J.any(axis=1) & (np.maximum(np.abs(closing[0]), np.abs(closing[1])) > limit)
    rows["holds"] = ~rows["impact"]
    struck = contacts[rows["impact"]]
    struck["step"], struck["mode"] = after.step, IMPACT_MODE
    struck["approach_speed"] = np.maximum(0.0, closing[0][rows["impact"]])
    kicks = [np.zeros((len(bodies), 3)), kick[list(bodies)]]
    one = Step(after.step, before.step, after.time, before.time, began, ended, rows, kicks, contacts[:0])
    return one, struck
