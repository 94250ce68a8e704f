"""Chooses which impacts of each frame are recorded, and how many of its contacts get arrows."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from carom.physics.frame import Frame
from carom.recording.write.encoding_kernels import count_moved

IntArray = NDArray[np.int64]

ONCE = 300_000  # bytes of layout, styles and footer (docs/recording.md, Size)
SHARE = 0.22  # of all else in the file; with what is not counted here a fifth of the whole
_ARROWS, _SCENES = 0.02, 0.04  # of all else: arrows, and frames of the bodies at impacts
_ROW = 60  # bytes of a row besides its arrays
_CONTACT, _IMPACT, _ARROW = 12.5, 85, 32  # bytes in the file, packed, as measured
_SCALARS = 500  # bytes of a frame's scalars, likewise


class Kept(NamedTuple):
    """What is recorded of a frame."""

    impacts: IntArray  # which of those since the frame before, in order of time
    arrows: int  # contacts that are drawn with arrows
    scenes: int  # number of impacts, from the first on, with a frame of all bodies


class ImpactPlan:
    """Decides which impacts and contacts of each frame are recorded.

    All impacts are kept while everything that is recorded of contacts takes at most a fifth of the file so far. Then
    those of the largest normal impulses are kept, of each frame at least one. The choice depends on the frames alone,
    not on how they are batched, so that the same run always has the same rows.

    Parameters
    ----------
    everything
        Whether all impacts are kept and all contacts get arrows, whatever they cost.
    """

    def __init__(self, *, everything: bool) -> None:
        self._everything = everything
        self._others = float(ONCE)  # bytes of all else so far
        self._spent = 0.0
        self._drawn = 0.0  # of that on arrows
        self._shown = 0.0  # of that on frames of bodies
        self._size = _Size()

    def choose(self, frame: Frame) -> Kept:
        """Decide for the next frame."""
        impacts = 0 if frame.impacts is None else len(frame.impacts)
        contacts = 0 if frame.contact_rows is None else len(frame.contact_rows)
        self._others += self._size.of(frame)
        if self._everything:
            return Kept(np.arange(impacts), contacts, self._scenes(frame, impacts, np.inf))
        self._spent += _CONTACT * contacts
        kept = largest(frame.impacts, max(1, int((SHARE * self._others - self._spent) / _IMPACT)))
        self._spent += _IMPACT * len(kept)
        each = _ARROW if frame.torque is None else 2 * _ARROW  # with friction two
        left = min(SHARE * self._others - self._spent, _ARROWS * self._others - self._drawn)
        arrows = max(0, min(contacts, int(left / each)))
        self._spent += each * arrows
        self._drawn += each * arrows
        return Kept(kept, arrows, self._scenes(frame, len(kept), SHARE * self._others - self._spent))

    def _scenes(self, frame: Frame, impacts: int, room: float) -> int:
        """Return at how many impacts the bodies are drawn, in so many bytes at most."""
        each = _ROW + len(frame.position) * (12 if frame.orientation is None else 28)
        scenes = max(0, int(min(impacts, min(room, _SCENES * self._others - self._shown) / each)))
        self._spent += each * scenes
        self._shown += each * scenes
        return scenes


def largest(impacts: NDArray[np.void] | None, count: int) -> IntArray:
    """Return which impacts have the largest normal impulses, in order of time; of equal ones the first."""
    if impacts is None or len(impacts) <= count:
        return np.arange(0 if impacts is None else len(impacts))
    return np.sort(np.argsort(-impacts["normal_impulse"], kind="stable")[:count])


class _Size:
    """Estimates what else each frame takes in the file: bodies, arrows of torques, edges, scalars, checkpoints.

    What does not change from frame to frame is packed to little.
    """

    def __init__(self) -> None:
        self._before: NDArray[np.float32] | None = None

    def of(self, frame: Frame) -> float:
        """Return bytes."""
        bodies, contacts = len(frame.position), len(frame.contacts)
        if self._before is None:
            self._before = np.full(frame.position.shape, np.nan, dtype=np.float32)
        moved = count_moved(frame.position, self._before) / bodies
        drawn = bodies * (2 + moved * (10 if frame.orientation is None else 26))
        turned = 0.0 if frame.torque is None else 22 * (1 + moved) * min(bodies, 2 * contacts)
        return 1.08 * (drawn + turned + (5 + 12 * moved) * contacts + _SCALARS)
