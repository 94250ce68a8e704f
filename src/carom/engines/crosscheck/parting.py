"""The divergence of a run from the reference: its time, the impact before it, and the violated laws."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from carom.arrays import FloatArray, IntArray
from carom.errors import RecordingError
from carom.lab.compared_run import Trajectory
from carom.lab.tradeoff.reference import Reference
from carom.recording.read.recorded_impacts import impacts_by_number
from carom.recording.read.recording import Recording
from carom.scene.wording import Names

PARTED = 0.01  # distance, in sizes of the system, at which runs have diverged
OTHER_OUTCOME = 0.01  # smallest change of velocities that makes another outcome of an impact, in speeds of the system
EARLIER = 2.0  # steps by which an impact of an engine may precede the same impact of the reference
LATER = 40.0  # steps after the reference's impact within which a soft contact ends
SAME_IMPACT = 0.02  # largest time between the same impact in two runs, as a fraction of the duration


@dataclass(frozen=True, slots=True)
class NumberedImpacts:
    """The recorded impacts, with the numbers used by ``--event impact:N``."""

    number: IntArray  # (k,)
    pair: IntArray  # (k, 2)
    time: FloatArray  # (k,) s
    known: bool = True  # whether the recording could be read

    @classmethod
    def of(cls, path: Path) -> NumberedImpacts:
        """Read the impacts of a recording; none if it cannot be read."""
        try:
            recording = Recording.open(path)
            if recording.records_contacts:
                number, _ = impacts_by_number(recording)
                table = recording.impacts()
                pair = np.stack((table["i"].to_numpy(), table["j"].to_numpy()), axis=1)
                return cls(number, pair.astype(np.int64), np.array(table["time"].to_numpy()))
        except RecordingError:
            pass
        return cls(np.empty(0, np.int64), np.empty((0, 2), np.int64), np.empty(0), known=False)

    def nearest(self, pair: IntArray, time: float, within: float) -> int | None:
        """Return the number of the pair's impact that is nearest to a time (s); None if no impact is near."""
        rows = np.flatnonzero((self.pair == pair).all(axis=1) & (np.abs(self.time - time) <= within))
        return int(self.number[rows[np.argmin(np.abs(self.time[rows] - time))]]) if len(rows) else None


@dataclass(frozen=True, slots=True)
class Parting:
    """The divergence of a run from the reference."""

    time: float  # s, time of the first sample that is too far away
    impact: int | None  # number, in carom's recording, of the first impact with another outcome; 0 if there is none
    between: str  # names of the bodies of this impact
    impact_time: float  # s, time of this impact in the reference
    laws: list[str]  # laws that are violated from that impact on


def parting_of(
    run: Trajectory,
    reference: Reference,
    broken: list[tuple[float, str]],
    dt: float,
    names: Names,
    numbered: NumberedImpacts,
) -> Parting | None:
    """Return the divergence of a run from a reference up to the reference's horizon; None without a divergence.

    The run has steps of ``dt`` s. ``broken`` lists the times (s) of violating frames, in order, with the violated laws;
    ``numbered`` are the impacts of carom's own run. The outcomes of these impacts are compared, unless the reference is
    exact and has impacts of its own. Comparing first contacts would not suffice: a pair that touches at the start has
    no impact then, but may have one later.
    """
    best = reference.trajectory.until(reference.samples)
    apart, _ = reference.scale.apart(run.until(reference.samples), best)
    away = np.flatnonzero(~(apart <= PARTED))
    if len(away) == 0 and len(run) >= reference.samples:
        return None
    time = float(best.time[away[0]]) if len(away) else float(run.time[-1]) if len(run) else 0.0
    if len(best.struck):
        pairs, times = best.struck, best.struck_at
    elif numbered.known:
        pairs, times = numbered.pair, numbered.time
    else:
        pairs, times = best.pair, best.met
    order = np.argsort(times, kind="stable")
    pairs, times = pairs[order], times[order]
    first = _first_other_outcome(run, reference, pairs, times, int(np.searchsorted(times, time, side="right")), dt)
    met = 0.0 if first is None else float(times[first])
    laws = dict.fromkeys(law for at, law in broken if met - EARLIER * dt <= at <= max(time, met + LATER * dt))
    within = max(SAME_IMPACT * float(reference.trajectory.time[-1]), LATER * dt)
    return Parting(
        time=time,
        impact=0 if first is None else numbered.nearest(pairs[first], met, within),
        between="" if first is None else names.pair(pairs[first].tolist()),
        impact_time=met,
        laws=list(laws),
    )


def _first_other_outcome(
    run: Trajectory, reference: Reference, pairs: IntArray, times: FloatArray, before: int, dt: float
) -> int | None:
    """Return the first impact with another outcome in a run, among the first ``before``; None without impacts.

    The velocities of an impact's bodies are compared at the last sample before their next impacts. If the next impacts
    come before a soft contact could have ended, their outcomes must also differ. If no velocity differs, return the
    last impact: the run diverges by a delayed impact, or in the flight after it.
    """
    best = reference.trajectory
    count, bodies = min(len(run), reference.samples), best.position.shape[1]
    wrong = np.linalg.norm(run.velocity[:count] - best.velocity[:count], axis=2)  # (count, n) m/s
    differs = wrong > OTHER_OUTCOME * reference.scale.speed
    for k in range(before):
        for body in (int(end) for end in pairs[k] if end < bodies):
            later = [float(t) for t in times[k + 1 :][(pairs[k + 1 :] == body).any(axis=1)] if t > times[k]]
            ends = [*later, math.inf][:2]
            last = np.searchsorted(best.time[:count], [end - EARLIER * dt for end in ends], side="left") - 1
            wrongs = [row >= 0 and best.time[row] > times[k] and bool(differs[row, body]) for row in last]
            soon = ends[0] - times[k] < LATER * dt
            if wrongs[0] and (not soon or wrongs[1]):
                return k
    return before - 1 if before else None
