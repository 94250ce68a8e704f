"""Resumes a run; the result has the same bits as one uninterrupted run."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

from carom.errors import RecordingError
from carom.physics.schedule import every
from carom.physics.space import Space
from carom.plan.auto import frame_interval, integrator, largest_step
from carom.recording.read.frame_rows import Continuation
from carom.recording.read.recorded_scene import recorded_scene
from carom.recording.read.recording import Recording
from carom.recording.timelines import STEP
from carom.recording.write.whole_file import Claim, claimed_output, refuse_name, refuse_output
from carom.runs.environment import environment
from carom.runs.run import Outcome, Watcher, recording_of, simulate, watched
from carom.runs.window import space_of
from carom.scene.extensions import extensions_of, of_extensions
from carom.scene.integrators import AUTO
from carom.scene.load import Scene
from carom.scene.units.dimension import TIME
from carom.scene.wording import command
from carom.state.checkpoint import Checkpoint


@dataclass(frozen=True)
class ResumableRun:
    """A recording that can be resumed: its scene, and the checkpoint from which it continues."""

    recording: Recording
    scene: Scene
    step: int  # step of the checkpoint
    time: float  # s, time of the checkpoint
    # the checkpoint; dropped once a space has its state
    _read: list[Checkpoint] = field(default_factory=list, repr=False)

    def space(self, threads: int | None = None) -> Space:
        """Build the space, which compiles kernels if necessary."""
        records = self.recording.records_contacts  # both parts of the file then have the same entities
        checkpoint = self._read.pop() if self._read else self.recording.checkpoint(self.step)
        return space_of(self.recording, self.scene, checkpoint, threads, record_contacts=records)


def resumable_run(recording: Recording, until: float | None = None) -> ResumableRun:
    """Find the checkpoint from which a recording can be resumed up to a time (s), by default the end of its scene.

    The interval of frames stays the same. Raises SceneError, or RecordingError if there is nothing left to run or no
    checkpoint to resume from. A clip cannot be continued, because the run before it is missing.
    """
    recording.refuse_some_bodies()
    scene, path = recorded_scene(recording), recording.path
    cut = scene.end
    recording.require_frames()
    if recording.fingerprints()["step"][0].as_py() != 0:
        raise RecordingError(f"{path} does not begin at step 0: resume the recording from which it was cut")
    done, end = float(recording.fingerprints()["time"][-1].as_py()), until or cut
    if end == done and not recording.closing:
        raise RecordingError(
            f"{path} has all its frames and lacks only its footer; `{command('repair', path)}` writes it"
        )
    if end <= done:
        hint = "give a later --until" if end == done else "`carom clip` makes it shorter"
        raise RecordingError(f"{path} has been simulated to {scene.unit_system.text(done, TIME, 'g')} already; {hint}")
    if end != cut:
        changes = [f"time.duration={scene.unit_system.literal(end, TIME)}"]
        if cut < scene.time.duration:  # the run ended at the time up to which its accuracy is kept
            changes.append("time.after_horizon=")
        scene = continued_scene(recording, scene, changes)
    # The last step of a completed run was shortened, and a longer run would not have shortened it. A stopped run has a
    # frame at its last step, and an uninterrupted run would not have this frame.
    added = _stopped_at(recording, scene)
    steps = [step for step, time in recording.checkpoint_times.items() if time < cut and step != added]
    if not steps:
        raise RecordingError(f"{path} has no checkpoint to resume from")
    checkpoint = recording.checkpoint(steps[-1])
    return ResumableRun(recording, scene, checkpoint.step, checkpoint.time, [checkpoint])


def _stopped_at(recording: Recording, scene: Scene) -> int | None:
    """Return the step of the last frame if the interval of frames does not explain that frame; otherwise None."""
    frames = recording.fingerprints()
    if frames.num_rows < 2:
        return None
    (_, before), (step, time) = ((frames[STEP][k].as_py(), frames["time"][k].as_py()) for k in (-2, -1))
    return None if every(frame_interval(scene))(step, before, time) else int(step)


def resume(
    recording: Recording | str | Path,
    until: float | None = None,
    path: str | Path | None = None,
    *,
    force: bool = False,
    threads: int | None = None,
    watch: Watcher | None = None,
    progress: bool = False,
) -> Recording:
    """Continue a run that was interrupted, killed or has ended; the result equals an uninterrupted run.

    Parameters
    ----------
    recording
        The recording to continue, or its file. Clips cannot be continued.
    until
        s, the simulated time at which the run ends; by default the duration of the scene.
    path
        The ``.rrd`` to write; by default, the new recording replaces the old one once it is complete.
    force
        Whether to replace another file, and the file of an earlier attempt.
    threads
        Threads for the kernels; the bits do not depend on it.
    watch
        Called several times a second, and at the end, with a `StepStatus`: step, time in s, dt, contacts, energy error.
    progress
        Whether to show a progress bar, in a terminal or a notebook.

    Returns
    -------
    recording
        The whole run, opened.

    Raises
    ------
    SceneError, RecordingError, PhysicsError
        If the run has already reached that time, the recording cannot be continued, the file cannot be written, or the
        state becomes infinite.
    KeyboardInterrupt
        If the interrupt key, SIGTERM or SIGHUP stopped the run. The recording is then complete up to the stop.
    """
    source = recording.path if isinstance(recording, Recording) else Path(recording)
    target = None if path is None else Path(path)
    with claimed_target(source, target, force) as claim:
        run = resumable_run(recording if isinstance(recording, Recording) else Recording.open(source), until)
        space = run.space(threads)
        with watched(run.scene, watch, progress) as report:
            outcome = continue_run(run, space, target, force=force, claim=claim, watch=report)
            report(space.status)
    return recording_of(outcome)


@contextlib.contextmanager
def claimed_target(source: Path, output: Path | None, force: bool) -> Iterator[Claim]:
    """Claim the files that a resumed run of ``source`` will write, before anything is read; see `continue_run`.

    Raises RecordingError if a file is in the way, or another process writes it.
    """
    if output is not None:
        refuse_name(output)
    target = output or source
    in_place = target.resolve() == source.resolve()
    if under_way(target).resolve() == source.resolve():
        raise RecordingError(f"{target} would be written as {source} until it is complete; name another file")
    with claimed_output(target, force or in_place) as claim:
        refuse_output(under_way(target), force)
        yield claim


def continue_run(
    run: ResumableRun,
    space: Space,
    output: Path | None = None,
    *,
    force: bool = False,
    claim: Claim | None = None,
    live: str | None = None,
    watch: Watcher | None = None,
) -> Outcome:
    """Resume a run in a space made by `ResumableRun.space`, and record it from its start; see also `simulate`.

    The new recording is called ``NAME.resumed.rrd`` until it is complete. The finished file then replaces ``output``,
    by default the old recording. If the disk runs full, the new file keeps its temporary name, and the old recording is
    unchanged. Raises RecordingError if the recording cannot be written at all, or has changed since it was opened.

    Parameters
    ----------
    force
        Whether to replace another file, and the file of an earlier attempt.
    claim
        The claim made by `claimed_target`, if the caller made it before it opened the recording.
    """
    source = run.recording.path
    with contextlib.nullcontext(claim) if claim else claimed_target(source, output, force):
        if Recording.open(source).store != run.recording.store:
            raise RecordingError(f"{source} has changed since it was opened; resume it again")
        target = output or source
        part = under_way(target)
        first = {key: value for key, value in run.recording.properties.items() if isinstance(value, str | int | float)}
        used = of_extensions(extensions_of(space.scene))
        now = {f"resumed.{key}": value for key, value in environment(space.threads, used).items()}
        outcome = simulate(
            space,
            part,
            force=force,
            live=live,
            watch=watch,
            continued=Continuation(run.recording, run.step),
            properties=first | now | {"resumed.step": run.step, "resumed.time": run.time},
        )
        if outcome.sim_time <= run.recording.fingerprints()["time"][-1].as_py():
            part.unlink(missing_ok=True)
            raise RecordingError(f"{source} is unchanged: {outcome.status}: {outcome.reason}")
        if outcome.status in ("disk", "error"):
            return replace(outcome, reason=f"{outcome.reason}; {source} is unchanged, and {part} has the new frames")
        part.replace(target)
        return replace(outcome, path=target)


def under_way(target: Path) -> Path:
    """Return the path to which a resumed run is recorded until it is complete."""
    return target.with_name(f"{target.stem}.resumed.rrd")


def continued_scene(recording: Recording, scene: Scene, overrides: list[str]) -> Scene:
    """Return the ``scene`` of a recording with overrides, for a run that continues from one of its checkpoints.

    Some values of "auto" depend on the duration: the interval between frames, the integrator of orbits, and the longest
    step. These values do not change unless the overrides set them.

    Raises
    ------
    SceneError, RecordingError
        As for `recorded_scene`, or if an override contradicts the integrator.
    """
    changed = recorded_scene(recording, overrides)
    interval, chosen, kept = frame_interval(scene), integrator(scene).name, list(overrides)
    if changed.record.every == "auto" and frame_interval(changed) != interval:
        kept.append(f"record.every={scene.unit_system.literal(interval, TIME)}")
    longest = largest_step(scene)
    if changed.time.max_dt == AUTO and math.isfinite(longest) and largest_step(changed) != longest:
        kept.append(f"time.max_dt={scene.unit_system.literal(longest, TIME)}")
    if changed.time.integrator == AUTO and integrator(changed).name != chosen:
        kept.append(f"time.integrator={chosen}")
    return recorded_scene(recording, kept) if len(kept) > len(overrides) else changed
