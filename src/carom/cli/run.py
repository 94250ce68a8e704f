"""`carom run` and `carom resume`: simulate and record a scene, and continue a run."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from carom.cli.options import (
    ForceOption,
    JsonOption,
    LiveOption,
    RecordingArgument,
    SceneArgument,
    SetOption,
    ThreadsOption,
    recording_option,
    seconds,
    simulated_or_none,
)
from carom.cli.printing import say, say_json
from carom.scene.units.dimension import TIME
from carom.scene.wording import command

if TYPE_CHECKING:
    from carom.cli.progress import RunProgress
    from carom.runs.run import Outcome


def run(
    scene: SceneArgument,
    output: Annotated[Path | None, recording_option("Recording to write. Default: recordings/SCENE.rrd.")] = None,
    overrides: SetOption = None,
    check_every: Annotated[
        int | None,
        typer.Option(
            "--check-every",
            "--log-freq",
            metavar="N",
            help="Check energy and momentum every N steps. Default: as the scene says.",
            min=1,
        ),
    ] = None,
    live: LiveOption = False,
    threads: ThreadsOption = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Simulate a scene and record it to an .rrd file."""
    from carom.cli.compiling import start_on_a_new_installation

    helped = start_on_a_new_installation() is not None
    from carom.scene.schema import Scene

    changes = list(overrides or [])
    if check_every is not None:
        changes.append(f"record.check_every={check_every}")
    loaded = Scene.load(scene, changes)

    from carom.cli.compiling import announce_compilation
    from carom.recording.write.whole_file import claimed_output, default_output

    path = output or default_output(Path(scene).stem)

    with claimed_output(path, force) as claim:
        from carom.cli.progress import RunProgress, preparing, watch_look_ahead
        from carom.runs.run import recording_space, simulate

        progress = RunProgress(loaded, quiet=as_json)
        announce_compilation(progress.say, helped, loaded)
        with preparing(loaded, progress) as patience:
            space = recording_space(loaded, threads, watch_look_ahead(loaded, patience))
        progress.announce(space.scene)
        address = live_viewer() if live else None
        with progress, telling_of(path):
            outcome = simulate(space, path, claim=claim, live=address, watch=progress.update)
    report(outcome, progress, as_json)


@contextmanager
def telling_of(path: Path) -> Iterator[None]:
    """Name the repair command if a second interrupt ends the run at once."""
    try:
        yield
    except KeyboardInterrupt:
        if path.exists():  # there is no file before the first step
            say(f"carom: {path} may lack its footer; `{command('repair', path)}` writes it", err=True)
        raise


def report(outcome: Outcome, progress: RunProgress, as_json: bool) -> None:
    """Print the outcome of a run; exit with 1 unless it completed."""
    from dataclasses import asdict

    from carom.runs.outcome import in_words

    if as_json:
        say_json({"units": progress.units.recorded, **asdict(outcome), "path": str(outcome.path), "ok": outcome.ok})
    else:
        progress.summarise(outcome)
    if not outcome.ok:
        say(f"carom: {in_words(outcome.status)}: {outcome.reason}", err=True)
        raise typer.Exit(1)


def live_viewer() -> str | None:
    """Start a viewer and return its address; without a screen, report it and return None."""
    from carom.errors import RecordingError
    from carom.show.viewer import start_live_viewer

    try:
        return start_live_viewer()
    except RecordingError as error:
        typer.echo(f"carom: the run is being recorded, but cannot be shown live: {error}", err=True)
        return None


def resume(
    file: RecordingArgument,
    until: Annotated[
        float | None,
        typer.Option(
            "--until",
            parser=seconds,
            metavar="T",
            help="Continue to this simulated time. Default: the scene's duration.",
        ),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--output",
            metavar="FILE",
            help="Recording to write. Default: replace FILE when the new one is complete.",
        ),
    ] = None,
    live: LiveOption = False,
    threads: ThreadsOption = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Continue a run that was interrupted, killed or has ended; results are the same as without interruption."""
    from carom.cli.compiling import announce_compilation
    from carom.cli.progress import RunProgress
    from carom.recording.read.recording import Recording
    from carom.runs.resume import claimed_target, resumable_run, under_way
    from carom.runs.resume import continue_run as go_on

    if until is not None and not 0.0 < until < float("inf"):
        raise typer.BadParameter(f"{until:g}: expected a time later than the start", param_hint="--until")
    with claimed_target(file, output, force) as claim:
        recording = Recording.open(file)
        run = resumable_run(recording, simulated_or_none(until, recording.units))
        began = recording.units.text(run.time, TIME)
        progress = RunProgress(run.scene, quiet=as_json, heading=f"From t = {began} on: ")
        announce_compilation(progress.say)
        space = run.space(threads)
        address = live_viewer() if live else None
        with progress, telling_of(under_way(output or file)):
            outcome = go_on(run, space, output, force=force, claim=claim, live=address, watch=progress.update)
    report(outcome, progress, as_json)
