"""`carom report`: one file to attach to a bug report."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from carom.cli.json_output import say_json
from carom.cli.options import ForceOption, JsonOption, RecordingArgument, seconds, simulated_or_none
from carom.cli.text import say
from carom.scene.units.dimension import TIME
from carom.scene.wording import counted


def report(
    file: RecordingArgument,
    at: Annotated[
        float | None,
        typer.Option(
            "--at", parser=seconds, metavar="T", help="Simulated time to report. Default: the worst moment of the run."
        ),
    ] = None,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", metavar="ZIP", help="Zip to write. Default: FILE-report.zip.")
    ] = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Pack a bug report into a zip of less than 10 MB: clip, scene, picture, versions and a summary to paste."""
    from dataclasses import asdict

    from carom.cli.compiling import announce_compilation
    from carom.cli.units import bytes_text
    from carom.recording.read.recording import Recording
    from carom.runs.output import refuse_output
    from carom.runs.report import report as make

    recording = Recording.open(file)
    path = output or file.with_name(f"{file.stem}-report.zip")
    refuse_output(path, force)
    announce_compilation()
    made = make(recording, path, simulated_or_none(at, recording.units))
    if as_json:
        say_json({"units": recording.units.recorded, **asdict(made), "path": str(path)})
        return
    when = recording.units.text(made.time, TIME, ".9g")
    say(f"{path} written, {bytes_text(made.size)}: {counted(made.frames, 'frame')} around t = {when},")
    say(f"{made.why.splitlines()[0]}.")
    say(made.replayed.replace("**", ""))
    if made.picture:
        say(f"Without a picture: {made.picture}", err=True)
    accepts = "" if not made.replays else "; `carom replay` accepts the zip"
    say(f"Paste its README.md into an issue and attach the zip{accepts}.")
