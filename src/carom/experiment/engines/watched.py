"""Follows another engine through a scene: its trajectory, its extremes, the laws that it breaks, and a recording."""

from __future__ import annotations

import math
import uuid
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from time import process_time as clock
from typing import TYPE_CHECKING

import numpy as np

from carom.experiment.closing import closing_of
from carom.experiment.contact_counts import ONCE_A_STEP
from carom.experiment.environment import environment
from carom.experiment.error import ExperimentError
from carom.experiment.output import claimed_output
from carom.experiment.work_precision.trajectory import FloatArray, Trajectory, between
from carom.physics.diagnostics.extremes import Extremes
from carom.physics.frame import Frame
from carom.recording.source.audit import Fault, Tolerances
from carom.recording.source.observer import Observer, header_of_source, not_finite
from carom.recording.source.source import State, setup_of
from carom.recording.write.recorder import Recorder
from carom.scene.schema import Scene
from carom.scene.units.dimension import TIME

if TYPE_CHECKING:
    from carom.experiment.engines.stepped import Simulation

ROUNDING = 1e-9  # of the duration, that the sum of the steps may lack
COMPLETED = "completed"
MOST_SEEN = 20_000  # steps that are looked at, where nothing can touch
FRAMES = 600  # of a recording, besides those in which a law is broken


@dataclass(frozen=True, slots=True)
class Watched:
    """What was seen of an engine's run."""

    outcome: str  # "completed", or why the run ended
    dt: float  # s, of the steps
    trajectory: Trajectory
    extremes: Extremes
    faults: list[Fault]  # the first of each law, in order of time
    counts: dict[str, int]  # frames that broke each law
    broken: list[tuple[float, str]]  # s and law, of every such frame


def watch(
    simulation: Simulation, scene: Scene, times: FloatArray, path: Path | None = None, limit: float = np.inf
) -> Watched:
    """Run a simulation to the end of its scene.

    Of more than `MOST_SEEN` steps between which nothing can touch, only so many are looked at.

    Parameters
    ----------
    simulation
        At its start.
    times
        (K,) s, at which it is sampled.
    path
        The ``.rrd`` to write, in place of an earlier one, if any.
    limit
        s of CPU time, after which the run is stopped.

    Raises
    ------
    ExperimentError
        If the state is no longer finite, and the run is not recorded.
    """
    model, first = simulation.source.model, simulation.source.state()
    setup = setup_of(model, first)
    observer = Observer(setup, first, Tolerances(), scene.unit_system)
    samples, met, outcome = _Samples(times), dict[tuple[int, int], float](), COMPLETED
    with ExitStack() as stack:
        recorder = None
        if path is not None:
            stack.enter_context(claimed_output(path, force=True))
            header = header_of_source(
                setup,
                title=f"{scene.title}: {setup.engine}",
                run_id=str(uuid.uuid4()),
                duration=scene.time.duration,
                exact=True,
                properties={**environment(1), "engine": setup.engine},
                units=scene.unit_system,
            )
            recorder = stack.enter_context(Recorder(path, header))
        end, due = scene.time.duration, 0.0  # s, of the next recorded frame
        frame, step = observer.frame(0, _copied(first)), 0
        if recorder:
            recorder.put(frame)
        dt, began = simulation.dt, clock()
        stride = 1 if setup.collides or dt == 0.0 else math.ceil(end / dt / MOST_SEEN)
        while frame.time < end * (1.0 - ROUNDING):
            if clock() - began > limit:
                reached = scene.unit_system.text(frame.time, TIME)
                outcome = f"failed: stopped at t = {reached}: it took more than {limit:g} s of CPU time (--limit)"
                break
            left = math.ceil((end - frame.time) / dt * (1.0 - ROUNDING)) if dt else 1
            for _ in range(min(stride, left)):
                step += 1
                simulation.step()
            state = simulation.source.state()
            fault = not_finite(setup, step, state)
            if fault is not None:
                observer.audit.note(fault)
                outcome = f"failed: {fault.text}"
                break
            before, frame = frame, observer.frame(step, _copied(state))
            samples.take(before, frame)
            for pair in frame.contacts.pairs.tolist():
                met.setdefault((pair[0], pair[1]), frame.time)
            if recorder and (frame.time >= min(due, end * (1.0 - ROUNDING)) or frame.events):
                recorder.put(frame)
                due = frame.time + end / FRAMES
        if recorder:
            recorder.finish(
                outcome, _closing(observer, frame), observer.extremes.highlights(observer.names, scene.unit_system)
            )
    if outcome != COMPLETED and path is None:
        raise ExperimentError(outcome.removeprefix("failed: "))
    audit = observer.audit
    return Watched(
        outcome=outcome,
        dt=simulation.dt,
        trajectory=_trajectory(observer, samples, met, frame, times),
        extremes=observer.extremes,
        faults=sorted(audit.first.values(), key=lambda fault: fault.step),
        counts=audit.counts,
        broken=audit.broken,
    )


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


def _trajectory(
    observer: Observer, samples: _Samples, met: dict[tuple[int, int], float], last: Frame, times: FloatArray
) -> Trajectory:
    extremes, count = observer.extremes, len(samples.position)
    n = len(observer.setup)
    return Trajectory(
        time=times[:count],
        position=np.array(samples.position).reshape(count, n, 3),
        velocity=np.array(samples.velocity).reshape(count, n, 3),
        pair=np.array(list(met), dtype=np.int64).reshape(-1, 2),
        met=np.array(list(met.values())),
        energy_error=extremes.energy_error.value if extremes.energy_error else 0.0,
        energy_gain=extremes.energy_gain.value,
        momentum_error=extremes.momentum_error.value if extremes.momentum_error else np.nan,
        angular_momentum_error=extremes.angular_momentum_error.value if extremes.angular_momentum_error else np.nan,
        overlap=(extremes.overlap.value if extremes.overlap else 0.0) if observer.setup.collides else np.nan,
        sinking=np.nan,
        impacts=extremes.impacts,
        steps=last.step,
        frames=0,
    )


def _closing(observer: Observer, last: Frame) -> dict[str, str | int | float | bool]:
    audit = observer.audit
    found: dict[str, str | int | float | bool] = {
        "steps": last.step,
        "sim_time": last.time,
        "contacts.impacts_counted": ONCE_A_STEP,
    }
    return found | closing_of(observer.extremes.named(observer.names)) | dict(audit.closing())


def _copied(state: State) -> State:
    """Copy a state that may be a view of the engine's memory: the observer keeps it until the next."""
    arrays = (state.position, state.velocity, state.orientation, state.angular_velocity)
    position, velocity, turn, spin = (None if each is None else np.array(each, dtype=np.float64) for each in arrays)
    return State(state.time, position, velocity, turn, spin, state.contacts)
