"""Announces the compilation of kernels, and lets a second process compile other kernels meanwhile.

This module loads neither Numba nor the physics at its import: on a new installation, the second process starts before
the run loads these modules.
"""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from carom.physics import jit
from carom.physics.jit import cores
from carom.terminal.printing import note

if TYPE_CHECKING:
    from carom.scene.load import Scene

NO_CACHE = "no cache folder is writable; set NUMBA_CACHE_DIR to a folder of your own"


def start_compiling() -> subprocess.Popen[bytes] | None:
    """Start a second process that compiles kernels beside the first run, and ends with it; return None on one core."""
    if cores() < 2:
        return None
    try:
        helper = subprocess.Popen(
            [sys.executable, "-P", "-m", "carom.runs.warmup"],
            stdin=subprocess.PIPE,  # the pipe closes when this process ends, and the helper then ends, too
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
    except OSError:
        return None
    threading.Thread(target=helper.wait, name="compile-ahead", daemon=True).start()  # prevents a zombie process
    return helper


def start_on_a_new_installation() -> subprocess.Popen[bytes] | None:
    """Start the second process before the run loads its modules, if the default cache folder contains no kernel.

    With another cache folder, the second process starts at the first compilation.
    """
    folder = Path(jit.__file__).parent / "__pycache__"
    new = "NUMBA_CACHE_DIR" not in os.environ and os.access(folder, os.W_OK) and not any(folder.glob("*.nbc"))
    return start_compiling() if new else None


def announce_compilation(
    say: Callable[[str], None] | None = None, helped: bool = False, scene: Scene | None = None
) -> None:
    """Announce the first compilation of a kernel, by default on stderr, and start a second process for other kernels.

    ``helped`` says that the second process already runs. The number of needed kernels depends on the scene.
    """
    from carom.physics.jit.decorators import cache_folder, on_compilation

    def announce() -> None:
        from carom.terminal.compilation_progress import CompilationProgress

        progress = CompilationProgress(scene, say or note)
        progress.__enter__()  # the progress is shown until the process ends
        often = "once on this machine" if cache_folder() else f"at every start: {NO_CACHE}"
        (say or note)(f"Compiling kernels, {often}: {progress.counts()} …")
        if not helped and cache_folder():
            start_compiling()

    on_compilation(announce)
