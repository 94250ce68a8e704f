"""`carom resume`: continue a run that has ended or was interrupted."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from carom.cli.options import (
    ForceOption,
    JsonOption,
    LiveOption,
    RecordingArgument,
    ThreadsOption,
    seconds,
    simulated_or_none,
)
from carom.cli.run import live_viewer, report, telling_of
from carom.scene.units.dimension import TIME


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
    from carom.cli.progress import Progress
    from carom.recording.read.recording import Recording
    from carom.runs.resume import claimed_target, resumable_run, under_way
    from carom.runs.resume import resume as go_on

    if until is not None and not 0.0 < until < float("inf"):
        raise typer.BadParameter(f"{until:g}: expected a time later than the start", param_hint="--until")
    with claimed_target(file, output, force) as claim:
        recording = Recording.open(file)
        run = resumable_run(recording, simulated_or_none(until, recording.units))
        began = recording.units.text(run.time, TIME)
        progress = Progress(run.scene, quiet=as_json, heading=f"From t = {began} on: ")
        announce_compilation(progress.say)
        space = run.space(threads)
        address = live_viewer() if live else None
        with progress, telling_of(under_way(output or file)):
            outcome = go_on(run, space, output, force=force, claim=claim, live=address, watch=progress.update)
    report(outcome, progress, as_json)
