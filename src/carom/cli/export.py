"""`carom export`: bodies of a recording for other tools."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from carom.cli.options import ForceOption, RecordingArgument, StepTimeOption, simulated_or_none
from carom.cli.text import say
from carom.scene.units.dimension import TIME
from carom.scene.wording import counted


def export(
    file: RecordingArgument,
    output: Annotated[
        Path,
        typer.Option("-o", "--output", metavar="FILE", help="File to write: .parquet, .csv, .npz, .vtk or .extxyz."),
    ],
    at: StepTimeOption = None,
    everything: Annotated[bool, typer.Option("--all", help="All recorded frames, not one step.")] = False,
    force: ForceOption = False,
) -> None:
    """Write the bodies, in double precision, for ParaView, OVITO, pandas or NumPy; of a clip, those that it shows.

    States between checkpoints are computed again. With --all, a .vtk becomes a folder of files and a .vtk.series.
    """
    from carom.cli.replaying import replaying
    from carom.errors import RecordingError
    from carom.recording.edit.bundle import opened
    from carom.recording.export.export import VTK, refuse_format, refuse_series, series_of, snapshots, write
    from carom.recording.read.recording import Recording
    from carom.runs.output import refuse_output

    refuse_format(output)
    if everything and at is not None:
        raise RecordingError("give --at or --all, not both")
    if everything and output.suffix == VTK:
        refuse_output(series_of(output)[0], force)
        refuse_series(output, force)
    else:
        refuse_output(output, force)
    with opened(file) as path:
        recording = Recording.open(path)
        recording.refuse_overlay()
        with replaying(recording) as watch:
            at = simulated_or_none(at, recording.units)
            steps, when = snapshots(recording, at, everything=everything, watch=watch), ""
            if not everything:  # a moment stands for the end of its step
                one = next(steps)
                steps, when = iter([one]), f", t = {recording.units.text(one.state.time, TIME, '.9g')}"
            written, count = write(output, steps, everything)
        bodies = len(recording.shown)
    say(f"{written} written: {counted(count, 'step')} of {counted(bodies, 'body')}{when}.")
