"""`carom replay`: run a recording again and say whether the bits are the same."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from carom.cli.options import (
    ForceOption,
    JsonOption,
    RecordingArgument,
    ThreadsOption,
    recording_option,
    seconds,
    simulated,
)
from carom.cli.printing import duration_text, say, say_json
from carom.scene.units.dimension import TIME

if TYPE_CHECKING:
    from carom.runs.replay import Replay
    from carom.scene.units.system import UnitSystem

ASKS_ABOVE = 60.0  # s; a longer replay requires consent


def replay(
    file: RecordingArgument,
    begin: Annotated[
        float,
        typer.Option(
            "--from",
            parser=seconds,
            metavar="T",
            help="Start at the last checkpoint before this time. Default: the beginning.",
            show_default=False,
        ),
    ] = 0.0,
    end: Annotated[
        float,
        typer.Option(
            "--to", parser=seconds, metavar="T", help="Stop at this time. Default: the end.", show_default=False
        ),
    ] = float("inf"),
    every: Annotated[
        str | None,
        typer.Option("--every", metavar="step", help="Record every step between --from and --to in a new file."),
    ] = None,
    output: Annotated[Path | None, recording_option("File for --every step. Default: FILE-dense.rrd.")] = None,
    threads: ThreadsOption = None,
    yes: Annotated[
        bool, typer.Option("--yes", help="Start replays that take more than a minute without asking.")
    ] = False,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Run a recording again and check that every frame has the same bits; exit with 1 at the first that differs.

    FILE may be the zip that `carom report` made.
    """
    from carom.cli.compiling import announce_compilation
    from carom.errors import PhysicsError
    from carom.recording.edit.bundle import opened
    from carom.recording.read.recording import Recording
    from carom.runs.replay import replay as run_again

    if every not in (None, "step"):
        raise typer.BadParameter(f'"{every}": the only possible value is "step"', param_hint="--every")
    dense = output or file.with_name(f"{file.stem}-dense.rrd") if every or output else None
    if not as_json:
        announce_compilation()
    try:
        with opened(file) as path:
            recording = Recording.open(path)
            units = recording.units
            start, stop = simulated(begin, units), simulated(end, units)
            if stop < start:
                before, after = units.text(stop, TIME, "g"), units.text(start, TIME, "g")
                raise typer.BadParameter(f"{before} is before --from {after}", param_hint="--to")
            result = run_again(
                recording,
                start,
                stop,
                threads=threads,
                dense=dense,
                force=force,
                consent=lambda seconds: yes or _agreed(seconds),
            )
    except PhysicsError as error:
        if as_json:
            say_json({"same": False, "ended": str(error)})
        say(f"carom: the replay failed: {error}", err=True)
        raise typer.Exit(1) from None
    if as_json:
        say_json(_document(result, units))
    else:
        _print(result, units)
    if not result.same:
        raise typer.Exit(1)


def _agreed(seconds: float) -> bool:
    """Ask for consent to a long replay; refuse it if there is no terminal."""
    if seconds <= ASKS_ABOVE:
        return True
    text = f"The remaining steps will take about {duration_text(seconds)}"
    if not sys.stdin.isatty():
        say(f"carom: {text}: continue with --yes, or shorten the interval with --to", err=True)
        return False
    return typer.confirm(f"{text}. Go on?", err=True)


def _print(result: Replay, units: UnitSystem) -> None:
    frames = f"{result.compared} of {result.frames} frames"
    say(f"{frames}{', same bits' if result.same else ''}, from step {result.begin} on, in {result.seconds:.3g} s")
    if result.difference:
        say(f"The first difference is at {result.difference.text(units)}.")
    if result.not_compared:
        say(f"Not compared: {'; '.join(result.not_compared)}.")
    for file in result.changed_files:
        say(f"{file} has changed since the run was recorded; the replay used the recorded bodies.")
    if result.ended:
        say(f"The replay ended early: {result.ended}.")
    if not result.same or result.recorded_with != result.replayed_with:
        for when, packages in (("recorded", result.recorded_with), ("replayed", result.replayed_with)):
            say(f"{when} with {', '.join(f'{name} {version}' for name, version in sorted(packages.items()))}")
    if result.dense:
        say(f"Every step: {result.dense}")


def _document(result: Replay, units: UnitSystem) -> dict[str, Any]:
    from dataclasses import asdict

    dense = None if result.dense is None else str(result.dense)
    found = {"units": units.recorded, **asdict(result), "dense": dense, "same": result.same}
    if result.difference:
        found["difference"]["unit"] = units.recorded_unit(result.difference.unit)
    return found
