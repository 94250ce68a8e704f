"""Chooses how many impacts of each frame are recorded, and how many of its contacts get arrows."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from carom.physics.aligned import record
from carom.physics.parallel.jit import inline, long_kernel
from carom.recording.schema.header import Header
from carom.recording.write.encoding_kernels import count_moved

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

FILE_BYTES = 300_000  # layout, styles and footer (docs/recording.md, Size)
SHARE = 0.22  # of all else in the file; with what is not counted here a fifth of the whole
_ARROWS, _SCENES = 0.02, 0.04  # of all else: arrows, and frames of the bodies at impacts
_ROW = 60  # bytes of a row besides its arrays
_CONTACT, _IMPACT, _ARROW = 12.5, 85, 32  # bytes in the file, packed, as measured
_SCALARS = 500  # bytes of a frame's scalars, likewise

_BUDGET = record(  # bytes so far
    "others contacts"  # of all else; of contacts and impacts
    " arrows scenes"  # of the latter on arrows, and on the frames of all bodies
)


class Kept(NamedTuple):
    """What is recorded of each frame of a batch, (frames,)."""

    impacts: IntArray  # impacts since the frame before, those of the largest normal impulses
    arrows: IntArray  # contacts that are drawn with arrows
    scenes: IntArray  # impacts, from the first on, with a frame of all bodies


class ImpactPlan:
    """Decides how many impacts and contacts of each frame are recorded.

    All impacts are kept while everything that is recorded of contacts takes at most a fifth of the file so far. Then
    those of the largest normal impulses are kept, of each frame at least one. The choice depends on the frames alone,
    not on how they are batched, so that the same run always has the same rows.

    Parameters
    ----------
    everything
        Whether all impacts are kept and all contacts get arrows, whatever they cost.
    oriented, turned
        Whether bodies have orientations and torques.
    """

    def __init__(self, *, everything: bool, oriented: bool, turned: bool) -> None:
        self._model = everything, oriented, turned
        self._budget = np.zeros(1, _BUDGET)
        self._budget["others"] = FILE_BYTES
        self._before: NDArray[np.float32] | None = None  # (n, 3) m, as drawn in the frame before

    @classmethod
    def of(cls, header: Header, *, everything: bool = False) -> ImpactPlan:
        """Return the plan of a recording; with everything if its scene asks for that, or if it is asked for here."""
        everything = everything or header.record_impacts == "all"
        return cls(everything=everything, oriented=header.has_orientation, turned=header.has_torque)

    def choose(self, position: FloatArray, edges: IntArray, contacts: IntArray, impacts: IntArray) -> Kept:
        """Decide for the next frames.

        Parameters
        ----------
        position
            (frames, n, 3) m.
        edges, contacts, impacts
            (frames,) how many each has.
        """
        if self._before is None:
            self._before = np.full(position.shape[1:], np.nan, dtype=np.float32)
        moved = np.empty(len(position), dtype=np.int64)
        count_moved(position, self._before, moved)
        kept = Kept(*np.empty((3, len(position)), dtype=np.int64))
        _spend(SHARE, *self._model, position.shape[1], moved, edges, contacts, impacts, self._budget, kept)
        return kept


def largest(impacts: NDArray[np.void], count: int) -> IntArray:
    """Return which impacts have the largest normal impulses, in order of time; of equal ones the first."""
    if len(impacts) <= count:
        return np.arange(len(impacts))
    return np.sort(np.argsort(-impacts["normal_impulse"], kind="stable")[:count])


@long_kernel
def _spend(
    share: float,
    everything: bool,
    oriented: bool,
    turned: bool,
    bodies: int,
    moved: IntArray,
    edges: IntArray,
    contacts: IntArray,
    impacts: IntArray,
    budget: NDArray[np.void],
    kept: Kept,
) -> None:
    """Decide for frames, (frames,), by how many bodies moved, edges, contacts and impacts each has."""
    used = budget[0]
    scene = _ROW + bodies * (28 if oriented else 12)
    arrow = 2 * _ARROW if turned else _ARROW  # with friction two
    for f in range(len(moved)):
        used.others += _size(bodies, moved[f] / bodies, edges[f], oriented, turned)
        most, arrows, room = impacts[f], contacts[f], np.inf
        if not everything:
            used.contacts += _CONTACT * contacts[f]
            most = min(impacts[f], max(1, int((share * used.others - used.contacts) / _IMPACT)))
            used.contacts += _IMPACT * most
            left = min(share * used.others - used.contacts, _ARROWS * used.others - used.arrows)
            arrows = max(0, min(contacts[f], int(left / arrow)))
            used.contacts += arrow * arrows
            used.arrows += arrow * arrows
            room = share * used.others - used.contacts
        scenes = max(0, int(min(float(most), min(room, _SCENES * used.others - used.scenes) / scene)))
        used.contacts += scene * scenes
        used.scenes += scene * scenes
        kept.impacts[f], kept.arrows[f], kept.scenes[f] = most, arrows, scenes


@inline
def _size(bodies: int, moved: float, edges: int, oriented: bool, turned: bool) -> float:
    """Estimate what else a frame takes in the file: bodies, arrows of torques, edges, scalars, checkpoints; in bytes.

    What does not change from frame to frame is packed to little; ``moved`` is the share of the bodies that do.
    """
    drawn = bodies * (2 + moved * (26 if oriented else 10))
    arrows = 22 * (1 + moved) * min(bodies, 2 * edges) if turned else 0.0
    return 1.08 * (drawn + arrows + (5 + 12 * moved) * edges + _SCALARS)
