"""Tell a person why the first run on a machine takes a while."""

from __future__ import annotations

from collections.abc import Callable

import typer

NO_CACHE = "no folder to keep them in is writable; set NUMBA_CACHE_DIR to one of your own"


def announce_compilation(say: Callable[[str], None] | None = None, helped: bool = False) -> None:
    """Say so, on stderr unless told how, when kernels are compiled, once; let a second process compile some of them.

    Parameters
    ----------
    helped
        Whether that process has been started.
    """
    from carom.physics.jit.decorators import cache_folder, on_compilation
    from carom.runs.compiling_process import start_compiling

    text = "Compiling kernels, once on this machine (about 15 s) …"
    if not cache_folder():
        text = f"Compiling kernels (about 20 s), at every start: {NO_CACHE} …"

    def announce() -> None:
        if say:
            say(text)
        else:
            typer.echo(text, err=True)
        if not helped and cache_folder():
            start_compiling()

    on_compilation(announce)
