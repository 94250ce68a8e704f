"""Tell a person why the first run on a machine takes a while."""

from __future__ import annotations

from collections.abc import Callable

import typer


def announce_compilation(say: Callable[[str], None] | None = None) -> None:
    """Say so, on stderr unless told how, when kernels are compiled, once."""
    from carom.physics.kernel import on_compilation

    text = "Compiling kernels, once on this machine (about half a minute) …"
    on_compilation(lambda: say(text) if say else typer.echo(text, err=True))
