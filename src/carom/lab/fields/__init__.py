"""`carom fields`: bodies and contacts of a recording, averaged in the cells of a grid."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from carom.scene.units.dimension import LENGTH, TIME
from carom.scene.wording import counted
from carom.terminal.given_moment import typed_time_or_none
from carom.terminal.options import (
    ForceOption,
    JsonOption,
    OptionalTime,
    RecordingArgument,
    output_option,
    time_option,
)
from carom.terminal.printing import say, say_json

_CELL = 'Edge of a cell: a length such as 0.1 or "3 cm", or mean radii of the bodies such as 5r.'
_REPLAY = "Recompute the steps, for all impacts with their friction, and for up to 64 states."


def fields_command(
    file: RecordingArgument,
    output: Annotated[Path, output_option("FILE", "File to write: .vti, .npz, .png or .svg.")],
    cell: Annotated[str, typer.Option("--cell", metavar="LENGTH|Nr", help=_CELL)] = "5r",
    start: Annotated[OptionalTime, time_option("--from", "First time of the mean.")] = None,
    end: Annotated[OptionalTime, time_option("--to", "Last time of the mean.")] = None,
    again: Annotated[bool, typer.Option("--replay", help=_REPLAY)] = False,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Average solid fraction, velocity, temperature, stress and coordination in cells, for ParaView or as a picture.

    A .vti is VTK image data, an .npz has the arrays for NumPy, and a .png or .svg shows means over the depth. The mean
    is over exact states of the recording, and over the impacts between its first and last frame. FILE may be the zip
    that `carom report` made.
    """
    from carom.lab.fields.field_arrays import UNITS
    from carom.lab.fields.fields import fields
    from carom.recording.edit.bundle import opened
    from carom.recording.read.recording import Recording
    from carom.terminal.console import replaying

    with opened(file) as path:
        recording = Recording.open(path)
        recording.refuse_overlay()
        units = recording.units
        interval = (typed_time_or_none(recording, time) for time in (start, end))
        with replaying(recording) as watch:
            found = fields(recording, cell, *interval, replay=again, output=output, force=force, watch=watch)
    if as_json:
        say_json(
            {
                "units": units.recorded,
                "from": found.start,
                "to": found.end,
                "moments": found.moments,
                "bodies": found.bodies,
                "origin": found.origin.tolist(),
                "cell": found.cell.tolist(),
                "shape": list(found.shape),
                "fields": {name: units.recorded_unit(unit or "1") for name, unit in UNITS.items()},
                "notes": list(found.notes),
                "path": str(output),
            }
        )
        return
    edges = dict.fromkeys(f"{units.shown(edge, LENGTH):.4g}" for edge in found.cell.tolist())
    size = f"{' × '.join(edges)} {units.unit(LENGTH)}".rstrip()
    shape, span = " × ".join(map(str, found.shape)), units.span(found.start, found.end, TIME)
    of = f"{counted(found.moments, 'exact state')} of {counted(found.bodies, 'moving body')}"
    say(f"{output} written: {shape} cells of {size}, means of {of}, {span}.")
    for note in found.notes:
        say(f"Note: {note}.", err=True)
