"""Answers why a body moves as it does, or why two bodies touch: runs the window before the moment in question again.

A recording of another engine is not run again; its recorded states and contact forces are read.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from carom.arrays import FloatArray, IntArray, Records
from carom.errors import ExperimentError, RecordingError
from carom.lab.why.account import Account, Link, chain_of, impacts_by_step, impulses_on
from carom.lab.why.cone import Cone, Edge
from carom.lab.why.history import History, Question, Step, Watcher, recorded_history
from carom.recording.read.lookup import goal_of, tolerance
from carom.recording.read.recording import Recording
from carom.recording.timelines import STEP
from carom.scene.units.dimension import TIME


@dataclass(frozen=True, slots=True)
class Answer:
    """The velocities of the bodies in question, the terms that add up to them, and their causes."""

    question: Question
    time: float  # s, time of the velocities
    step: int
    begin: float  # s, start of the window
    begin_step: int
    source: str  # origin of the numbers, in words
    accounts: list[Account]  # accounts of the bodies in question
    cone: Cone
    chain: list[Link]  # links of the chain of causes, the latest first
    engine: str = ""  # engine whose recorded contact forces the answer uses; empty for carom
    knows_field: bool = False  # whether that engine's recording states its uniform field

    @property
    def is_flow(self) -> bool:
        """Whether the answer is a flow of impulse: contacts hold a body still, or contributed more than impacts."""
        return any(a.rests or a.share_of("contact", "stop") > a.share_of("impact") for a in self.accounts)

    @property
    def kind(self) -> str:
        """The main cause: "flow", "impacts", "forces", moving "walls", or "start": the initial velocities."""
        if self.is_flow or any(not link.turns for link in self.chain):
            return "flow" if self.is_flow else "impacts"
        cone = self.cone
        ultimate = {"start": cone.shares, "forces": cone.from_forces, "walls": cone.from_walls}
        return max(ultimate, key=lambda name: float(ultimate[name].sum()))

    @property
    def bodies(self) -> IntArray:
        """The bodies of the cone: without forces between bodies, only these could have had an effect."""
        return np.flatnonzero(self.cone.reached)

    @property
    def closed(self) -> IntArray:
        """The cone and all bodies connected to it by contacts: nothing else could change the answer.

        If bodies exert no forces on each other and the step is fixed, the answer keeps its bits without the other
        bodies.
        """
        return np.flatnonzero(self.cone.closed())

    @property
    def edges(self) -> list[Edge]:
        """The contacts of the cone, the largest share first."""
        return sorted(self.cone.edges.values(), key=lambda edge: -edge.share)

    @property
    def first_cause(self) -> int:
        """The body at the beginning of the chain, or a wall that moves on its own (a number ≥ n)."""
        if not self.chain:
            return self.question.bodies[0]
        last = self.chain[-1]
        return last.body if last.turns else last.by


# limit on the body steps (bodies times steps) that are run again by default; about a second for 500 bodies in a pile
MOST_BODY_STEPS = 100_000


def why(
    recording: Recording, question: Question, start: float | None = None, watch: Watcher = lambda status: None
) -> Answer:
    """Answer a question about a window that begins at the last checkpoint before ``start`` (s).

    By default, the window begins at the earliest checkpoint from which a replay is cheap, but no later than at the last
    checkpoint before the moment. ``watch`` receives the progress of the replay after every step.

    Raises
    ------
    RecordingError, SceneError
        If the recording cannot be run again, or lacks the contact forces of another engine.
    ExperimentError
        If the window lacks the bodies or the event.
    """
    if start is not None and start > question.time:
        units = recording.units
        begin, moment = units.text(start, TIME, "g"), units.text(question.time, TIME, ".9g")
        raise ExperimentError(f"--from {begin} is later than {moment}, the time of the question")
    mass = recording.bodies.mass
    if not recording.engine:
        return answer_from(question, _histories(recording, question, start, watch), mass)
    answer = answer_from(question, [recorded_history(recording, question, start)], mass)
    steps = np.diff(recording.fingerprints()[STEP].to_numpy())
    source = f"recorded from {recording.engine}"
    if len(steps) and steps.max() > 1:
        source += f"; a frame is up to {int(steps.max())} steps after the previous frame, so impulses are estimates"
    acts = recording.uniform_field is not None and bool(recording.uniform_field.any())
    return replace(answer, engine=recording.engine, source=source, knows_field=acts)


def answer_from(question: Question, histories: Iterable[History], mass: FloatArray) -> Answer:
    """Answer a question from windows, the latest of which comes first and contains the moment; masses are (n,) kg."""
    windows = iter(histories)
    back = _Backwards(question, next(windows), mass)
    for history in windows:
        back.go_on(history)
    return back.finish()


def _histories(recording: Recording, question: Question, start: float | None, watch: Watcher) -> Iterator[History]:
    """Run windows again, the latest first, each from a checkpoint, up to the moment of the question."""
    times, time = recording.checkpoint_times, question.time
    if not times:
        raise RecordingError(f"{recording.path} has no checkpoint to start from: {recording.outcome}")
    earlier = [step for step, at in times.items() if at < time - tolerance(time)] or [next(iter(times))]
    chosen = [earlier.pop()]
    frames = recording.fingerprints()
    row = min(int(np.searchsorted(frames["time"].to_numpy(), time)), frames.num_rows - 1)
    last, count = int(frames["step"][row].as_py()), len(recording.bodies.mass)
    while earlier:
        if start is None and (last - earlier[-1]) * count > MOST_BODY_STEPS:
            break
        if start is not None and times[chosen[-1]] <= start:
            break
        chosen.append(earlier.pop())
    end = goal_of(recording, time)
    for step in chosen:
        checkpoint = recording.checkpoint(step)
        yield History.replay(recording, checkpoint, end, question.bodies, watch)
        end = checkpoint.time


class _Backwards:
    """Goes back through the windows, the latest first."""

    def __init__(self, question: Question, history: History, mass: FloatArray) -> None:
        self._question = question
        self._count = len(mass)
        bodies = question.bodies
        if not history.inverse_mass[list(bodies)].all():
            raise ExperimentError("a fixed body has no velocity; choose one that moves")
        self._differs = history.differs
        self._impacts = impacts_by_step(history)
        step, rows, kicks, late = _moment(question, history)
        self._step, velocity = step, step.after.copy()
        for row in late[::-1]:
            impulse = np.array([row["x"], row["y"], row["z"]])
            velocity[row["i"]] += history.inverse_mass[row["i"]] * impulse
            if row["j"] < self._count:
                velocity[row["j"]] -= history.inverse_mass[row["j"]] * impulse
        for kick in step.kicks[len(kicks) :]:
            velocity[list(bodies)] -= kick
        self._time = float(late["time"][0]) if len(late) else step.time
        self._accounts = [Account.at(body, float(mass[body]), velocity[body]) for body in bodies]
        weights = self._weights(late, velocity)
        self._cone = Cone.of(history.inverse_mass, history.drives, self._count, bodies, weights, self._time)
        if len(late):
            self._cone.reach(late[late["time"] == late["time"][0]])
        self._take(history, step, rows, kicks, velocity)
        self._rest(history, step.step - history.steps[0].step)

    def go_on(self, history: History) -> None:
        """Go back through the next earlier window."""
        self._differs = history.differs if self._differs is None else self._differs
        self._rest(history, len(history.steps))

    def finish(self) -> Answer:
        """Return the answer."""
        begin = self._begin
        same = "with the same bits" if self._differs is None else f"with different bits from step {self._differs} on"
        return Answer(
            question=self._question,
            time=self._time,
            step=self._step.step,
            begin=begin.time,
            begin_step=begin.step,
            source=f"replayed from step {begin.step}, {same}",
            accounts=self._accounts,
            cone=self._cone,
            chain=chain_of(self._cone, self._question.bodies),
        )

    def _rest(self, history: History, end: int) -> None:
        self._begin, self._impacts = history.begin, impacts_by_step(history)
        for step in history.steps[end - 1 :: -1] if end > 0 else []:
            self._take(history, step, step.impulses, step.kicks, step.after.copy())

    def _take(self, history: History, step: Step, rows: Records, kicks: list[FloatArray], velocity: FloatArray) -> None:
        impacts = self._impacts.get(step.step, history.impacts[:0])
        contacts = step.contacts if rows is step.impulses else step.contacts[:0]
        flow = self._cone.take(step, rows, velocity, kicked=len(step.kicks) > 0)
        for place, account in enumerate(self._accounts):
            own = [kick[place] for kick in kicks]
            cone, own_place = self._cone, (account.body, place)
            shares = float(cone.carried[own_place]), float(cone.forced[own_place]), float(cone.fielded[own_place])
            account.take(step, *impulses_on(account.body, rows, flow, place), shares, own, impacts, contacts)

    def _weights(self, late: Records, velocity: FloatArray) -> list[float]:
        """Divide the answer between the bodies of the question; for an impact, by their speeds along the impulse."""
        bodies = self._question.bodies
        if len(bodies) == 1 or not len(late):
            return [1.0 / len(bodies)] * len(bodies)
        own = late[(late["i"] == bodies[0]) & (late["j"] == bodies[1])][0]
        normal = np.array([own["x"], own["y"], own["z"]])
        speeds = np.abs(velocity[list(bodies)] @ normal)
        total = float(speeds.sum())
        return [float(speed) / total if total > 0.0 else 0.5 for speed in speeds]


def _moment(question: Question, history: History) -> tuple[Step, Records, list[FloatArray], Records]:
    """Return the step of the question, its impulses and kicks before the moment, and the later impulses."""
    time = question.units.text(question.time, TIME, ".9g")
    if not history.steps:
        raise ExperimentError(f"t = {time} is not after the beginning of the recording; earlier causes are unknown")
    last = history.steps[-1]
    if question.ends is None:
        return last, last.impulses, last.kicks, last.impulses[:0]
    place = bisect_left(history.steps, question.time - tolerance(question.time), key=lambda step: step.time)
    near = history.steps[max(0, place - 1) : place + 2]
    # the nearest impulse between the two ends; an impact is preferred to an equally near impulse
    found: list[tuple[float, bool, int, int]] = []
    for number, each in enumerate(near):
        rows = each.impulses
        acts = (rows["x"] != 0.0) | (rows["y"] != 0.0) | (rows["z"] != 0.0)
        for row in np.flatnonzero((rows["i"] == question.ends[0]) & (rows["j"] == question.ends[1]) & acts).tolist():
            found.append((abs(float(rows["time"][row]) - question.time), bool(rows["holds"][row]), number, row))
    if not found:
        raise ExperimentError(f"{question.event}: no impulse acted between the two bodies at t = {time}")
    *_, number, row = min(found)
    step = near[number]
    first = int(np.searchsorted(step.impulses["instant"], step.impulses["instant"][row]))
    late = step.impulses[first:]
    kicks = step.kicks if late["time"][0] >= step.time else step.kicks[:1]
    return step, step.impulses[:first], kicks, late
