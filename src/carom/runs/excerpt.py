"""The clip in a bug report: the frames around a moment that fit, and if one alone does not, the bodies around it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from carom.recording.edit.clip import Clip, clip
from carom.recording.read.recording import Recording
from carom.recording.schema.paths import STEP

MOST_BODIES = 2000  # of a clip without exact states; so few are drawn as ellipsoids
BYTES_OF_A_BODY = 150  # of an exact state, and of what holds for all frames; compressed a little less
BYTES_DRAWN = 60  # of a body in a frame
MOST_READ = 2_000_000_000  # bytes of frames that are read to cut some bodies out of them
COMPRESSED = 4  # times at most, of resting bodies; more frames than could fit are not tried


def excerpt(recording: Recording, moment: float, path: Path, frames: int, room: int) -> Clip:
    """Cut a clip of at most ``room`` bytes, if it is possible at all.

    It has fewer and fewer frames. If one is too large, it leaves out the exact states, and has the bodies nearest to
    what happened at the moment.

    Parameters
    ----------
    recording
        The whole run, or a clip.
    moment
        s, the time in question.
    path
        The ``.rrd`` to write.
    frames
        The most frames, half of them before the moment.
    room
        Bytes.
    """
    times = recording.fingerprints()["time"].to_numpy()
    middle, bodies = int(np.argmin(np.abs(times - moment))), len(recording.shown)
    if BYTES_OF_A_BODY * int(recording.info["bodies"]) <= 2 * room:
        fitting = min(frames, 1 + COMPRESSED * room // (BYTES_DRAWN * bodies))
        made = _fewer_frames(recording, middle, path, fitting, room, None)
        if made.size <= room or bodies == 1:
            return made
    frames = min(frames, 1 + MOST_READ // (BYTES_DRAWN * bodies))
    step, most = int(recording.fingerprints()[STEP][middle].as_py()), min(MOST_BODIES, max(1, bodies - 1))
    while True:
        made = _fewer_frames(recording, middle, path, frames, room, _nearest(recording, moment, step, most))
        if made.size <= room or most == 1:
            return made
        most //= 2


def _fewer_frames(
    recording: Recording, middle: int, path: Path, frames: int, room: int, bodies: list[int] | None
) -> Clip:
    """Cut as many frames as there is room for, at least one; of some bodies, without exact states."""
    times, count = recording.fingerprints()["time"].to_numpy(), frames
    while True:
        first, last = max(0, middle - count // 2), min(len(times) - 1, middle + count // 2)
        made = clip(recording.path, path, times[first], times[last], bodies, exact=bodies is None)
        if made.size <= room or count == 0:
            return made
        count = 0 if count == 1 else max(1, min(count // 2, int(count * room / made.size)))


def _nearest(recording: Recording, moment: float, step: int, count: int) -> list[int]:
    """Return the numbers of the bodies that are drawn nearest to what happened at a moment."""
    shown, drawn = np.asarray(recording.shown), recording.drawn_positions(step)
    if drawn is None or len(drawn) != len(shown):
        return [int(body) for body in shown[:count]]
    apart = drawn - _focus(recording, moment, shown, drawn)
    order = np.argsort(np.sum(apart * apart, axis=1), kind="stable")
    return [int(body) for body in shown[np.sort(order[:count])]]


def _focus(
    recording: Recording, moment: float, shown: NDArray[np.int64], drawn: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Return where the body is drawn that has to do with a moment; the middle of all if none has."""
    for found in recording.summary()["moments"].values():
        places = np.flatnonzero(np.isin(shown, found["bodies"]))
        if found["time"] == moment and len(places):
            return np.asarray(drawn[places[0]])
    return np.asarray(np.median(drawn, axis=0))
