"""Tell a person why the first run on a machine takes a while."""

from __future__ import annotations

import typer


def announce_compilation() -> None:
    """Say so on stderr when kernels are compiled, once."""
    from carom.physics.kernel import on_compilation

    on_compilation(lambda: typer.echo("Compiling kernels, once on this machine (about 15 s) …", err=True))
