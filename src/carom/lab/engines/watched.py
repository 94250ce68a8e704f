"""Runs a scene in another engine and collects its trajectory, its extremes, violated laws, and a recording."""

from __future__ import annotations

import math
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from time import process_time as clock
from typing import TYPE_CHECKING

import numpy as np

from carom import Frame, Scene
from carom.arrays import FloatArray
from carom.errors import ExperimentError
from carom.extend import TIME, Extremes, Observer, not_finite, observed_recording, observed_totals, setup_of
from carom.lab.compared_run import RunStoppedError, Trajectory, between
from carom.record import Fault, State, Tolerances

if TYPE_CHECKING:
    from carom.lab.engines import EngineSimulation

ROUNDING = 1e-9  # of the duration, by which the sum of the steps may fall short
COMPLETED = "completed"
MOST_SEEN = 20_000  # steps examined where nothing can touch
FRAMES = 600  # frames of a recording, in addition to those that violate a law


@dataclass(frozen=True, slots=True)
class Watched:
    """Observations of an engine's run."""

    outcome: str  # "completed", or the reason for an early end
    dt: float  # s, of the steps
    trajectory: Trajectory
    extremes: Extremes
    faults: list[Fault]  # the first of each law, in order of time
    counts: dict[str, int]  # number of frames that violate each law
    broken: list[tuple[float, str]]  # time (s) and law of every such frame


def watch(
    simulation: EngineSimulation, scene: Scene, times: FloatArray, path: Path | None = None, limit: float = np.inf
) -> Watched:
    """Run a simulation to the end of its scene.

    If nothing can touch, at most `MOST_SEEN` steps are examined.

    Parameters
    ----------
    simulation
        At its start.
    times
        (K,) s, at which it is sampled.
    path
        The ``.rrd`` to write; an existing file is replaced.
    limit
        s of CPU time after which the run is stopped.

    Raises
    ------
    ExperimentError
        If the state is no longer finite, and the run is not recorded; `RunStoppedError` if it took
        longer than the limit.
    """
    first = simulation.source.state()
    setup = setup_of(simulation.source.model, first)
    walk = _Walk(simulation, scene, Observer(setup, first, Tolerances(), scene.unit_system), _Samples(times))
    with ExitStack() as stack:
        log = None if path is None else _Log(stack, path, scene, walk.observer)
        outcome = walk.run(first, log, limit)
        if log is not None:
            log.finish(outcome, walk)
    if outcome != COMPLETED and path is None:
        raise ExperimentError(outcome.removeprefix("failed: "))
    audit = walk.observer.audit
    return Watched(
        outcome=outcome,
        dt=simulation.dt,
        trajectory=walk.trajectory(times),
        extremes=walk.observer.extremes,
        faults=sorted(audit.first.values(), key=lambda fault: fault.step),
        counts=audit.counts,
        broken=audit.broken,
    )


class _Walk:
    """Runs a simulation from its start to the end of its scene, and examines its steps."""

    def __init__(self, simulation: EngineSimulation, scene: Scene, observer: Observer, samples: _Samples) -> None:
        self.observer = observer
        self.frame: Frame  # the last one
        self._simulation, self._scene, self._samples = simulation, scene, samples
        self._end = scene.time.duration * (1.0 - ROUNDING)
        self._met: dict[tuple[int, int], float] = {}  # when two ends first touched, in s
        self._step = 0
        many = math.ceil(scene.time.duration / simulation.dt / MOST_SEEN) if simulation.dt else 1
        self._stride = 1 if observer.setup.collides else many  # steps between two examined ones

    def run(self, first: State, log: _Log | None, limit: float) -> str:
        """Run until the scene ends, the state is not finite, or ``limit`` s of CPU time pass; return the outcome."""
        units, began = self._scene.unit_system, clock()
        self.frame = self.observer.frame(0, _copied(first))
        if log is not None:
            log.see(self.frame)
        while self.frame.time < self._end:
            spent = clock() - began
            if spent > limit:
                reached = units.text(self.frame.time, TIME)
                if log is None:
                    raise RunStoppedError(self._step, spent, reached, by_limit=True)
                return f"failed: stopped at t = {reached}: it took more than {limit:g} s of CPU time (--limit)"
            wrong = self._advance()
            if wrong:
                return f"failed: {wrong}"
            if log is not None:
                log.see(self.frame)
        return COMPLETED

    def trajectory(self, times: FloatArray) -> Trajectory:
        """Return the samples, and the extremes so far."""
        extremes, samples, count = self.observer.extremes, self._samples, len(self._samples.position)
        n, collides = len(self.observer.setup), self.observer.setup.collides
        # while bodies touch, the work of contacts cannot be separated from errors
        touched = extremes.total_contacts + extremes.impacts > 0 or self.frame.energy.ledger.restitution != 0.0
        return Trajectory(
            time=times[:count],
            position=np.array(samples.position).reshape(count, n, 3),
            velocity=np.array(samples.velocity).reshape(count, n, 3),
            pair=np.array(list(self._met), dtype=np.int64).reshape(-1, 2),
            met=np.array(list(self._met.values())),
            energy_error=np.nan if touched or extremes.energy_error is None else extremes.energy_error.value,
            energy_gain=extremes.energy_gain.value,
            momentum_error=extremes.momentum_error.value if extremes.momentum_error else np.nan,
            angular_momentum_error=extremes.angular_momentum_error.value if extremes.angular_momentum_error else np.nan,
            overlap=(extremes.overlap.value if extremes.overlap else 0.0) if collides else np.nan,
            sinking=np.nan,
            impacts=extremes.impacts,
            steps=self.frame.step,
            frames=0,
        )

    def _advance(self) -> str:
        """Advance to the next examined step and examine it; return why the run cannot continue, or an empty text."""
        dt = self._simulation.dt
        left = math.ceil((self._scene.time.duration - self.frame.time) / dt * (1.0 - ROUNDING)) if dt else 1
        for _ in range(min(self._stride, left)):
            self._step += 1
            self._simulation.step()
        state = self._simulation.source.state()
        fault = not_finite(self.observer.setup, self._step, state)
        if fault is not None:
            self.observer.audit.note(fault)
            return fault.text
        if state.time < self.frame.time:  # as in MuJoCo, which restarts when it becomes unstable
            units = self._scene.unit_system
            back = units.text(state.time, TIME, "g")
            return f"the engine's time decreased from {units.text(self.frame.time, TIME, 'g')} to {back}."
        before, self.frame = self.frame, self.observer.frame(self._step, _copied(state))
        self._samples.take(before, self.frame)
        for pair in self.frame.contacts.pairs.tolist():
            self._met.setdefault((pair[0], pair[1]), self.frame.time)
        return ""


class _Log:
    """The recording of a run: `FRAMES` of its frames, and those that violate a law."""

    def __init__(self, stack: ExitStack, path: Path, scene: Scene, observer: Observer) -> None:
        self._scene, self._due = scene, 0.0  # s, of the next recorded frame
        self._recorder = stack.enter_context(observed_recording(path, observer, scene))

    def see(self, frame: Frame) -> None:
        """Record a frame if it is due, the last, or in the log."""
        end = self._scene.time.duration
        if frame.time >= min(self._due, end * (1.0 - ROUNDING)) or frame.events:
            self._recorder.put(frame)
            self._due = frame.time + end / FRAMES if frame.step else 0.0

    def finish(self, outcome: str, walk: _Walk) -> None:
        """Write the end of the recording."""
        observer, last = walk.observer, walk.frame
        self._recorder.finish(outcome, observed_totals(observer, last.step, last.time), observer.highlights())


class _Samples:
    """States at given times, interpolated between the ends of steps."""

    def __init__(self, times: FloatArray) -> None:
        self.position: list[FloatArray] = []
        self.velocity: list[FloatArray] = []
        self._times = iter(times.tolist())
        self._due = next(self._times, np.inf)

    def take(self, before: Frame, frame: Frame) -> None:
        """Take the samples of a step."""
        dt = frame.time - before.time
        while self._due <= frame.time * (1.0 + ROUNDING):
            way = frame.position - before.position
            s = (self._due - before.time) / dt
            moved, velocity = between(s, dt, way, before.velocity, frame.velocity, None)
            self.position.append(before.position + moved)
            self.velocity.append(velocity)
            self._due = next(self._times, np.inf)


def _copied(state: State) -> State:
    """Copy a state that may be a view of the engine's memory, since the observer keeps it until the next one."""
    arrays = (state.position, state.velocity, state.orientation, state.angular_velocity)
    position, velocity, turn, spin = (None if each is None else np.array(each, dtype=np.float64) for each in arrays)
    return State(state.time, position, velocity, turn, spin, state.contacts)
