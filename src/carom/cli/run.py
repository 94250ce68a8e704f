"""Commands that simulate: `carom run`, `resume`, `replay`, and `warmup`, which compiles the kernels ahead."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from carom.scene.units.dimension import TIME
from carom.scene.wording import command
from carom.terminal.compilation import NO_CACHE, announce_compilation, start_on_a_new_installation
from carom.terminal.given_moment import typed_time
from carom.terminal.options import (
    ForceOption,
    JsonOption,
    LiveOption,
    OptionalTime,
    RecordingArgument,
    SceneArgument,
    ScenesArgument,
    SetOption,
    ThreadsOption,
    output_option,
    recording_option,
    simulated_or_none,
    time_option,
)
from carom.terminal.printing import duration_text, mention_killed_run, note, say, say_json

if TYPE_CHECKING:
    from carom.runs.refinement import Refinement
    from carom.runs.replay import Replay
    from carom.runs.run import Outcome
    from carom.scene.units.system import UnitSystem
    from carom.terminal.progress import RunProgress

NAMED = 3  # largest number of descriptions of uncompared data that are printed
ASKS_ABOVE = 60.0  # s, the longest replay that needs no consent
NEARLY_ALL = 0.995  # a larger fraction of the motion prints as 100 %, and is not mentioned
_CHECKS = "Check energy and momentum every N steps. Default: as the scene says."


def run(
    scene: SceneArgument,
    output: Annotated[Path | None, recording_option("Recording to write. Default: recordings/SCENE.rrd.")] = None,
    overrides: SetOption = None,
    check_every: Annotated[
        int | None, typer.Option("--check-every", "--log-freq", metavar="N", help=_CHECKS, min=1)
    ] = None,
    live: LiveOption = False,
    threads: ThreadsOption = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Simulate a scene and record it to an .rrd file."""
    helped = start_on_a_new_installation() is not None
    from carom.scene.load import Scene

    changes = list(overrides or [])
    if check_every is not None:
        changes.append(f"record.check_every={check_every}")
    loaded = Scene.load(scene, changes)

    from carom.recording.write.whole_file import claimed_output, default_output

    path = output or default_output(Path(scene).stem)
    with claimed_output(path, force) as claim:
        from carom.runs.run import recording_space, simulate
        from carom.terminal.progress import RunProgress, preparing, watch_look_ahead

        progress = RunProgress(loaded, quiet=as_json)
        announce_compilation(progress.say, helped, loaded)
        with preparing(loaded, progress) as patience:
            space = recording_space(loaded, threads, watch_look_ahead(loaded, patience))
        progress.announce(space.scene)
        progress.forewarn(space)
        address = live_viewer() if live else None
        with progress, naming_the_repair(path):
            outcome = simulate(space, path, claim=claim, live=address, watch=progress.update)
    report(outcome, progress, as_json)


@contextmanager
def naming_the_repair(path: Path) -> Iterator[None]:
    """Name the command that repairs a file if a second interrupt ends the run at once."""
    try:
        yield
    except KeyboardInterrupt:
        if path.exists():  # before the first step there is no file
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
    from carom.display.viewer import start_live_viewer
    from carom.errors import RecordingError

    try:
        return start_live_viewer()
    except RecordingError as error:
        typer.echo(f"carom: the run is being recorded, but cannot be shown live: {error}", err=True)
        return None


def resume(
    file: RecordingArgument,
    until: Annotated[
        OptionalTime, time_option("--until", "Continue to this simulated time. Default: the scene's duration.")
    ] = None,
    output: Annotated[
        Path | None,
        output_option("FILE", "Recording to write. Default: replace FILE when the new one is complete."),
    ] = None,
    live: LiveOption = False,
    threads: ThreadsOption = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Continue a run that was interrupted, killed or has ended; results are the same as without interruption."""
    from carom.recording.read.recording import Recording
    from carom.runs.resume import claimed_target, resumable_run, under_way
    from carom.runs.resume import continue_run as go_on
    from carom.terminal.progress import RunProgress

    if until is not None and not 0.0 < until < float("inf"):
        raise typer.BadParameter(f"{until:g}: expected a time later than the start", param_hint="--until")
    mention_killed_run(file)
    with claimed_target(file, output, force) as claim:
        recording = Recording.open(file)
        run = resumable_run(recording, simulated_or_none(until, recording.units))
        began = recording.units.text(run.time, TIME)
        progress = RunProgress(run.scene, quiet=as_json, heading=f"From t = {began} on: ")
        announce_compilation(progress.say)
        space = run.space(threads)
        address = live_viewer() if live else None
        with progress, naming_the_repair(under_way(output or file)):
            outcome = go_on(run, space, output, force=force, claim=claim, live=address, watch=progress.update)
    report(outcome, progress, as_json)


def replay(
    file: RecordingArgument,
    begin: Annotated[
        float, time_option("--from", "Start at the last checkpoint before this time. Default: the beginning.")
    ] = 0.0,
    end: Annotated[float, time_option("--to", "Stop at this time. Default: the end.")] = float("inf"),
    every: Annotated[
        str | None,
        typer.Option("--every", metavar="step", help="Record every step between --from and --to in a new file."),
    ] = None,
    output: Annotated[Path | None, recording_option("File for --every step. Default: FILE-dense.rrd.")] = None,
    shorter: Annotated[
        float | None,
        typer.Option("--refine", metavar="K", help="Use steps K times as short, and say what this changes."),
    ] = None,
    threads: ThreadsOption = None,
    yes: Annotated[
        bool, typer.Option("--yes", help="Start replays that take more than a minute without asking.")
    ] = False,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Run a recording again and check that every frame has the same bits; exit with 1 at the first difference.

    With --refine, ask whether shorter steps tell the same story, and exit with 1 if they tell another story.

    FILE may be the zip that `carom report` made.
    """
    from dataclasses import asdict

    from carom.errors import PhysicsError
    from carom.recording.edit.bundle import opened
    from carom.recording.read.recording import Recording
    from carom.runs.replay import replay as run_again

    if every not in (None, "step"):
        raise typer.BadParameter(f'"{every}": the only possible value is "step"', param_hint="--every")
    dense = output or file.with_name(f"{file.stem}-dense.rrd") if every or output else None
    if shorter is not None and not 1.0 < shorter < float("inf"):
        raise typer.BadParameter(f"{shorter:g}: expected more than 1, such as 4", param_hint="--refine")
    if shorter is not None and dense is not None:
        raise typer.BadParameter("records nothing; leave out --every and -o", param_hint="--refine")
    if not as_json:
        announce_compilation()
    try:
        with opened(file) as path:
            recording = Recording.open(path)
            units = recording.units
            start, stop = (typed_time(recording, time) for time in (begin, end))
            if stop < start:
                before, after = units.text(stop, TIME, "g"), units.text(start, TIME, "g")
                raise typer.BadParameter(f"{before} is before --from {after}", param_hint="--to")
            consent = partial(_agreed, yes)
            if shorter is not None:
                from carom.runs.refinement import refine

                refinement = refine(recording, shorter, start, stop, threads=threads, consent=consent)
                _tell(refinement, units, as_json)
                return
            result = run_again(recording, start, stop, threads=threads, dense=dense, force=force, consent=consent)
    except PhysicsError as error:
        if as_json:
            say_json({"same": False, "ended": str(error)})
        say(f"carom: the replay failed: {error}", err=True)
        raise typer.Exit(1) from None
    if as_json:
        written = None if result.dense is None else str(result.dense)
        document = {"units": units.recorded, **asdict(result), "dense": written, "same": result.same}
        if result.difference:
            document["difference"]["unit"] = units.recorded_unit(result.difference.unit)
        say_json(document)
    else:
        _print(result, units)
    if not result.same:
        raise typer.Exit(1)


def _tell(result: Refinement, units: UnitSystem, as_json: bool) -> None:
    """Print the changes due to shorter steps; exit with 1 if they tell another story."""
    from dataclasses import asdict

    if as_json:
        say_json({"units": units.recorded, **asdict(result), "same": result.same})
    else:
        story = "another story" if result.moved else "the same story"
        say(
            f"Steps {result.factor:g} times as short tell {story} from t = "
            f"{units.span(result.begin, result.end, TIME)}: {result.instants} instants compared, "
            f"{result.steps} and {result.refined_steps} steps, in {result.seconds:.3g} s."
        )
        for moved in result.moved:
            say(f"- {moved.text(units)}.")
        if result.compared < NEARLY_ALL:
            say(f"{100.0 * result.compared:.0f}% of the motion was compared; the rest depends on the last bit (chaos).")
        shares = [f"{name} {share:.2g}" for name, share in result.largest.items() if share > 0.0]
        if shares and not result.moved:
            say(f"Largest differences, as multiples of the allowed differences: {', '.join(shares)}.")
        if result.differs is not None:
            say(f"From step {result.differs} on, the bits of the run and its recording differ; see `carom replay`.")
        if result.ended:
            say(f"The comparison ended early: {result.ended}.")
    if not result.same:
        raise typer.Exit(1)


def _agreed(yes: bool, seconds: float) -> bool:
    """Ask for consent to a long replay, unless --yes is given; refuse it if there is no terminal."""
    if yes or seconds <= ASKS_ABOVE:
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
        more = len(result.not_compared) - NAMED
        named = result.not_compared[:NAMED] + ([f"and {more} more (--json)"] if more > 0 else [])
        say(f"Not compared: {'; '.join(named)}.")
    for file in result.changed_files:
        say(f"{file} has changed since the run was recorded; the replay used the recorded bodies.")
    if result.ended:
        say(f"The replay ended early: {result.ended}.")
    if not result.same or result.recorded_with != result.replayed_with:
        for when, packages in (("recorded", result.recorded_with), ("replayed", result.replayed_with)):
            say(f"{when} with {', '.join(f'{name} {version}' for name, version in sorted(packages.items()))}")
    if result.dense:
        say(f"Every step: {result.dense}")


def warmup(scenes: ScenesArgument = None, as_json: JsonOption = False) -> None:
    """Compile the kernels of most scenes now, so that later runs start at once.

    Scenes with walls of special shapes, a sheared box, or a contact law other than coulomb need further kernels: name
    such scenes to compile these, too.
    """
    from dataclasses import asdict

    from carom.runs.warmup import warm_up
    from carom.scene.load import Scene

    loaded = [Scene.load(scene) for scene in scenes or []]
    if not as_json:
        note("Compiling the kernels that are not in the cache …")
    warmth = warm_up(loaded)
    if as_json:
        say_json(asdict(warmth))
    else:
        where = f"cache: {warmth.cache}" if warmth.cache else NO_CACHE
        typer.echo(f"{warmth.compiled} kernels compiled in {duration_text(warmth.seconds)}; {where}")
