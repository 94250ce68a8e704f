"""The second process that compiles kernels, beside the first run on a machine.

This module loads neither Numba nor the physics, so that the process can start before the run has loaded them.
"""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from pathlib import Path

from carom.physics import jit as parallel
from carom.physics.jit.cores import cores


def start_compiling() -> subprocess.Popen[bytes] | None:
    """Start the second process; returns None on one core, where it could not help.

    It ends with this process and leaves no files except the kernels.
    """
    if cores() < 2:
        return None
    try:
        helper = subprocess.Popen(
            [sys.executable, "-P", "-m", "carom.runs.compile_ahead"],
            stdin=subprocess.PIPE,  # closed when this process ends
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
    except OSError:
        return None
    threading.Thread(target=helper.wait, name="compile-ahead", daemon=True).start()  # prevents a zombie process
    return helper


def start_on_a_new_installation() -> subprocess.Popen[bytes] | None:
    """Start the second process where no kernel has been compiled since the installation; returns None elsewhere.

    This saves the time in which the run loads its modules. It looks only at the first folder in which kernels are kept;
    where that is another one, the second process starts with the first compilation.
    """
    folder = Path(parallel.__file__).parent / "__pycache__"
    new = "NUMBA_CACHE_DIR" not in os.environ and os.access(folder, os.W_OK) and not any(folder.glob("*.nbc"))
    return start_compiling() if new else None
