"""What a local worker does before its first run; Dask calls `dask_setup`."""

from __future__ import annotations

import signal

import carom.experiment.sweep.task  # noqa: F401 - kernels and Rerun are loaded while the others start
from carom.experiment.memory import keep_freed_memory


def dask_setup(worker: object) -> None:
    """Leave the interrupt key to the command, which lets the runs under way finish."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    keep_freed_memory()
