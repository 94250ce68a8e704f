"""How this process asks the system for memory.

A run hands thousands of arrays from thread to thread. glibc gives such memory back as soon as it is free, and asks for
it again: 40 page faults a frame of 1000 bodies, a twentieth of the run. Told to keep it, the process is no larger in
the end, since the frames under way are bounded.
"""

from __future__ import annotations

import ctypes
import sys

_ARENA_MAX, _TRIM_THRESHOLD, _MMAP_THRESHOLD = -8, -1, -3  # glibc's <malloc.h>
_KEPT = 512 << 20  # bytes that are kept free
_LARGE = 64 << 20  # bytes of an array that gets pages of its own


def keep_freed_memory() -> None:
    """Keep freed memory for the next frame, in one pool for all threads; only where the C library is glibc.

    To be called before there are other threads: those that NumPy starts have pools of their own for good.
    """
    if not sys.platform.startswith("linux"):
        return
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (AttributeError, OSError):  # another C library
        return
    for option, value in ((_ARENA_MAX, 1), (_TRIM_THRESHOLD, _KEPT), (_MMAP_THRESHOLD, _LARGE)):
        mallopt(option, value)
