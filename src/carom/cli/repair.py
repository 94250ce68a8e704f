"""`carom repair`: make a damaged recording whole."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from carom.cli.json_output import say_json
from carom.cli.options import ForceOption, JsonOption, OutputOption, RecordingArgument
from carom.cli.text import say
from carom.scene.units.dimension import TIME
from carom.scene.wording import counted


def repair(
    file: RecordingArgument,
    output: OutputOption = None,
    in_place: Annotated[
        bool,
        typer.Option("--in-place", help="Give the repaired file FILE's name and rename the damaged one to FILE.torn."),
    ] = False,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Write what can be read of a damaged recording, or of a run that was killed, to a new file."""
    from contextlib import nullcontext
    from dataclasses import asdict

    from carom.errors import RecordingError
    from carom.recording.edit.repair import repair as mend
    from carom.recording.edit.repair import units_of
    from carom.recording.read.recording import Recording
    from carom.recording.write.whole_file import Claim
    from carom.runs.output import refuse_output

    path = _path(file, output, in_place)
    torn = file.with_name(f"{file.name}.torn")
    if in_place and torn.exists() and not force:
        raise RecordingError(f"{torn}: exists, from an earlier repair; move it away, or give --force to replace it")
    refuse_output(path, force or in_place)
    with Claim(file) if in_place else nullcontext():  # a run under way looks like one that was killed
        done = mend(file, path)
        if in_place and done.path is not None:
            file.replace(torn)
            path.replace(file)
            path = file
    units = units_of(Recording.open(file if done.path is None else path))
    if as_json:
        say_json({"units": units.recorded, **asdict(done), "path": None if done.path is None else str(path)})
    elif done.path is None:
        say(f"{file}: nothing to repair.")
    else:
        reach = "no frame"
        if done.end is not None:
            reach = f"{counted(done.frames, 'frame')}, to t = {units.text(done.end, TIME)}"
        say(f"{path} written: {reach}; new: {', '.join(done.added)}.")
        for piece in done.lost:
            say(f"lost: {piece}")


def _path(file: Path, output: Path | None, in_place: bool) -> Path:
    from carom.errors import RecordingError

    if in_place and output is not None:
        raise RecordingError("give --in-place or -o, not both")
    if in_place:
        return file.with_name(f".{file.stem}.repaired.rrd")
    path = output or file.with_name(f"{file.stem}-repaired.rrd")
    if path.exists() and file.exists() and path.samefile(file):
        raise RecordingError(f"{path} is the damaged recording itself; choose another file or give --in-place")
    return path
