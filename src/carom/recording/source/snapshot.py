"""`Snapshot`: memory for a state, which is used again and again; and how a source fills it."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from carom.errors import RecordingError
from carom.recording.schema.properties import LARGEST
from carom.recording.source.source import Source, State, time_of

_LEAST, _MOST = np.minimum.reduce, np.maximum.reduce  # the methods `min` and `max` go through Python
_ARRAYS = ("position", "velocity", "orientation", "angular_velocity")

_Floats = NDArray[np.floating[Any]]


class Snapshot:
    """Memory for one state after another.

    The engine's own thread fills it, so that makes few calls: one copy an array, and two passes over the block to
    see that all is finite.

    Parameters
    ----------
    state
        Whose arrays are views of the blocks.
    block
        The array that holds all numbers of the state.
    parts
        Views of it that a `BulkSource` fills.
    """

    def __init__(self, state: State, block: _Floats, parts: tuple[NDArray[Any], ...] = ()) -> None:
        self.state, self.block, self.parts = state, block, parts
        block.fill(0.0)  # or the system would provide the memory during the first copy

    @classmethod
    def like(cls, state: State) -> Snapshot:
        """Return memory in float64 for states with the same arrays as a first one."""
        there = [name for name in _ARRAYS if getattr(state, name) is not None]
        shapes = [np.shape(getattr(state, name)) for name in there]
        ends = np.cumsum([0, *(int(np.prod(shape)) for shape in shapes)])
        block = np.empty(int(ends[-1]))
        parts = [block[a:b].reshape(shape) for (a, b), shape in zip(pairwise(ends), shapes, strict=True)]
        return cls(State(state.time, **dict(zip(there, parts, strict=True))), block)

    def take(self, state: State) -> None:
        """Copy a state. Raises RecordingError if its arrays have other shapes, or its time is no number."""
        own = self.state
        own.time = time_of(state)
        for name in _ARRAYS:
            view = getattr(own, name)
            if view is not None:
                values = getattr(state, name)
                if np.shape(values) != view.shape:  # or numpy would repeat the rows that there are
                    raise RecordingError(
                        f"{name} has the shape {np.shape(values)} and had {view.shape}: a recording keeps its bodies; "
                        "begin another one"
                    )
                view[:] = values
        own.contacts = None if state.contacts is None else np.array(state.contacts, dtype=np.int64)

    @property
    def bounded(self) -> bool:
        """Whether all of it is finite and not too large to compute with."""
        # NaN is out of bounds, too, and both return it; as Python's numbers, since float32 ends before LARGEST
        return (
            -LARGEST <= self.state.time <= LARGEST
            and float(_LEAST(self.block, None)) >= -LARGEST
            and float(_MOST(self.block, None)) <= LARGEST
        )


@runtime_checkable
class BulkSource(Protocol):
    """A source that copies the engine's memory into a snapshot at once, without arrays in between."""

    def memory(self) -> Snapshot:
        """Return memory that `read` can fill."""

    def read(self, into: Snapshot) -> None:
        """Copy the present state."""


def memory_of(source: Source, like: State) -> Callable[[], Snapshot]:
    """Return what makes memory for the states of a source."""
    return source.memory if isinstance(source, BulkSource) else lambda: Snapshot.like(like)


def reader_of(source: Source) -> Callable[[Snapshot], None]:
    """Return what copies the present state of a source into a snapshot."""
    return source.read if isinstance(source, BulkSource) else lambda snapshot: snapshot.take(source.state())
