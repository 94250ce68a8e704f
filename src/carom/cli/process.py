"""The command as a process: its streams, the signals that end it, and its exit code."""

from __future__ import annotations

import errno
import os
import sys
from typing import NoReturn

import typer

from carom.cli import streams
from carom.cli.main import main as command
from carom.private_folder import remove_private_folder
from carom.runs.interrupts import raise_signals, received

_INTERRUPTED = 130  # Typer's exit code for a KeyboardInterrupt that no command dealt with


def main() -> NoReturn:
    """Run the command and exit.

    Exit codes: 2 and one message for a person's mistake; 1 for a run that ended early or missed a promise; 128 and the
    signal's number for a command that a signal ended before it had anything to close.
    """
    raise_signals()
    output = streams.install()
    code: int | str | None = 0
    try:
        command()
    except SystemExit as ending:
        code = ending.code
        if received() and code == _INTERRUPTED:
            _leave()
    except BaseException:  # an interrupted import may raise anything
        if received():
            _leave()
        raise
    sys.stdout.flush()
    if output.error is not None and output.error.errno != errno.EPIPE:  # a reader that left has read enough
        typer.echo(f"carom: cannot write to standard output: {output.error.strerror}", err=True)
        code = code or 1
    sys.exit(code)


def _leave() -> NoReturn:
    """End at once after a signal, while its traceback is held: to let go of Rerun's streams may take for ever."""
    typer.echo("carom: interrupted", err=True)
    sys.stdout.flush()
    remove_private_folder()
    os._exit(128 + received())
