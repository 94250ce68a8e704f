"""The step of each impact: an engine may resolve an impact later than in the step in which the bodies meet."""

from __future__ import annotations

import numpy as np

from carom.arrays import BoolArray, FloatArray, IntArray
from carom.engines.engine_contacts import Near
from carom.engines.missed_impacts import TUNNELLED


class Strikes:
    """Impacts from the frame in which their bodies meet to the frame in which they lose half of their closing speed.

    The engine's contact forces act in that last frame, not in the first. If bodies part again without this loss, the
    engine has missed their impact.
    """

    def __init__(self) -> None:
        self._met: dict[tuple[int, int], tuple[float, FloatArray]] = {}  # closing speed (m/s) and normal, by ends

    def see(
        self, near: Near, ends: IntArray, met: BoolArray, speeds: tuple[FloatArray, FloatArray], normal: FloatArray
    ) -> FloatArray:
        """Return the closing speeds (k,) in m/s of the impacts that this frame resolves; 0 for other pairs.

        ``ends`` (n + p,) are the lasting numbers of bodies and planes, and ``met`` (k,) marks pairs that meet in this
        frame. ``speeds`` are the closing speeds of pairs before and after the frame, along their ``normal`` (k, 3).
        """
        closing, after = speeds
        struck = np.where(met & (after < TUNNELLED * closing), closing, 0.0)
        waiting = met & (struck == 0.0)
        if not (self._met or waiting.any()):
            return struck
        earlier, self._met = self._met, {}
        for row in np.flatnonzero(waiting | (near.gap_before <= 0.0)).tolist():
            key = int(ends[near.pairs[row, 0]]), int(ends[near.pairs[row, 1]])
            if waiting[row]:
                self._met[key] = float(closing[row]), normal[row]
            elif key in earlier:
                speed, along = earlier[key]
                if -float(near.relative_now[row] @ along) < TUNNELLED * speed:
                    struck[row] = speed
                elif near.gap_now[row] <= 0.0:
                    self._met[key] = earlier[key]
        return struck
