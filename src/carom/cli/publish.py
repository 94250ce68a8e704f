"""`carom publish`: a folder that any web host can serve."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from carom.cli.json_output import say_json
from carom.cli.options import JsonOption, RecordingArgument
from carom.cli.text import say
from carom.scene.wording import counted


def publish(
    file: RecordingArgument,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="DIR", help="Folder to write. Default: FILE-page, beside FILE."),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace a folder that carom published before.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Write a web page with pictures, the viewer and the recording to a folder that any static host can serve."""
    import shlex
    from dataclasses import asdict

    from carom.cli.compiling import announce_compilation
    from carom.cli.units import bytes_text
    from carom.recording.read.recording import Recording
    from carom.runs.publish import publish as make
    from carom.runs.publish import refuse_folder

    recording = Recording.open(file)
    folder = output or file.with_name(f"{file.stem}-page")
    refuse_folder(folder, force)
    announce_compilation()
    made = make(recording, folder, lambda what: say(f"Writing {what} …", err=True))
    if as_json:
        say_json({**asdict(made), "path": str(folder)})
        return
    say(f"{folder} written, {bytes_text(made.size)}: {counted(made.moments, 'moment')}.")
    if made.picture:
        say(f"Without pictures: {made.picture}", err=True)
    say("Upload it to any web host. To look at it here, run this and open http://127.0.0.1:8000:")
    say(f"    python3 -m http.server --bind 127.0.0.1 -d {shlex.quote(str(folder))}")
