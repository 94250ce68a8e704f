"""The `carom` command, and how a mistake is reported."""

from __future__ import annotations

import sys
import warnings
from typing import Annotated, Any

import typer

from carom.cli.commands import CommandGroup
from carom.runs.memory import keep_freed_memory

app = typer.Typer(
    name="carom",
    cls=CommandGroup,
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
    except ModuleNotFoundError as error:
        if not (error.name or "").startswith("carom."):
            raise
        say(f"carom: {error.name} is missing from this installation, and the command needs it", err=True)
        sys.exit(2)
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
