"""Runs a scene: physics in one thread, the recorder in another; the caller can watch and stop it."""

from __future__ import annotations

import contextlib
import threading
import time
import uuid
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

from carom.errors import PhysicsError, RecorderError, RecordingError, status_of
from carom.event import Event
from carom.physics.look_ahead.trial_run import Watcher as LookAheadWatcher
from carom.physics.simulation import StepStatus
from carom.physics.space import Space
from carom.plan.room import refuse_small_disk
from carom.recording.read.frame_rows import Continuation
from carom.recording.read.recorded_impacts import RecordedImpacts
from carom.recording.read.recording import Recording
from carom.recording.schema.header import Header, Scalar, ShownMaterials, SweepMember, motions_of
from carom.recording.write.recorder import FrameRecorder
from carom.recording.write.whole_file import Claim, claimed_output, default_output, refuse_name
from carom.runs.environment import Interrupts, collecting_garbage_rarely, environment
from carom.runs.outcome import EACH, ONCE_A_STEP, Verdict, closing_of, description, judge
from carom.scene.extensions import extensions_of, of_extensions
from carom.scene.load import Scene
from carom.scene.pistons import pistons_of
from carom.scene.schema.settings import LARGEST_ACCURACY
from carom.scene.start import InitialBodies, planes_of
from carom.scene.units.dimension import TIME
from carom.scene.units.system import UnitSystem
from carom.state.books import Extremes

POLL = 0.1  # s between two checks of a running simulation

Watcher = Callable[[StepStatus], None]


@dataclass(frozen=True)
class Outcome:
    """How a run ended."""

    path: Path
    # "completed", "expectation missed", "interrupted", "failed", "disk", or "error" (an error of the recorder)
    status: str
    reason: str  # a sentence; empty when completed
    frames: int
    steps: int
    sim_time: float  # s
    wall_time: float  # s, wall time of the run from `begin` on
    size: int  # bytes of the file
    payload: int  # bytes of the file's arrays alone
    moments: Extremes = field(repr=False)
    verdicts: list[Verdict] = field(default_factory=list)
    warnings: list[Event] = field(default_factory=list)  # all warnings of the run, in order of time
    impacts_counted: str = EACH  # `EACH` or `ONCE_A_STEP`
    impacts: RecordedImpacts | None = None  # numbers of impacts; None if the scene records no impacts
    # values of `kept_accuracy`; empty if no accuracy was requested
    accuracy: dict[str, float] = field(default_factory=dict)
    begin: float = 0.0  # s, time from which a resumed run continued

    @property
    def ok(self) -> bool:
        """Whether the run completed and kept its promises."""
        return self.status == "completed"


def run(
    scene: Scene | str | Path,
    path: str | Path | None = None,
    *,
    force: bool = False,
    threads: int | None = None,
    watch: Watcher | None = None,
    progress: bool = False,
) -> Recording:
    """Simulate a scene and record it.

    Parameters
    ----------
    scene
        The scene to simulate, a file, or the name of a bundled scene.
    path
        The ``.rrd`` to write; by default one in the folder ``recordings`` with the name of the scene's file.
    force
        Whether to replace a file that exists.
    threads
        Threads for the kernels; the bits do not depend on it.
    watch
        Called several times a second, and at the end, with a `StepStatus`: step, time in s, dt, contacts, energy error.
    progress
        Whether to show a progress bar, in a terminal or a notebook.

    Returns
    -------
    recording
        The file, opened.

    Raises
    ------
    SceneError, RecordingError, PhysicsError
        If the scene cannot run, the file cannot be written, or the state is no longer finite.
    ValueError
        If the number of threads is not whole or less than 1.
    KeyboardInterrupt
        If the interrupt key, SIGTERM or SIGHUP stopped the run. The recording is then complete up to the stop.
    """
    loaded = scene if isinstance(scene, Scene) else Scene.load(scene)
    if path is None:
        path = default_output("scene" if isinstance(scene, Scene) else Path(scene).stem)
    refuse_name(Path(path))
    with claimed_output(Path(path), force) as claim, watched(loaded, watch, progress) as report:
        space = recording_space(loaded, threads)
        outcome = simulate(space, path, claim=claim, watch=report)
        report(space.status)
    return recording_of(outcome)


def recording_of(outcome: Outcome) -> Recording:
    """Open the recording of a completed run; otherwise raise the error or interrupt that ended it."""
    if outcome.status == "disk":
        raise RecordingError(outcome.reason)
    if outcome.status == "error":
        raise RecorderError(outcome.reason)
    if outcome.status == "failed":
        raise PhysicsError(outcome.reason)
    # the file is complete up to the interrupt, but the caller's program must end, too
    if outcome.status == "interrupted":
        raise KeyboardInterrupt(outcome.reason)
    return Recording.open(outcome.path)


def recording_space(
    scene: Scene,
    threads: int | None = None,
    watch_look_ahead: LookAheadWatcher | None = None,
    start: InitialBodies | None = None,
    stride: float = 1.0,
) -> Space:
    """Build a space whose frames carry all data for the scene's recording; for the parameters, see `Space`.

    Raises
    ------
    SceneError
        If the scene cannot run.
    """
    recorded = scene.record.impacts != "none"
    return Space(scene, threads, start, stride, record_contacts=recorded, watch_look_ahead=watch_look_ahead)


def simulate(
    space: Space,
    path: str | Path,
    *,
    force: bool = False,
    claim: Claim | None = None,
    live: str | None = None,
    watch: Watcher | None = None,
    continued: Continuation | None = None,
    properties: Mapping[str, Scalar] | None = None,
    member: SweepMember | None = None,
) -> Outcome:
    """Run a space to the end of its scene and record it.

    The interrupt key, SIGTERM and SIGHUP end the run early, with a closed file. A second interrupt raises
    KeyboardInterrupt, and leaves the file unfinished.

    Parameters
    ----------
    space
        The space, at the start of its run.
    path
        The ``.rrd`` to write.
    force
        Whether to replace a file that exists.
    claim
        The claim of the path, if the caller made one after it checked ``force``.
    live
        Address of a viewer that shows the run while it is written, such as ``127.0.0.1:9876``.
    watch
        Called about ten times a second with the progress of the run.
    continued
        The frames that a resumed run continues; they are written first.
    properties
        Provenance for the recording; by default the provenance of this process.
    member
        The run's place in a sweep.

    Raises
    ------
    RecordingError
        If the file exists and ``force`` is not given, another run writes it, or it cannot be written at all.
    """
    path = Path(path)
    claimed = contextlib.nullcontext(claim) if claim else claimed_output(path, force)
    with Interrupts() as interrupts, claimed, collecting_garbage_rarely():
        began, begin = time.perf_counter(), space.time
        refuse_small_disk(space.scene, path.absolute().parent, begin)
        header = header_of(space)
        if properties is not None:
            header = replace(header, properties=properties)
        if member is not None:
            header = replace(header, member=member, properties={**header.properties, "command": member.command})
        recorder = FrameRecorder(path, header, live=live, continued=continued)
        physics = _Physics(space, recorder, continued)
        try:
            # watches the run until it ends, or ends it on request
            while not physics.wait(POLL):
                if interrupts.count:
                    space.stop()
                try:
                    if watch:
                        watch(space.status)
                except KeyboardInterrupt:  # the calling program's own signal handler raised it
                    if interrupts.count:
                        raise
                    interrupts.count = 1
            status, reason = physics.ending(interrupts)
        except Exception as error:
            space.stop()
            physics.wait()
            with contextlib.suppress(RecordingError):
                recorder.finish(f"failed: {type(error).__name__}: {error}")
            raise
        except KeyboardInterrupt:  # a second interrupt: do not wait for the current step
            space.stop()
            raise
        extremes = space.named_extremes()
        verdicts = judge(space.scene, extremes, space.time, space.state)
        if status == "completed":
            status, reason = ending_of(verdicts, space.scene.unit_system)
        summary = {"wall_time": time.perf_counter() - began, **closing_summary(space, extremes, verdicts)}
        try:
            recorder.finish(outcome_text(status, reason), summary, space.highlights())
        except RecordingError as error:
            status, reason = status_of(error), str(error)
        return Outcome(
            path=path,
            status=status,
            reason=reason,
            frames=recorder.frames,
            steps=space.step,
            sim_time=space.time,
            wall_time=time.perf_counter() - began,
            size=path.stat().st_size if path.exists() else 0,
            payload=recorder.payload_bytes,
            moments=extremes,
            verdicts=verdicts,
            warnings=physics.warnings,
            impacts_counted=_impacts_counted(space),
            impacts=recorder.impacts,
            accuracy=kept_accuracy(space.scene),
            begin=begin,
        )


def ending_of(verdicts: list[Verdict], units: UnitSystem) -> tuple[str, str]:
    """Return the status and the reason of a completed run, by its promises."""
    missed = [verdict.text(units) for verdict in verdicts if not verdict.met]
    return ("expectation missed", "; ".join(missed)) if missed else ("completed", "")


def outcome_text(status: str, reason: str) -> str:
    """Return the recorded text of the outcome."""
    return f"{status}: {reason}" if reason else status


class _Physics:
    """The physics thread: steps a space and passes its frames to the recorder."""

    def __init__(self, space: Space, recorder: FrameRecorder, continued: Continuation | None) -> None:
        self._space = space
        self.warnings = continued.recording.warnings(until=continued.step) if continued else []
        self._known = continued.step if continued else -1  # step of the recorder's last frame
        self._recorder = recorder
        self._error: Exception | None = None
        self._thread = threading.Thread(target=self._run, name="physics", daemon=True)
        self._thread.start()

    def wait(self, seconds: float | None = None) -> bool:
        """Wait for the end, up to a timeout; return whether it has come."""
        self._thread.join(seconds)
        return not self._thread.is_alive()

    def ending(self, interrupts: Interrupts) -> tuple[str, str]:
        """Return the status of the end, and its reason."""
        scene, time = self._space.scene, self._space.time
        at = f"at t = {scene.unit_system.text(time, TIME)}"
        match self._error:
            case None if interrupts.count and time < scene.end:
                return "interrupted", f"stopped by {interrupts.sender} {at}"
            case None:
                return "completed", ""
            case RecordingError():
                return status_of(self._error), f"{self._error} {at}"
            case PhysicsError():
                return "failed", str(self._error)
            case MemoryError():
                return "failed", f"out of memory {at}; use fewer bodies, or raise the memory limit (`ulimit -v`)"
        raise self._error

    def _run(self) -> None:
        try:
            for frame in self._space.run(store=self._recorder.store_for(self._space.state)):
                if frame.step > self._known:
                    self._recorder.put(frame)
                    self.warnings += [event for event in frame.events if event.level == "WARN"]
        except Exception as error:
            self._error = error


def header_of(space: Space) -> Header:
    """Return the header of a recording of a space."""
    scene, needs, state = space.scene, space.requirements, space.state
    extensions = extensions_of(scene)
    return Header(
        title=scene.title,
        description=scene.description or description(scene.toml),
        scene_toml=scene.toml,
        seed=scene.seed,
        run_id=str(uuid.uuid4()),
        names=space.names,
        group=space.groups,
        mass=space.mass.copy(),
        radius=state.radius.copy(),
        inertia=state.inertia.copy(),
        spins=needs.spin.modelled,
        has_orientation=needs.orientation.modelled,
        has_torque=needs.torque.modelled,
        has_friction=needs.friction.modelled,
        forces=frozenset(name for name, part in needs.forces.items() if part.modelled),
        collides=needs.contact.modelled,
        stabilises=needs.stabilisation.modelled,
        body_colouring=scene.contact.colouring == "bodies",
        duration=scene.time.duration,
        units=scene.unit_system,
        check_interval=space.check_interval,
        promises=scene.promise is not None,
        drives=bool(scene.translating) or any(wall.moves for wall in scene.wall),
        motions=motions_of(scene),
        pistons=tuple(pistons_of(scene)),
        outlets=scene.outlet_names,
        entries=space.entries if scene.admits else None,
        has_driving_field=any(scene.driving_field),
        shear=scene.domain.shear,
        shortest_dt_hint=space.first_dt,
        record_impacts=scene.record.impacts if space.records_contacts else "none",
        box=space.box,
        walls=np.array(scene.domain.size) if scene.domain.walled else None,
        planes=planes_of(scene) if scene.plane else None,
        shapes=scene.wall or None,
        colour_by=scene.record.colour_by,
        extensions=extensions,
        data=scene.data,
        data_notes=scene.notes,
        materials=ShownMaterials.of(scene),
        properties=dict(environment(space.threads, of_extensions(extensions))),
    )


def kept_accuracy(scene: Scene) -> dict[str, float]:
    """Return the requested accuracy, the time (s) up to which it is kept, and the largest Lyapunov exponent (1/s).

    The key ``horizon`` exists only if the promise ends before the run, ``looked`` (s) only if the look-ahead ran out of
    budget.
    """
    promise, requested = scene.promise, scene.time.accuracy
    if promise is None or requested is None:
        return {}
    kept = {"requested": requested, "kept_until": promise.kept_until, "lyapunov": promise.lyapunov}
    kept |= {} if promise.looked is None else {"looked": promise.looked}
    return kept | ({} if promise.kept_until >= scene.time.duration else {"horizon": promise.kept_until})


def shortfall_text(scene: Scene) -> str:
    """Explain why the accuracy of a scene is not promised to the end; empty if it is."""
    promise, accuracy, units = scene.promise, scene.time.accuracy, scene.unit_system
    if promise is None or accuracy is None or promise.horizon is None:
        return ""
    if promise.is_extrapolated:
        looked = units.text(promise.looked or 0.0, TIME, ".4g")
        why = f"its error, extrapolated from t = {looked} on, grows beyond this accuracy"
    elif promise.looked is not None:
        why = f"the budget of the trial runs ended at t = {units.text(promise.looked, TIME, '.4g')}"
    else:
        why = "its error grows beyond this accuracy, first where bodies are fastest"
    text = f"cannot promise accuracy = {accuracy:g} to the end: {why}; it is kept up to t = "
    text += units.text(promise.horizon, TIME, ".4g")
    text += ", where the run ends" if scene.time.after_horizon == "end" else ", and ordinary steps go on from there"
    if promise.looked is None and accuracy < promise.error[-1] <= LARGEST_ACCURACY:
        text += f"; {promise.error[-1]:.1g} can be promised to the end"
    return text


def _impacts_counted(space: Space) -> str:
    return EACH if space.requirements.impact_time.modelled else ONCE_A_STEP


def closing_summary(space: Space, extremes: Extremes, verdicts: list[Verdict]) -> dict[str, Scalar]:
    """Return the recording's closing properties, under dotted keys."""
    summary: dict[str, Scalar] = {
        "steps": space.step,
        "sim_time": space.time,
        "contacts.impacts_counted": _impacts_counted(space),
    }
    summary |= closing_of(extremes)
    summary |= {f"accuracy.{name}": value for name, value in kept_accuracy(space.scene).items()}
    for part, seconds in space.profile.seconds().items():
        summary[f"profile.{part}"] = seconds
    for verdict in verdicts:
        key = f"expect.{verdict.name}"
        summary |= {f"{key}.bound": verdict.bound, f"{key}.limit": verdict.limit}
        summary |= {f"{key}.measured": verdict.measured, f"{key}.met": verdict.met, f"{key}.judged": verdict.judged}
        if verdict.worst is not None:
            summary |= {f"{key}.time": verdict.worst.time, f"{key}.between": verdict.worst.between}
    return summary


@contextlib.contextmanager
def watched(scene: Scene, watch: Watcher | None, progress: bool) -> Iterator[Watcher]:
    """Yield a function that passes the status to ``watch`` and, if requested, to a progress bar."""
    report = watch or (lambda status: None)
    if not progress:
        yield report
        return
    end, units = scene.time.duration, scene.unit_system
    columns = TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TextColumn("{task.fields[now]}")
    with Progress(*columns, TimeRemainingColumn()) as shown:
        task = shown.add_task(scene.title, total=end, now="")

        def move(status: StepStatus) -> None:
            report(status)
            now = f"t = {units.text(status.time, TIME, '.5g')}, step {status.step}, {status.contacts} contacts"
            shown.update(task, completed=min(status.time, end), now=now)

        yield move
