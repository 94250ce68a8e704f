"""Settings of the memory allocator.

A run passes thousands of arrays between threads. By default glibc returns such memory to the system as soon as it is
free and requests it again: 40 page faults per frame of 1000 bodies, a twentieth of the run. Keeping it makes the
process no larger, because the number of queued frames is bounded.
"""

from __future__ import annotations

import ctypes
import sys

_ARENA_MAX, _TRIM_THRESHOLD, _MMAP_THRESHOLD = -8, -1, -3  # glibc's <malloc.h>
_KEPT = 512 << 20  # bytes of free memory to keep
_LARGE = 64 << 20  # bytes; larger arrays get pages of their own


def keep_freed_memory() -> None:
    """Keep freed memory for the next frame, in one pool for all threads; does nothing without glibc.

    Call it before there are other threads, because threads that NumPy starts keep pools of their own.
    """
    if not sys.platform.startswith("linux"):
        return
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (AttributeError, OSError):  # another C library
        return
    for option, value in ((_ARENA_MAX, 1), (_TRIM_THRESHOLD, _KEPT), (_MMAP_THRESHOLD, _LARGE)):
        mallopt(option, value)
