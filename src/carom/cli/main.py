"""The `carom` command: its subcommands, and how a mistake is reported.

Commands import what they need when they run, so that `carom --help` does not wait for a compiler and a viewer.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable
from typing import Annotated, Any

import typer

from carom.cli import (
    clip,
    contacts,
    crosscheck,
    diff,
    explain,
    export,
    fork,
    hunt,
    inspect,
    movie,
    publish,
    repair,
    replay,
    report,
    resume,
    run,
    scenes,
    shrink,
    stress,
    sweep,
    tradeoff,
    tune,
    view,
    warmup,
    why,
)
from carom.cli.flags import Command, Group
from carom.runs.memory import keep_freed_memory

app = typer.Typer(
    name="carom",
    cls=Group,
    help="A flight recorder for colliding spheres: simulate a scene, record it, and look at every collision.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
)


def _print_version(wanted: bool) -> None:
    if wanted:
        from carom.runs.environment import versions

        typer.echo("\n".join(f"{package} {version}" for package, version in versions().items()))
        raise typer.Exit


@app.callback()
def _root(
    version: Annotated[
        bool,
        typer.Option("--version", callback=_print_version, is_eager=True, help="Print versions and exit."),
    ] = False,
) -> None:
    """Simulate a scene, record it, and look at every collision."""


COMMANDS: dict[str, dict[str, Callable[..., None]]] = {  # by their panels in the help, as a newcomer needs them
    "Simulate": {
        "run": run.run,
        "scenes": scenes.scenes,
        "new": scenes.new,
        "explain": explain.explain,
        "resume": resume.resume,
        "sweep": sweep.sweep,
        "warmup": warmup.warmup,
    },
    "Look": {"view": view.view, "picture": view.picture, "movie": movie.movie},
    "Ask": {
        "inspect": inspect.inspect,
        "contacts": contacts.contacts,
        "why": why.why,
        "replay": replay.replay,
        "diff": diff.diff,
        "fork": fork.fork,
        "shrink": shrink.shrink,
    },
    "Measure": {
        "tradeoff": tradeoff.tradeoff,
        "tune": tune.tune,
        "stress": stress.stress,
        "hunt": hunt.hunt,
        "crosscheck": crosscheck.crosscheck,
    },
    "Keep and share": {
        "clip": clip.clip,
        "repair": repair.repair,
        "report": report.report,
        "publish": publish.publish,
        "export": export.export,
    },
}
for panel, commands in COMMANDS.items():
    for name, command in commands.items():
        app.command(name, cls=Command, rich_help_panel=panel)(command)


def _say_old_names_once() -> None:
    """Print a warning about an old key of a scene once, in one line; leave other warnings to Python."""
    show, said = warnings.showwarning, set[str]()

    def say_once(message: Warning | str, category: type[Warning], *place: Any, **more: Any) -> None:
        from carom.cli.text import say
        from carom.scene.overrides import OldNameWarning

        if not issubclass(category, OldNameWarning):
            show(message, category, *place, **more)
        elif str(message) not in said:
            said.add(str(message))
            say(f"carom: {message}", err=True)

    warnings.showwarning = say_once


def main() -> None:
    """Run the command.

    A mistake of the user ends with one message and exit code 2, a failure of the system with one message and exit
    code 1. Neither prints a traceback.
    """
    # imported now: at the limit of open files nothing can be imported any more
    from carom.cli.text import say
    from carom.errors import ExistsError, ExperimentError, PhysicsError, RecordingError, SceneError

    keep_freed_memory()
    _say_old_names_once()
    try:
        app()
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        typer.echo(f"carom: {where}{error.strerror or error}", err=True)
        sys.exit(1)
    except Exception as error:
        if isinstance(error, MemoryError) or "can't start new thread" in str(error):
            typer.echo("carom: out of memory; use fewer bodies or raise the memory limit (`ulimit -v`)", err=True)
            sys.exit(1)
        if "Too many open files" in str(error):  # also Rerun's RuntimeError
            typer.echo("carom: too many files are open; raise the limit (`ulimit -n`)", err=True)
            sys.exit(1)
        if not isinstance(error, (SceneError, RecordingError, ExperimentError, PhysicsError)):
            raise
        text = str(error)
        if isinstance(error, ExistsError):
            text = f"{error.path}: exists; give --force to replace it, or another name with -o"
        say(f"carom: {text}", err=True)
        sys.exit(2)
