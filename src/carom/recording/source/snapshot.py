"""`Snapshot`: a copy of a state, in one block of memory that is used again and again."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from carom.recording.source.source import LARGEST, State

_ARRAYS = ("position", "velocity", "orientation", "angular_velocity")


class Snapshot:
    """Memory for states with the same arrays as a first one.

    The engine's own thread takes snapshots, so it makes few calls: one copy an array, and two passes over the block.

    Parameters
    ----------
    like
        A state.
    """

    def __init__(self, like: State) -> None:
        there = [name for name in _ARRAYS if getattr(like, name) is not None]
        shapes = [np.shape(getattr(like, name)) for name in there]
        ends = np.cumsum([0, *(int(np.prod(shape)) for shape in shapes)])
        self._block = np.empty(int(ends[-1]))
        parts = [self._block[a:b].reshape(shape) for (a, b), shape in zip(pairwise(ends), shapes, strict=True)]
        arrays = dict(zip(there, parts, strict=True))
        self._views = tuple(arrays.items())
        self.state = State(like.time, **arrays)

    def take(self, state: State) -> bool:
        """Copy a state; return whether all of it is finite and not too large to compute with."""
        own = self.state
        own.time = state.time
        for name, view in self._views:
            view[:] = getattr(state, name)
        own.contacts = None if state.contacts is None else np.array(state.contacts, dtype=np.int64)
        # NaN is neither, and `min` and `max` return it
        return bool(self._block.min() >= -LARGEST and self._block.max() <= LARGEST and -LARGEST <= own.time <= LARGEST)
