"""`carom shrink`: the smallest scene that still fails in the same way."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from carom.scene.wording import command, counted
from carom.terminal.answers import CommandAnswer
from carom.terminal.options import ForceOption, JsonOption, SetOption, work_time
from carom.terminal.printing import note

if TYPE_CHECKING:
    from carom.lab.shrink.reducer import Reducer, ReducerProgress, Reduction
    from carom.scene.load import Scene
    from carom.scene.start import InitialBodies

EVERY = 10.0  # s between two lines of progress if there is no terminal


def shrink_command(
    source: Annotated[
        str, typer.Argument(metavar="SCENE|FILE", help="A scene, a recording (.rrd) or a report (.zip).")
    ],
    condition: Annotated[
        str | None,
        typer.Option(
            "--while",
            metavar="CONDITION",
            help="The failure to keep. Default: the error that ends the run, or the broken promise of "
            '\\[expect]. Other values: expect.NAME, PhysicsError, crash, "not finite", "replay differs", '
            '"shorter steps differ", "invariance NAME", "impact of A and B", "warning KIND", or an expression such as '
            '"energy.max_error > 1e-3" over the numbers of `carom inspect --json`.',
        ),
    ] = None,
    while_command: Annotated[
        str | None,
        typer.Option(
            "--while-command",
            metavar="COMMAND",
            help="A shell command that exits with 0 if the scene shows the failure. {} stands for the path of the "
            "scene; without {}, the path is appended.",
        ),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="FILE", help="Scene file to write. Default: SCENE-small.toml."),
    ] = None,
    seconds: Annotated[
        float | None,
        typer.Option(
            "--budget",
            parser=work_time,
            metavar="TIME",
            help="Stop after this time, such as 60s or 10min. Default: none.",
        ),
    ] = None,
    workers: Annotated[
        int | None,
        typer.Option(
            "--workers",
            metavar="N",
            min=1,
            help="Number of processes for slow scenes. Default: one per core, or 1 with --while-command.",
        ),
    ] = None,
    overrides: SetOption = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Find the smallest scene that still fails in the same way, and write it as a scene file.

    The search removes time, bodies, parts of the model, keys and digits, as long as the failure remains. After Ctrl-C
    or the end of the budget, the file contains the smallest scene so far, from which the same command continues.
    """
    from dataclasses import asdict
    from math import inf

    from carom.lab.shrink.condition import condition_from
    from carom.lab.shrink.literal import source_of
    from carom.lab.shrink.reducer import Reducer
    from carom.lab.shrink.shrunk_file import earlier, key_of
    from carom.lab.shrink.whole_run import CommandShows
    from carom.recording.write.whole_file import refuse_output, refuse_scene_output

    if condition is not None and while_command is not None:
        raise typer.BadParameter("give either --while or --while-command", param_hint="--while-command")
    asked = condition_from(condition) if while_command is None else CommandShows(while_command)
    path = output or Path(f"{Path(source).stem}-small.toml")
    refuse_scene_output(path, source, force=True)
    given = source_of(source, list(overrides or []))
    key = key_of(given[0].toml, asked.text)
    known = None if force else earlier(path, key)
    if known and known.finished:
        document = {"file": str(path), "condition": asked.text, "minimal": True, "before": known.before}
        CommandAnswer(document, [f"{path} is already the smallest scene; search again with --force."]).say(as_json)
        return
    if while_command is not None and workers is None:
        workers = 1  # concurrent commands might interfere
    reducer = Reducer(asked, inf if seconds is None else seconds, workers=workers)
    if known:
        given, reducer.before = source_of(str(path), []), known.before
    else:
        refuse_output(path, force)
    # the command line, which the comments of the result repeat
    words = ["shrink", source, *(["--while", condition] if condition else [])]
    words += ["--while-command", while_command] if while_command else []
    for override in overrides or []:
        words += ["--set", override]
    result = _reduced(reducer, *given, path, key, command(*words), quiet=as_json)
    document = asdict(result) | {"file": str(path), "condition": asked.text, "minimal": result.minimal}
    CommandAnswer(document, _lines(result, path)).say(as_json)


def _reduced(
    reducer: Reducer, scene: Scene, start: InitialBodies, path: Path, key: str, command: str, *, quiet: bool
) -> Reduction:
    """Reduce, print the progress, and keep the smallest scene so far in the file."""
    from carom.lab.shrink.shrunk_file import text_of, unfinished_text, write

    asked = reducer.condition.text

    def keep(document: dict[str, Any], said: str) -> None:
        assert reducer.before is not None, "the first run of the scene"
        write(path, unfinished_text(document, asked, said, reducer.before, key, command))

    reducer.keep = keep
    if not quiet:
        note(
            f"This runs the scene tens to hundreds of times. After Ctrl-C, {path} has the smallest scene so far, and "
            "the same command continues."
        )
    with nullcontext() if quiet else _watched(reducer):
        result = reducer.reduce(scene, start)
    write(path, text_of(result, asked, key, command))
    return result


@contextmanager
def _watched(reducer: Reducer) -> Iterator[None]:
    """Show the progress on a terminal; without a terminal, print a line for each stage."""
    from carom.terminal.compilation import announce_compilation
    from carom.terminal.console import Terminal

    console = Terminal(stderr=True)
    announce_compilation()
    if console.is_terminal:
        with console.status("running the scene") as status:
            reducer.watch = lambda progress: status.update(_line(progress))
            yield
        return
    said, since = "", 0.0

    def watch(progress: ReducerProgress) -> None:
        nonlocal said, since
        if said != progress.stage or progress.seconds >= since + EVERY:
            said, since = progress.stage, progress.seconds
            console.print(_line(progress), soft_wrap=True)

    reducer.watch = watch
    yield


def _line(progress: ReducerProgress) -> str:
    return (
        f"{progress.stage}: {counted(progress.bodies, 'body')}, {counted(progress.steps, 'step')}; "
        f"{counted(progress.candidates, 'candidate')}, {progress.kept} kept, {progress.seconds:.1f} s"
    )


def _lines(result: Reduction, path: Path) -> Iterator[str]:
    bodies, steps = result.before
    left = f"{result.bodies} of {counted(bodies, 'body')} and {result.steps} of {counted(steps, 'step')} are left"
    if result.steps > steps:  # the run may have more steps with fewer bodies
        left = (
            f"{result.bodies} of {counted(bodies, 'body')} are left, and {counted(steps, 'step')} became {result.steps}"
        )
    yield f"{left}: {result.said}"
    if result.stopped:
        yield f"Not finished: {result.stopped}. Run the same command to continue."
    effort = f"{counted(result.candidates, 'candidate')}, {result.kept} kept, in {result.seconds:.3g} s"
    yield f"Written to {path} after {effort}; {command('run', path)}"
