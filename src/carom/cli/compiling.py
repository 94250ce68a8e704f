"""Compilation of the kernels: its announcement, the second process that helps with it, and `carom warmup`.

This module loads neither Numba nor the physics, so that the second process can start before the run has loaded them.
"""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from carom.cli.options import JsonOption
from carom.cli.printing import duration_text, say_json
from carom.physics import jit
from carom.physics.jit import cores

if TYPE_CHECKING:
    from carom.scene.schema import Scene

NO_CACHE = "no cache folder is writable; set NUMBA_CACHE_DIR to a folder of your own"


def start_compiling() -> subprocess.Popen[bytes] | None:
    """Start a second process that compiles kernels beside the first run; return None on one core.

    It ends with this process and leaves no files except the kernels.
    """
    if cores() < 2:
        return None
    try:
        helper = subprocess.Popen(
            [sys.executable, "-P", "-m", "carom.runs.warmup"],
            stdin=subprocess.PIPE,  # closed when this process ends
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
    except OSError:
        return None
    threading.Thread(target=helper.wait, name="compile-ahead", daemon=True).start()  # prevents a zombie process
    return helper


def start_on_a_new_installation() -> subprocess.Popen[bytes] | None:
    """Start the second process if no kernel has been compiled since the installation; otherwise return None.

    It then compiles while the run loads its modules. Only the default cache folder is checked; with another folder, the
    second process starts at the first compilation.
    """
    folder = Path(jit.__file__).parent / "__pycache__"
    new = "NUMBA_CACHE_DIR" not in os.environ and os.access(folder, os.W_OK) and not any(folder.glob("*.nbc"))
    return start_compiling() if new else None


def announce_compilation(
    say: Callable[[str], None] | None = None, helped: bool = False, scene: Scene | None = None
) -> None:
    """Announce the first compilation of a kernel, and start a second process that compiles others.

    Parameters
    ----------
    say
        Prints the announcement; by default it goes to stderr.
    helped
        Whether the second process has already been started.
    scene
        The scene, if it is known. Walls and contact laws need further kernels, which take longer to compile.
    """
    from carom.physics.jit.decorators import cache_folder, on_compilation

    takes = "one or two minutes" if scene and (scene.wall or scene.contact.laws) else "about 15 s"
    text = f"Compiling kernels, once on this machine ({takes}) …"
    if not cache_folder():
        text = f"Compiling kernels ({takes}), at every start: {NO_CACHE} …"

    def announce() -> None:
        if say:
            say(text)
        else:
            typer.echo(text, err=True)
        if not helped and cache_folder():
            start_compiling()

    on_compilation(announce)


def warmup(as_json: JsonOption = False) -> None:
    """Compile all kernels now, so that later runs start at once."""
    from dataclasses import asdict

    from carom.runs.warmup import warm_up

    if not as_json:
        typer.echo("Compiling the kernels that are not in the cache …", err=True)
    warmth = warm_up()
    if as_json:
        say_json(asdict(warmth))
    else:
        where = f"cache: {warmth.cache}" if warmth.cache else NO_CACHE
        typer.echo(f"{warmth.compiled} kernels compiled in {duration_text(warmth.seconds)}; {where}")
