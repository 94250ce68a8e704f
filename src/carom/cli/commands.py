"""The table of commands, their loading and their help.

A command is a function. Its module is imported when the command runs or shows its help. Other packages are imported
only when it runs, so that `carom --help` does not wait for a compiler and a viewer.
"""

from __future__ import annotations

import importlib
import inspect
from collections.abc import Iterator, Mapping
from typing import Any, cast

import typer
from typer.core import TyperCommand, TyperGroup

from carom import registry

EXTENSIONS = "Extensions"  # panel of the commands of installed packages
COMMANDS: dict[str, dict[str, str]] = {  # panel → name → module:function, in the order of a newcomer's needs
    "Simulate": {
        "run": "carom.cli.run:run",
        "scenes": "carom.cli.scenes:scenes",
        "new": "carom.cli.scenes:new",
        "explain": "carom.cli.scenes:explain",
        "resume": "carom.cli.run:resume",
        "sweep": "carom.lab.sweep.sweep_command:sweep",
        "warmup": "carom.cli.compiling:warmup",
    },
    "Look": {"view": "carom.cli.view:view", "picture": "carom.cli.view:picture", "movie": "carom.cli.movie:movie"},
    "Ask": {
        "inspect": "carom.cli.inspect:inspect",
        "contacts": "carom.cli.contacts:contacts",
        "why": "carom.lab.why.why_command:why",
        "replay": "carom.cli.replay:replay",
        "diff": "carom.lab.diff.diff_command:diff",
        "fork": "carom.lab.fork.fork_command:fork",
        "shrink": "carom.lab.shrink.shrink_command:shrink",
    },
    "Measure": {
        "tradeoff": "carom.lab.tradeoff.tradeoff_command:tradeoff",
        "tune": "carom.lab.tradeoff.tradeoff_command:tune",
        "stress": "carom.cli.stress:stress",
        "hunt": "carom.lab.hunt.hunt_command:hunt",
        "crosscheck": "carom.lab.crosscheck.crosscheck_command:crosscheck",
    },
    "Keep and share": {
        "clip": "carom.cli.recordings:clip",
        "repair": "carom.cli.recordings:repair",
        "report": "carom.cli.recordings:report",
        "publish": "carom.cli.view:publish",
        "export": "carom.cli.recordings:export",
    },
}


class Command(TyperCommand):
    """A command whose help shows flags without a type, and paragraphs without the line breaks of the source."""

    def __init__(self, *arguments: Any, **keywords: Any) -> None:
        super().__init__(*arguments, **keywords)
        paragraphs = inspect.cleandoc(self.help or "").split("\n\n")  # Typer joins the lines of the first one only
        self.help = "\n\n".join(paragraph.replace("\n", " ") for paragraph in paragraphs)

    def get_params(self, ctx: Any) -> list[Any]:
        """Return the parameters, ``--help`` among them."""
        return _plain(super().get_params(ctx))


class _Commands(Mapping[str, Any]):
    """The commands by name, each made on its first use."""

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
    """The command above the others; it also has the commands of installed packages."""

    def __init__(self, **keywords: Any) -> None:
        super().__init__(**keywords)
        self.commands = cast("dict[str, Any]", _Commands())

    def get_params(self, ctx: Any) -> list[Any]:
        """Return the parameters, ``--help`` among them."""
        return _plain(super().get_params(ctx))

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
            return _made(cmd_name, registry.load("commands", cmd_name), EXTENSIONS)
        except registry.ExtensionError as error:
            return _made(cmd_name, _raising(error), EXTENSIONS)


def _made(name: str, function: Any, panel: str) -> Any:
    """Return a command that calls a function."""
    app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode="rich")
    app.command(name, cls=Command, rich_help_panel=panel)(function)
    return typer.main.get_command(app)


def _raising(error: registry.ExtensionError) -> Any:
    """Return a replacement for a command that cannot be loaded: its help shows the error, and a call raises it."""

    def broken() -> None:
        raise error

    broken.__doc__ = str(error)
    return broken


def _plain(parameters: list[Any]) -> list[Any]:
    """Show flags without a type, since they take no value."""
    for parameter in parameters:
        if getattr(parameter, "is_bool_flag", False):
            parameter.metavar = ""
    return parameters
