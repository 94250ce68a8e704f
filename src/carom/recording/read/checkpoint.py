"""Reads an exact state, and holds it against the fingerprint of its frame."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from carom.errors import RecordingError
from carom.physics.checkpoint import Checkpoint
from carom.recording.read.entities import Entities, Values, values_of
from carom.recording.rrd.arrow_stream import release_memory
from carom.recording.schema import paths
from carom.recording.schema.checkpoint import decode
from carom.recording.schema.timelines import STEP

if TYPE_CHECKING:
    from carom.recording.read.recording import Recording


def checkpoint_at(recording: Recording, entities: Entities, start: dict[str, Values], step: int) -> Checkpoint:
    """Return the exact state at a step; see `Recording.checkpoint`.

    Parameters
    ----------
    start
        The state in which a clip begins; empty if it is a whole run.
    """
    row = _row(recording, entities, start, step)
    release_memory()
    found = decode(step, row, len(recording.bodies.mass))
    frames = recording.fingerprints()
    own = np.flatnonzero(frames[STEP].to_numpy() == step)
    if len(own) and frames["fingerprint"][int(own[0])].as_py() != found.fingerprint:
        raise RecordingError(
            f"{recording.path}: the checkpoint at step {step} does not have the fingerprint of its frame; "
            "one is damaged"
        )
    return found


def _row(recording: Recording, entities: Entities, start: dict[str, Values], step: int) -> dict[str, Values]:
    for chunk in entities.chunks_at(step, paths.CHECKPOINT):
        rows = np.flatnonzero(chunk.batch[STEP].to_numpy() == step)
        if len(rows):
            return {name: values_of(chunk.batch[name][int(rows[-1])]) for name in chunk.components}
    if start and int(start[STEP][0]) == step:
        return {name: values.copy() for name, values in start.items()}
    raise RecordingError(f"{recording.path} has no checkpoint at step {step}")
