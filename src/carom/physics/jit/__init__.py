"""Compiled kernels, and the threads that share their work: the only package that imports Numba and llvmlite.

Each technique that Numba does not document has a plain form with the same bits (see `inside`).
"""

from __future__ import annotations

import os


def cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
