"""Settings of the memory allocator and of Python's search for garbage.

A run passes thousands of arrays between threads. By default glibc returns such memory to the system as soon as it is
free and requests it again: 40 page faults per frame of 1000 bodies, a twentieth of the run. Keeping it makes the
process no larger, because the number of queued frames is bounded.
"""

from __future__ import annotations

import ctypes
import gc
import sys
from collections.abc import Iterator
from contextlib import contextmanager

_ARENA_MAX, _TRIM_THRESHOLD, _MMAP_THRESHOLD = -8, -1, -3  # glibc's <malloc.h>
_KEPT = 512 << 20  # bytes of free memory to keep
_LARGE = 64 << 20  # bytes; larger arrays get pages of their own
_NEW_OBJECTS = 100_000  # the first batches need 60 000, of which the modules that they load remain


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


@contextmanager
def garbage_sought_seldom() -> Iterator[None]:
    """Let Python look for cycles of garbage after 100 000 new objects in place of 700.

    It finds none, because frames and rows have no cycles. A look at all objects takes 0.1 s, in which the physics waits
    for the interpreter's lock, and the small looks took 50 µs of each frame of 1000 bodies (both on a busy machine).
    """
    before = gc.get_threshold()
    if before[0]:  # or else somebody has switched it off
        gc.set_threshold(max(_NEW_OBJECTS, before[0]), *before[1:])
    try:
        yield
    finally:
        gc.set_threshold(*before)
