"""Runs a scene again with shorter steps, and compares quantities that should not depend on the step.

The ledger and the bits show that a run agrees with itself; this comparison can show that the run is wrong. The run is
compared with a second one whose steps are k times as short, at a few hundred instants: positions, velocities and spins
of all bodies, overlaps, and the entries of the ledger. A quantity that differs by more than a tolerance depends on the
step, so it does not follow from the scene's laws. `shorter_steps` distinguishes chaos from a fault, and `close_look`
computes the differences that loads allow.
"""

from __future__ import annotations

import math
import time as clock
from collections.abc import Callable
from dataclasses import dataclass

from carom.errors import RecordingError, SceneError
from carom.physics.placement import place
from carom.physics.schedule import Schedule, at, every
from carom.physics.simulation import StepStatus
from carom.recording.read.lookup import interval, tolerance
from carom.recording.read.recorded_scene import recorded_scene, start_of
from carom.recording.read.recording import Recording
from carom.runs.close_look import Spaces
from carom.runs.shorter_steps import Comparison, Moved, forget_overlap
from carom.runs.window import checkpoint_before
from carom.scene.load import Scene
from carom.scene.start import names_of_solids
from carom.scene.wording import Names

FACTOR = 4.0  # default factor: an error of first order shrinks to a quarter, so three quarters of it show
INSTANTS = 200  # instants at which the runs are compared
MOST_TOLD = 8  # number of faults after which the comparison ends, since the question has been answered
TRIAL_SECONDS = 1.0  # s of stepping after which the remaining time is estimated

Consent = Callable[[float], bool]  # remaining time (s) → whether to continue
Watcher = Callable[[StepStatus], None]


@dataclass(frozen=True, slots=True)
class Refinement:
    """The comparison of a run with shorter steps."""

    factor: float
    begin: float  # s, start of the compared part
    end: float
    steps: int  # number of steps that the run made in the compared part
    refined_steps: int
    instants: int  # instants at which the runs were compared
    windows: int
    compared: float  # fraction of all bodies and instants that was compared; at the others, chaos decides
    moved: list[Moved]
    largest: dict[str, float]  # for each observable, the largest ratio of difference to tolerance
    shared: int  # groups of touching bodies that shared impulses differently, or met in another order
    differs: int | None  # first recorded step at which the repeated run's bits differ
    ended: str  # reason why the comparison ended early; empty if it did not
    seconds: float

    @property
    def same(self) -> bool:
        """Whether shorter steps give the same result, up to the end."""
        return not (self.moved or self.ended)


def refine(
    source: Scene | Recording,
    factor: float = FACTOR,
    begin: float = 0.0,
    end: float = math.inf,
    *,
    threads: int | None = None,
    instants: int = INSTANTS,
    most_steps: float = math.inf,
    consent: Consent = lambda seconds: True,
    watch: Watcher = lambda status: None,
) -> Refinement:
    """Run a scene, or a part of a recording, again with steps ``factor`` times as short, and compare both.

    A part of a recording begins at the last checkpoint before ``begin``.

    Parameters
    ----------
    source
        The scene or the recording.
    factor
        Ratio of the run's steps to the shorter steps; above 1.
    begin, end
        s, the part of a recording; by default the whole recording.
    threads
        Threads for the kernels; the result does not depend on it.
    instants
        Number of instants at which the runs are compared.
    most_steps
        Number of steps of the run after which the comparison ends.
    consent
        Called once, after a second of stepping, with the remaining time (s); returns whether to continue.
    watch
        Called at every instant with the `StepStatus` of the run.

    Returns
    -------
    result
        ``result.same`` states whether both runs agree; ``result.moved`` lists the observables that differ.

    Raises
    ------
    ValueError
        If the factor is not above 1.
    SceneError, RecordingError, PhysicsError
        If the scene or the recording cannot be run, or the state is no longer finite.
    """
    if not factor > 1.0:
        raise ValueError(f"factor = {factor:g}: steps must become shorter: give more than 1")
    scene = recorded_scene(source) if isinstance(source, Recording) else source
    if scene.admits:
        raise SceneError(
            "bodies enter and leave as a step begins, so shorter steps move them at other times: a refined run of a "
            "scene with [group.release] or [[outlet]] cannot be compared"
        )
    began = clock.perf_counter()
    bits: dict[int, int] = {}
    if isinstance(source, Recording):
        begin, end = interval(source, begin, end)
        checkpoint = checkpoint_before(source, begin)
        start = start_of(source, scene, checkpoint)
        maker = Spaces(scene, start, threads, source.check_interval)
        space = maker.space()
        if checkpoint.step > 0:
            space.restore(checkpoint)
        else:
            space.begin_as(checkpoint)
        table = source.fingerprints()
        rows = zip(*(table[name].to_pylist() for name in ("step", "fingerprint", "time")), strict=True)
        inside = [
            (step, bit, time) for step, bit, time in rows if step >= checkpoint.step and time <= end + tolerance(end)
        ]
        if not inside:
            raise RecordingError(f"{source.path} has no frame in this part")
        end = min(end, inside[-1][2])
        bits = {step: bit for step, bit, _ in inside[:: max(1, len(inside) // instants)]} | {
            inside[-1][0]: inside[-1][1]
        }
        few = len(bits) < instants / 2
        schedule: Schedule = every((end - space.time) / instants) if few else at(bits)
    else:
        start = place(source)
        maker = Spaces(scene, start, threads, None)
        space = maker.space()
        maker = Spaces(space.scene, start, threads, space.check_interval)  # the scene with its promise of an accuracy
        end = min(end, scene.time.duration)
        schedule = every(end / instants)
    comparison = Comparison(maker, factor, Names(start.name, names_of_solids(scene)))
    first_step, first_time, ended, asked = space.step, space.time, "", False
    paced, since = math.inf, math.inf  # the pace excludes the first interval, which may include a compilation
    differs: int | None = None
    try:
        for frame in space.run(schedule=schedule):
            watch(space.status)
            if frame.time > end + tolerance(end) and not isinstance(source, Scene):
                break
            if differs is None and bits.get(frame.step, frame.fingerprint) != frame.fingerprint:
                differs = frame.step
            comparison.see(frame)
            forget_overlap(space)
            now = clock.perf_counter()
            if paced == math.inf and frame.step > first_step:
                paced, since = now, frame.time
            if not asked and now - paced > TRIAL_SECONDS and frame.time > since:
                asked = True
                if not consent((now - paced) * (end - frame.time) / (frame.time - since)):
                    ended = "declined"
                    break
            if len(comparison.moved) >= MOST_TOLD:
                break
            if frame.step - first_step >= most_steps:
                break
            if bits and frame.step >= max(bits):
                break
    except KeyboardInterrupt:
        ended = "stopped by the user"
    comparison.finish()
    return Refinement(
        factor=factor,
        begin=first_time,
        end=comparison.last.time if comparison.last else first_time,
        steps=comparison.steps,
        refined_steps=comparison.refined_steps,
        instants=comparison.instants,
        windows=comparison.windows,
        compared=comparison.compared,
        moved=comparison.moved,
        largest=comparison.largest,
        shared=comparison.shared,
        differs=differs,
        ended=ended,
        seconds=clock.perf_counter() - began,
    )
