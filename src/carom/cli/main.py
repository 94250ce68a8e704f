"""The `carom` command: its subcommands, and how a mistake is reported.

Commands import what they need when they run, so that `carom --help` does not wait for a compiler and a viewer.
"""

from __future__ import annotations

import sys
import warnings
from typing import Annotated, Any

import typer

from carom.cli import (
    clip,
    contacts,
    diff,
    explain,
    inspect,
    movie,
    publish,
    repair,
    replay,
    report,
    resume,
    run,
    scenes,
    stress,
    sweep,
    tradeoff,
    tune,
    view,
    warmup,
)
from carom.cli.flags import Command, Group
from carom.experiment.memory import keep_freed_memory

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
        from carom.experiment.environment import versions

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


app.command("run", cls=Command)(run.run)
app.command("scenes", cls=Command)(scenes.scenes)
app.command("new", cls=Command)(scenes.new)
app.command("explain", cls=Command)(explain.explain)
app.command("inspect", cls=Command)(inspect.inspect)
app.command("replay", cls=Command)(replay.replay)
app.command("publish", cls=Command)(publish.publish)
app.command("report", cls=Command)(report.report)
app.command("resume", cls=Command)(resume.resume)
app.command("stress", cls=Command)(stress.stress)
app.command("sweep", cls=Command)(sweep.sweep)
app.command("tradeoff", cls=Command)(tradeoff.tradeoff)
app.command("tune", cls=Command)(tune.tune)
app.command("view", cls=Command)(view.view)
app.command("picture", cls=Command)(view.picture)
app.command("movie", cls=Command)(movie.movie)
app.command("clip", cls=Command)(clip.clip)
app.command("contacts", cls=Command)(contacts.contacts)
app.command("diff", cls=Command)(diff.diff)
app.command("repair", cls=Command)(repair.repair)
app.command("warmup", cls=Command)(warmup.warmup)


def _say_old_names_once() -> None:
    """Print a warning about an old key of a scene once, in one line; leave other warnings to Python."""
    show, said = warnings.showwarning, set[str]()

    def say_once(message: Warning | str, category: type[Warning], *place: Any, **more: Any) -> None:
        from carom.cli.text import say
        from carom.scene.renamed import OldNameWarning

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
    keep_freed_memory()
    _say_old_names_once()
    try:
        app()
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        typer.echo(f"carom: {where}{error.strerror or error}", err=True)
        sys.exit(1)
    except Exception as error:
        from carom.cli.text import say
        from carom.experiment.error import ExperimentError
        from carom.physics.error import PhysicsError
        from carom.recording.errors import RecordingError
        from carom.scene.error import SceneError

        if isinstance(error, MemoryError) or "can't start new thread" in str(error):
            typer.echo("carom: out of memory; use fewer bodies or raise the memory limit (`ulimit -v`)", err=True)
            sys.exit(1)
        if not isinstance(error, (SceneError, RecordingError, ExperimentError, PhysicsError)):
            raise
        say(f"carom: {error}", err=True)
        sys.exit(2)
