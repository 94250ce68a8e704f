"""Preparation of a local worker before its first run; Dask calls `dask_setup`."""

from __future__ import annotations

import signal

import carom.experiment.sweep.task  # noqa: F401 - kernels and Rerun are loaded while the others start
from carom.experiment.memory import keep_freed_memory


def dask_setup(worker: object) -> None:
    """Ignore the interrupt key; the command handles it and lets current runs finish."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    keep_freed_memory()
