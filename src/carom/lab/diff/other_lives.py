"""The bodies that exist at other times in one of two recordings than in the other."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from carom import Recording
from carom.arrays import FloatArray
from carom.extend import TIME, UnitSystem, body_called, tolerance


@dataclass(frozen=True, slots=True)
class OtherLife:
    """When a body exists in each of two recordings, within the time that they have in common."""

    body: int
    name: str
    spans: tuple[tuple[float, float] | None, tuple[float, float] | None]  # s; None where it does not exist

    def text(self, units: UnitSystem) -> str:
        """Describe when it exists in each of them."""
        one, other = ("never" if span is None else units.span(*span, TIME) for span in self.spans)
        return f"{body_called(self.body, self.name)} exists {one} in A, {other} in B"


def other_lives(a: Recording, b: Recording) -> list[OtherLife]:
    """Return the bodies that do not exist from the same time to the same time in both recordings."""
    if a.lives is None and b.lives is None:
        return []
    ends = [recording.fingerprints()["time"].to_numpy()[[0, -1]] for recording in (a, b)]
    begin, end = max(each[0] for each in ends), min(each[1] for each in ends)
    spans = [_spans(recording, begin, end) for recording in (a, b)]
    found = []
    for body in range(max(map(len, spans))):
        one, other = (each[body] if body < len(each) else np.full(2, np.nan) for each in spans)
        if np.allclose(one, other, rtol=0.0, atol=tolerance(end), equal_nan=True):
            continue
        named = a if body < len(spans[0]) else b
        lives = tuple(None if np.isnan(each[0]) else (float(each[0]), float(each[1])) for each in (one, other))
        found.append(OtherLife(body, named.bodies.name[body], (lives[0], lives[1])))
    return found


def _spans(recording: Recording, begin: float, end: float) -> FloatArray:
    """Return the times (n, 2) in s of the first and the last frame with each body in an interval; NaN for none."""
    table, n = recording.fingerprints(), int(recording.info["bodies"])
    if recording.lives is None:
        return np.tile((begin, end), (n, 1))
    steps, times = table["step"].to_numpy(), table["time"].to_numpy()
    first, last = recording.lives.T
    rows = np.searchsorted(steps, first), np.searchsorted(steps, last, side="right") - 1
    spans = np.stack([times[np.clip(each, 0, len(times) - 1)] for each in rows], axis=1)
    lives = (first >= 0) & (rows[0] < len(times)) & (rows[1] >= 0) & (spans[:, 0] <= end) & (spans[:, 1] >= begin)
    return np.where(lives[:, None], np.clip(spans, begin, end), np.nan)
