"""The `carom` command: the table of commands; the process's streams, signals, messages and exit code.

A command is a function. The function's module is imported when the command runs or shows its help. Other packages are
imported only when the command runs: `carom --help` then does not load a compiler and a viewer.
"""

from __future__ import annotations

import errno
import functools
import importlib
import inspect
import io
import os
import sys
import traceback
import warnings
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Annotated, Any, NoReturn, TextIO, cast

import typer
from typer.core import TyperCommand, TyperGroup

from carom import registry
from carom.runs.environment import (
    collect_garbage_rarely,
    is_ending,
    keep_freed_memory,
    leave,
    leave_pandas_out,
    received,
)
from carom.terminal.printing import VERBOSITY

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer

EXTENSIONS = "Extensions"  # panel of the commands of installed packages
COMMANDS: dict[str, dict[str, str]] = {  # panel → command → module:function, in the order of a newcomer's needs
    "Simulate": {
        "run": "carom.cli.run:run",
        "scenes": "carom.cli.scenes:scenes",
        "new": "carom.cli.scenes:new",
        "explain": "carom.cli.scenes:explain",
        "resume": "carom.cli.run:resume",
        "sweep": "carom.lab.sweep:sweep_command",
        "warmup": "carom.cli.run:warmup",
    },
    "Look": {"view": "carom.cli.view:view", "picture": "carom.cli.view:picture", "movie": "carom.cli.view:movie"},
    "Ask": {
        "inspect": "carom.cli.inspect:inspect",
        "contacts": "carom.cli.contacts:contacts",
        "fields": "carom.lab.fields:fields_command",
        "why": "carom.lab.why:why_command",
        "replay": "carom.cli.run:replay",
        "diff": "carom.lab.diff:diff_command",
        "fork": "carom.lab.fork:fork_command",
        "shrink": "carom.lab.shrink:shrink_command",
    },
    "Measure": {
        "tradeoff": "carom.lab.tradeoff:tradeoff_command",
        "tune": "carom.lab.tradeoff:tune_command",
        "stress": "carom.cli.stress:stress",
        "hunt": "carom.lab.hunt:hunt_command",
        "crosscheck": "carom.engines.crosscheck:crosscheck_command",
    },
    "Keep and share": {
        "clip": "carom.cli.recordings:clip",
        "repair": "carom.cli.recordings:repair",
        "report": "carom.cli.recordings:report",
        "publish": "carom.cli.view:publish",
        "export": "carom.cli.recordings:export",
    },
}


_HELP = "help"  # `carom help COMMAND` means `carom COMMAND --help`


def _be_quiet(wanted: bool) -> None:
    VERBOSITY.is_quiet = wanted


def _be_verbose(wanted: bool) -> None:
    VERBOSITY.is_verbose = wanted


_QUIET = typer.Option(
    "-q",
    "--quiet",
    callback=_be_quiet,
    expose_value=False,
    help="Print no progress, only the result, warnings and errors.",
)
_VERBOSE = typer.Option(
    "-v", "--verbose", callback=_be_verbose, expose_value=False, help="Print an error with its traceback."
)


def _of_all_commands(quiet: Annotated[bool, _QUIET] = False, verbose: Annotated[bool, _VERBOSE] = False) -> None:
    """Declare the options of every command."""


class Command(TyperCommand):
    """A command whose help shows flags without a type, and paragraphs without the line breaks of the source."""

    def __init__(self, *arguments: Any, **keywords: Any) -> None:
        super().__init__(*arguments, **keywords)
        # lines are joined here, since Typer joins only the lines of the first paragraph
        paragraphs = inspect.cleandoc(self.help or "").split("\n\n")
        self.help = "\n\n".join(paragraph.replace("\n", " ") for paragraph in paragraphs)

    def get_params(self, ctx: Any) -> list[Any]:
        """Return the parameters, ``--help`` among them."""
        return _plain(super().get_params(ctx))

    def invoke(self, ctx: Any) -> Any:
        """Run the command; pandas is loaded only if the command asks for it."""
        leave_pandas_out()
        return super().invoke(ctx)


class _Commands(Mapping[str, Any]):
    """The commands by name; a command is made on its first use."""

    def __init__(self) -> None:
        self._places = {name: (panel, home) for panel, row in COMMANDS.items() for name, home in row.items()}
        self._made: dict[str, Any] = {}

    def __getitem__(self, name: str) -> Any:
        if name not in self._made:
            panel, home = self._places[name]
            module, _, function = home.partition(":")
            self._made[name] = _made(name, getattr(importlib.import_module(module), function), panel)
        return self._made[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._places)

    def __len__(self) -> int:
        return len(self._places)


class CommandGroup(TyperGroup):
    """`carom` itself, with its own commands and the commands of installed packages."""

    def __init__(self, **keywords: Any) -> None:
        super().__init__(**keywords)
        self.commands = cast("dict[str, Any]", _Commands())

    def get_params(self, ctx: Any) -> list[Any]:
        """Return the parameters, ``--help`` among them."""
        return _plain(super().get_params(ctx))

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse the arguments; ``help COMMAND`` stands for ``COMMAND --help``."""
        if args[:1] == [_HELP]:
            args = [*args[1:2], "--help"]
        return super().parse_args(ctx, args)

    def list_commands(self, ctx: Any) -> list[str]:
        """Return the names of all commands: carom's own first."""
        own = list(self.commands)
        return [*own, *(name for name in registry.installed("commands") if name not in own)]

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Return a command by its name; None if there is none."""
        if cmd_name not in registry.installed("commands"):
            return super().get_command(ctx, cmd_name)
        if cmd_name in self.commands:
            raise registry.ExtensionError(
                f'an installed package defines a command "{cmd_name}", which carom already has; rename it in the '
                "package, or uninstall the package"
            )
        try:
            function = registry.load("commands", cmd_name)
            with registry.refused_if_broken("commands", cmd_name):
                from rich.text import Text

                made = _made(cmd_name, function, EXTENSIONS)  # raises if Typer cannot make options of its parameters
                Text.from_markup(made.help or "")
            return made
        except registry.ExtensionError as error:
            from rich.markup import escape

            refusal = error

            def broken() -> None:
                raise refusal

            broken.__doc__ = escape(str(error))  # the message replaces the help of the command, which is rich markup
            return _made(cmd_name, broken, EXTENSIONS)


def _plain(parameters: list[Any]) -> list[Any]:
    """Show flags without a type, since they take no value."""
    for parameter in parameters:
        if getattr(parameter, "is_bool_flag", False):
            parameter.metavar = ""
    return parameters


def _made(name: str, function: Any, panel: str) -> Any:
    """Return a command that calls a function."""
    app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode="rich")
    app.command(name, cls=Command, rich_help_panel=panel)(function)
    made = typer.main.get_command(app)
    made.params += _common_options()
    return made


@functools.cache
def _common_options() -> list[Any]:
    app = typer.Typer(add_completion=False)
    app.command()(_of_all_commands)
    return typer.main.get_command(app).params


# Typer has its own copy of Click, or in older versions depends on it
_UsageError: type[Exception] = next(each for each in typer.BadParameter.__mro__ if each.__name__ == "UsageError")
_INTERRUPTED = 130  # Typer's exit code for a KeyboardInterrupt that no command handled

app = typer.Typer(
    name="carom",
    cls=CommandGroup,
    help="A flight recorder for colliding spheres: simulate a scene, record it, and inspect every collision.",
    epilog="`carom help COMMAND` describes a command.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
)


def main() -> NoReturn:
    """Run the command and exit.

    Exit codes: 2 and one message for a person's mistake; 1 for a run that ended early or missed a promise; 128 and the
    signal's number for a command that a signal ended before it had anything to close.
    """
    output = replace_streams()
    code: int | str | None = 0
    try:
        run_command()
    except SystemExit as ending:
        code = ending.code
        if received() and code == _INTERRUPTED:
            leave()
    except BaseException:  # an interrupted import may raise any exception
        if received():
            leave()
        raise
    finally:
        is_ending()
    sys.stdout.flush()
    if output.error is not None and output.error.errno != errno.EPIPE:  # a closed pipe is not an error
        typer.echo(f"carom: cannot write to standard output: {output.error.strerror}", err=True)
        code = code or 1
    is_ending(at_once=True)
    sys.exit(code)


def _print_version(wanted: bool) -> None:
    if wanted:
        from carom.runs.environment import versions

        typer.echo("\n".join(f"{package} {version}" for package, version in versions().items()))
        raise typer.Exit


@app.callback()
def _root(
    version: Annotated[
        bool,
        typer.Option("-V", "--version", callback=_print_version, is_eager=True, help="Print versions and exit."),
    ] = False,
) -> None:
    """Simulate a scene, record it, and look at every collision."""


def _say_warnings_once() -> None:
    """Print a warning about a renamed key or a dropped run once, in one line; leave other warnings to Python."""
    show, said = warnings.showwarning, set[str]()

    def say_once(message: Warning | str, category: type[Warning], *place: Any, **more: Any) -> None:
        from carom.errors import DroppedRunWarning
        from carom.scene.overrides import OldNameWarning
        from carom.terminal.printing import say

        if not issubclass(category, OldNameWarning | DroppedRunWarning):
            show(message, category, *place, **more)
        elif str(message) not in said:
            said.add(str(message))
            say(f"carom: {message}", err=True)

    warnings.showwarning = say_once


def run_command() -> None:
    """Run the command; report a user's mistake (exit code 2) or a failure of the system (1) without a traceback."""
    # imported now: at the limit of open files, imports fail
    from carom.errors import ExistsError, ExperimentError, PhysicsError, RecordingError, SceneError
    from carom.terminal.printing import say

    keep_freed_memory()
    collect_garbage_rarely()
    _say_warnings_once()
    try:
        code = app(standalone_mode=False)
    except typer.Abort:
        sys.exit(1)
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
        if VERBOSITY.is_verbose:
            traceback.print_exc()
        if isinstance(error, _UsageError):
            sys.exit(_refuse_usage(error))
        if isinstance(error, MemoryError) or "can't start new thread" in str(error):
            typer.echo("carom: out of memory; use fewer bodies or raise the memory limit (`ulimit -v`)", err=True)
            sys.exit(1)
        if "Too many open files" in str(error):  # Rerun raises a RuntimeError with this text
            typer.echo("carom: too many files are open; raise the limit (`ulimit -n`)", err=True)
            sys.exit(1)
        if not isinstance(error, (SceneError, RecordingError, ExperimentError, PhysicsError)):
            raise
        text = str(error)
        if isinstance(error, ExistsError):
            text = f"{error.path}: exists; give --force to replace it, or another name with -o"
        say(f"carom: {text}", err=True)
        sys.exit(2)
    sys.exit(code if isinstance(code, int) else 0)


def _refuse_usage(error: Any) -> int:
    """Print a mistake in the arguments in one line, or the help if there are no arguments; return the exit code."""
    from carom.terminal.printing import say

    if error.ctx is None or type(error).__name__ == "NoArgsIsHelpError":
        error.show()
        return int(error.exit_code)
    text = error.format_message().strip().rstrip(".")
    _, _, name = error.ctx.command_path.partition(" ")
    see = f"`carom {_HELP}{f' {name}' if name else ''}`"
    say(f"carom: {text[:1].lower()}{text[1:]}{' See' if text.endswith('?') else '; see'} {see}", err=True)
    return int(error.exit_code)


class Lossy(io.FileIO):
    """A stream whose failures never end a command: after the first failure, everything written is dropped."""

    def __init__(self, descriptor: int) -> None:
        super().__init__(descriptor, "w", closefd=False)
        self.error: OSError | None = None

    def write(self, data: ReadableBuffer, /) -> int:
        """Write or drop the data; return the number of bytes handled."""
        if self.error is None:
            try:
                return os.write(self.fileno(), data)
            except OSError as error:
                self.error = error
        return memoryview(data).nbytes


def replace_streams() -> Lossy:
    """Replace ``sys.stdout`` and ``sys.stderr``; return the raw standard output, which keeps its first error.

    Characters that the encoding of a terminal lacks are printed as question marks.
    """
    # a recording must not get the descriptor of standard error, since libraries print to it
    for descriptor in range(3):
        try:
            os.fstat(descriptor)
        except OSError:
            os.open(os.devnull, os.O_RDWR)
    out, err = Lossy(1), Lossy(2)
    sys.stdout = _text(out, sys.stdout)
    sys.stderr = _text(err, sys.stderr)
    return out


def _text(raw: Lossy, before: TextIO | None) -> io.TextIOWrapper:
    """Return a text stream with the encoding of the replaced stream; None if the descriptor was closed."""
    encoding = before.encoding if before is not None else "utf-8"
    buffered = io.BufferedWriter(raw)
    return io.TextIOWrapper(buffered, encoding, errors="replace", line_buffering=raw.isatty() or raw.fileno() == 2)
