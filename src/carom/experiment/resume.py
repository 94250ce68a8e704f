"""Go on with a run that has ended, or was ended: the result is what one uninterrupted run would have given."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from carom.experiment.environment import environment
from carom.experiment.output import refuse_output
from carom.experiment.recorded import recorded_scene, space_of
from carom.experiment.run import Outcome, Watcher, simulate
from carom.physics.checkpoint import Checkpoint
from carom.physics.space import Space
from carom.recording.errors import RecordingError
from carom.recording.header import Scalar
from carom.recording.past import Past
from carom.recording.recording import Recording
from carom.scene.requirements import frame_interval
from carom.scene.schema import Scene

UNDER_WAY = ".resumed.rrd"  # what the new recording is called until it is whole


@dataclass(frozen=True)
class Continuation:
    """A run that is ready to go on."""

    recording: Recording
    scene: Scene
    checkpoint: Checkpoint

    def space(self, threads: int | None = None) -> Space:
        """Build the space, which compiles kernels if need be."""
        return space_of(self.recording, self.scene, self.checkpoint, threads)


def continuation(recording: Recording, until: float | None = None) -> Continuation:
    """Find where a recording can be gone on from, and how.

    Parameters
    ----------
    recording
        A clip cannot be continued: what was before it is missing.
    until
        s of simulated time, by default the duration of the scene. Frames keep the interval that they had.

    Raises
    ------
    SceneError, RecordingError
        If there is nothing to do, or nothing to go on from.
    """
    scene, path = recorded_scene(recording), recording.path
    cut = scene.time.duration
    if recording.frames == 0 or recording.fingerprints()["step"][0].as_py() != 0:
        raise RecordingError(f"{path} does not begin at step 0: go on with the recording that it was cut from")
    done, end = float(recording.fingerprints()["time"][-1].as_py()), until or cut
    if end <= done:
        hint = "give a later --until" if end == done else "`carom clip` makes it shorter"
        raise RecordingError(f"{path} has been simulated to {done:g} s already; {hint}")
    if end != cut:
        interval = frame_interval(scene)
        every = '"step"' if interval == 0.0 else repr(interval)
        scene = recorded_scene(recording, [f"time.duration={end!r}", f"record.every={every}"])
    # the last step of a run that has got to its end was cut short, which a longer run would not have done
    steps = [step for step, time in recording.checkpoint_times.items() if time < cut]
    if not steps:
        raise RecordingError(f"{path} has no checkpoint to go on from")
    return Continuation(recording, scene, recording.checkpoint(steps[-1]))


def resume(
    run: Continuation,
    space: Space,
    output: Path | None = None,
    *,
    force: bool = False,
    live: str | None = None,
    watch: Watcher | None = None,
) -> Outcome:
    """Go on with a run and record the whole of it.

    Parameters
    ----------
    run, space
        As made by `continuation` and `Continuation.space`.
    output
        The ``.rrd`` to write; by default the recording itself, which is replaced once the new one has more frames.
    force
        Whether to replace another file.
    live, watch
        As for `simulate`.

    Raises
    ------
    RecordingError
        If the recording cannot be written at all.
    """
    source = run.recording.path
    if output is not None and output.resolve() != source.resolve():
        refuse_output(output, force)
    target = output or source
    under_way = target.with_name(target.stem + UNDER_WAY)
    past = Past(run.recording, run.checkpoint.step)
    outcome = simulate(
        space, under_way, force=True, live=live, watch=watch, past=past, properties=_properties(run, space.threads)
    )
    if outcome.frames <= run.recording.frames:
        under_way.unlink(missing_ok=True)
        raise RecordingError(f"{source} is as it was: {outcome.status}: {outcome.reason}")
    under_way.replace(target)
    return replace(outcome, path=target)


def _properties(run: Continuation, threads: int) -> Mapping[str, Scalar]:
    """Say where the first part came from, and where, when and by what it was continued."""
    first = {key: value for key, value in run.recording.properties.items() if isinstance(value, str | int | float)}
    now = {f"resumed.{key}": value for key, value in environment(threads).items()}
    return first | now | {"resumed.step": run.checkpoint.step, "resumed.time": run.checkpoint.time}
