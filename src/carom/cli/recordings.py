"""Commands that make a file from a recording: `carom clip`, `repair`, `export` and `report`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from carom import registry
from carom.scene.units.dimension import TIME
from carom.scene.wording import counted
from carom.terminal.given_moment import AtOption, EventOption, GivenMoment, StepOption, at_option, typed_time_or_none
from carom.terminal.options import (
    ForceOption,
    JsonOption,
    OptionalTime,
    OutputOption,
    RecordingArgument,
    output_option,
    simulated_or_none,
    time_option,
)
from carom.terminal.printing import bytes_text, mention_killed_run, say, say_json

if TYPE_CHECKING:
    from carom.scene.units.system import UnitSystem

_SUFFIXES = ", ".join(f".{name}" for name in registry.HOUSE["export_formats"])
_BODIES = "Keep only these bodies, by number or name, and the contacts among them."


def clip(
    file: RecordingArgument,
    start: Annotated[OptionalTime, time_option("--from", "Keep frames from this time on.")] = None,
    end: Annotated[OptionalTime, time_option("--to", "Keep frames up to this time.")] = None,
    around: Annotated[OptionalTime, time_option("--around", "Keep frames around this time; needs --window.")] = None,
    window: Annotated[OptionalTime, time_option("--window", "Length of time to keep, with --around.", "W")] = None,
    bodies: Annotated[str | None, typer.Option("--bodies", metavar="A,B", help=_BODIES)] = None,
    output: OutputOption = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Cut an interval out of a recording; the clip can be viewed, inspected and replayed like the whole.

    FILE may be the zip that `carom report` made.
    """
    from dataclasses import asdict

    from carom.recording.edit.bundle import opened
    from carom.recording.edit.clip import clip as cut
    from carom.recording.read.lookup import body_number, split_at_commas
    from carom.recording.read.recording import Recording
    from carom.recording.write.whole_file import refuse_itself, refuse_output
    from carom.scene.wording import bodies_called

    path = output or file.with_name(f"{file.stem}-clip.rrd")
    with opened(file) as source:
        recording = Recording.open(source)
        units, names = recording.units, recording.bodies.name
        first, last, middle = (typed_time_or_none(recording, time) for time in (start, end, around))
        interval = _interval(units, first, last, middle, simulated_or_none(window, units))
        refuse_itself(path, file)
        refuse_output(path, force)
        kept = None if bodies is None else [body_number(recording, body) for body in split_at_commas(bodies, names)]
        made = cut(source, path, *interval, bodies=kept)
    if as_json:
        say_json({"units": units.recorded, **asdict(made), "path": str(made.path)})
        return
    shown = "" if made.bodies is None else f", {bodies_called(made.bodies, names)}"
    reach = f"steps {made.first_step} to {made.last_step}, {units.span(made.start, made.end, TIME)}"
    if made.frames == 1:
        reach = f"step {made.first_step}, at {units.text(made.start, TIME)}"
    say(f"{path} written: {counted(made.frames, 'frame')}, {reach}{shown}, {bytes_text(made.size)}.")
    if made.replays_from is None:
        say(f"{file} has no exact state before that time, so the clip cannot be replayed.", err=True)


def _interval(
    units: UnitSystem, start: OptionalTime, end: OptionalTime, around: OptionalTime, window: OptionalTime
) -> tuple[float, float]:
    """Return the start and the end of the interval, from --start and --end or from --around and --window."""
    from math import inf

    from carom.errors import RecordingError

    if (around is None) != (window is None) or (around is not None and (start is not None or end is not None)):
        raise RecordingError(
            "select an interval with --from T and --to T (one is enough), or with --around T --window W"
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
    from carom.recording.write.whole_file import Claim, refuse_output

    mention_killed_run(file)
    if in_place and output is not None:
        raise RecordingError("give --in-place or -o, not both")
    path = output or file.with_name(f".{file.stem}.repaired.rrd" if in_place else f"{file.stem}-repaired.rrd")
    if path.exists() and file.exists() and path.samefile(file):
        raise RecordingError(f"{path} is the damaged recording itself; choose another file or give --in-place")
    torn = file.with_name(f"{file.name}.torn")
    if in_place and torn.exists() and not force:
        raise RecordingError(f"{torn}: exists, from an earlier repair; move it away, or give --force to replace it")
    refuse_output(path, force or in_place)
    # claimed, since the file of a running simulation looks like the file of a killed one
    with Claim(file) if in_place else nullcontext():
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


def export(
    file: RecordingArgument,
    output: Annotated[Path, output_option("FILE", f"File to write: {_SUFFIXES}.")],
    at: AtOption = None,
    step: StepOption = None,
    event: EventOption = None,
    everything: Annotated[bool, typer.Option("--all", help="Export all recorded frames instead of one step.")] = False,
    force: ForceOption = False,
) -> None:
    """Write bodies, contacts and energies, in double precision, for ParaView, OVITO, pandas or NumPy.

    States between checkpoints are computed again. Tables put contacts and energies into separate files beside the file
    of the bodies. With --all, a format with one step in a file, such as .vtk, becomes a folder of files and a list.
    """
    from carom.errors import RecordingError
    from carom.recording.edit.bundle import opened
    from carom.recording.export import others_of, refuse_export, write
    from carom.recording.read.recording import Recording
    from carom.runs.recomputed import snapshots
    from carom.terminal.console import replaying

    given = GivenMoment(at, step, event)
    if everything and given.option:
        raise RecordingError(f"give {given.option} or --all, not both")
    refuse_export(output, everything, force)
    with opened(file) as path:
        recording = Recording.open(path)
        recording.refuse_overlay()
        with replaying(recording) as watch:
            steps, when = snapshots(recording, given.end(recording, watch), everything=everything, watch=watch), ""
            if not everything:  # a moment means the whole step that contains it
                one = next(steps)
                steps, when = iter([one]), f", t = {recording.units.text(one.time, TIME, '.9g')}"
            written, count = write(output, steps, everything)
        bodies = len(recording.shown)
    say(f"{written} written: {counted(count, 'step')} of {counted(bodies, 'body')}{when}.")
    if beside := [str(file) for file in others_of(output) if file.exists()]:
        say(f"Beside it: {', '.join(beside)}.")


def report(
    file: RecordingArgument,
    at: Annotated[OptionalTime, at_option("the worst moment of the run")] = None,
    step: StepOption = None,
    event: EventOption = None,
    output: Annotated[Path | None, output_option("ZIP", "Zip to write. Default: FILE-report.zip.")] = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Pack a bug report into a zip of less than 10 MB: clip, scene, picture, versions and a summary to paste."""
    from dataclasses import asdict

    from carom.recording.read.recording import Recording
    from carom.recording.write.whole_file import refuse_output
    from carom.sharing.report import report as make
    from carom.terminal.compilation import announce_compilation
    from carom.terminal.console import replaying

    given, recording = GivenMoment(at, step, event), Recording.open(file)
    path = output or file.with_name(f"{file.stem}-report.zip")
    refuse_output(path, force)
    announce_compilation()
    with replaying(recording) as watch:
        moment = given.end(recording, watch)
    made = make(recording, path, moment)
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
