"""`carom clip`: a smaller recording that still opens, inspects and replays."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from carom.cli.json_output import say_json
from carom.cli.options import (
    ForceOption,
    JsonOption,
    OptionalTime,
    OutputOption,
    RecordingArgument,
    seconds,
    simulated_or_none,
)
from carom.cli.text import say
from carom.scene.units.dimension import TIME

if TYPE_CHECKING:
    from carom.recording.edit.clip import Clip
    from carom.scene.units.system import UnitSystem


def clip(
    file: RecordingArgument,
    start: Annotated[
        OptionalTime, typer.Option("--from", parser=seconds, metavar="T", help="Keep frames from this time on.")
    ] = None,
    end: Annotated[
        OptionalTime, typer.Option("--to", parser=seconds, metavar="T", help="Keep frames up to this time.")
    ] = None,
    around: Annotated[
        OptionalTime,
        typer.Option("--around", parser=seconds, metavar="T", help="Keep frames around this time; needs --window."),
    ] = None,
    window: Annotated[
        OptionalTime,
        typer.Option("--window", parser=seconds, metavar="W", help="Length of time to keep, with --around."),
    ] = None,
    bodies: Annotated[
        str | None,
        typer.Option(
            "--bodies",
            metavar="A,B",
            help="Show these bodies only, by number or name, and the contacts among them.",
        ),
    ] = None,
    output: OutputOption = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Cut an interval out of a recording; the clip can be viewed, inspected and replayed like the whole.

    FILE may be the zip that `carom report` made.
    """
    from dataclasses import asdict

    from carom.cli.units import bytes_text
    from carom.recording.edit.bundle import opened
    from carom.recording.edit.clip import clip as cut
    from carom.recording.read.recording import Recording
    from carom.runs.output import refuse_itself, refuse_output
    from carom.scene.wording import bodies_called, counted

    path = output or file.with_name(f"{file.stem}-clip.rrd")
    with opened(file) as source:
        recording = Recording.open(source)
        units, names = recording.units, recording.bodies.name
        interval = _interval(units, *(simulated_or_none(time, units) for time in (start, end, around, window)))
        refuse_itself(path, file)
        refuse_output(path, force)
        made = cut(source, path, *interval, bodies=_numbers(source, bodies))
    if as_json:
        say_json({"units": units.recorded, **asdict(made), "path": str(made.path)})
        return
    shown = "" if made.bodies is None else f", {bodies_called(made.bodies, names)}"
    say(f"{path} written: {counted(made.frames, 'frame')}, {_reach(made, units)}{shown}, {bytes_text(made.size)}.")
    if made.replays_from is None:
        say(f"{file} has no exact state before that time, so the clip cannot be replayed.", err=True)


def _reach(made: Clip, units: UnitSystem) -> str:
    if made.frames == 1:
        return f"step {made.first_step}, at {units.text(made.start, TIME)}"
    return f"steps {made.first_step} to {made.last_step}, {units.span(made.start, made.end, TIME)}"


def _interval(
    units: UnitSystem, start: OptionalTime, end: OptionalTime, around: OptionalTime, window: OptionalTime
) -> tuple[float, float]:
    """Return the start and the end of the interval, from either pair of options."""
    from math import inf

    from carom.errors import RecordingError

    if (around is None) != (window is None) or (around is not None and (start is not None or end is not None)):
        raise RecordingError(
            "choose what to keep with --from T and --to T (one is enough), or with --around T --window W"
        )
    if around is not None and window is not None:
        if not window >= 0:
            raise RecordingError(f"--window {units.text(window, TIME)}: the length must not be negative")
        return around - window / 2, around + window / 2
    first, last = -inf if start is None else start, inf if end is None else end
    if not first <= last:
        asked = f"--from {units.text(first, TIME)} --to {units.text(last, TIME)}"
        raise RecordingError(f"{asked}: the end is before the start")
    return first, last


def _numbers(file: Path, bodies: str | None) -> list[int] | None:
    """Find the bodies that are meant, by their numbers or names."""
    from carom.recording.read.body_lookup import body_number, split_at_commas
    from carom.recording.read.recording import Recording

    if bodies is None:
        return None
    recording = Recording.open(file)
    return [body_number(recording, part) for part in split_at_commas(bodies, recording.bodies.name)]
