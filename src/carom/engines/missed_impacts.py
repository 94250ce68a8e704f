"""Impacts that an engine missed: bodies passed through each other, or closed at unchanged speed for unusually long.

Engines that find contacts at the start of a step resolve each impact one step after the bodies meet; other engines take
more steps for some impacts. An impact counts as missed only if it took longer than impacts usually take in this engine,
or if nothing separates the bodies at all.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from carom.arrays import BoolArray, FloatArray
from carom.engines.engine_contacts import MARGIN, Near, lengths
from carom.engines.source import Setup

UNCHANGED = 1e-3  # smallest relative change of the closing speed that counts as contact
TUNNELLED = 0.5  # fraction of the closing speed that bodies keep if they pass through each other without collision
FOUND = 5e-3  # smallest overlap, in smaller radii, at which even a soft contact must exert a force
SHALLOW = 1e-3  # overlap, in smaller radii, below which bodies have no elastic energy
OFTEN, RARELY = 20, 0.05  # number of impacts that show an engine's habit, and allowed fraction of exceptions
ALIKE, FEWEST = 0.5, 4  # smallest speed of compared impacts, relative to the impact, and least number that must agree
MOSTLY = 0.5  # fraction of an engine's impacts that take the usual number of steps
# Number of steps for which overlapping bodies may approach without an impulse. Box3D finds some pairs late: at most 4
# steps in 30 runs.
LONGEST = 6
STUCK = 20  # number of frames for which one body may contain another's centre; soft contacts of MuJoCo part within 16


@dataclass(slots=True)
class Unresolved:
    """An impact that the steps so far have not resolved."""

    step: int  # first step of the impact
    time: float  # s
    ends: tuple[int, int]
    speed: float  # m/s, closing speed
    excess: float  # ratio of the closing speed to the speed of slow contacts
    relative: FloatArray  # (3,) m/s, velocity of the second end relative to the first
    steps: int = 1  # steps in which the overlapping ends closed at unchanged speed
    pushed: bool = False  # whether another contact may have closed this one again
    passed: bool = False
    later: list[tuple[int, float]] = field(default_factory=list)  # steps, and times in s, of the later steps


def _usual(steps: FloatArray) -> int:
    """Return the number of steps that all but a few of an engine's impacts take."""
    usual = 0
    while np.count_nonzero(steps > usual) > max(RARELY * len(steps), 1.0):
        usual += 1
    return usual


@dataclass(slots=True)
class Inside:
    """A pair in which one end contains the other's centre."""

    step: int  # first step in which the centre is inside
    time: float  # s
    ends: tuple[int, int]
    frames: int
    depth: float  # overlap, in smaller radii


class MissedImpacts:
    """Follows each impact of one set of bodies from the frame where they meet to the frame that separates them."""

    def __init__(self, setup: Setup) -> None:
        self._setup = setup
        self._touched = np.zeros(len(setup) + len(setup.planes), bool)  # ends that touched in the previous frame
        self._open: dict[int, Unresolved] = {}
        self._inside: dict[int, Inside] = {}
        # speed of each impact in m/s, and the number of steps that it took
        self._resolved: list[tuple[float, int]] = []
        self._late: list[Unresolved] = []

    def see(
        self,
        place: tuple[int, float, float],  # step, time and length of the step in s
        near: Near,
        known: BoolArray,  # (k,) whether both ends are judged
        speeds: tuple[FloatArray, FloatArray],  # (k,) m/s, closing speeds in both frames
        still: float,  # m/s, speed of slow contacts
    ) -> Iterator[Unresolved]:
        """Yield the impacts that were certainly missed."""
        closing, after = speeds
        n, ends = len(self._setup), len(self._setup) + len(self._setup.planes)
        hits = known & (closing > still)
        unchanged = hits & (after > (1.0 - UNCHANGED) * closing)
        overlap = near.gap_now < -SHALLOW * near.small
        swept = (after < TUNNELLED * closing) & (near.gap_before <= closing * place[2])
        met = overlap | (near.gap_now <= 0.0) | swept
        # another body may have reversed the velocity of a pair that never touched
        fresh = hits & (near.gap_before > 0.0) & met
        through = near.passed_deep() & (near.gap_before >= -SHALLOW * near.small) & hits & (after > TUNNELLED * closing)
        plane = near.pairs[:, 1] >= n  # a contact with a plane may throw a body back from the other side
        beyond = np.einsum("ij,ij->i", near.now, near.directions_of_touch()) < 0.0
        through &= ~plane & (beyond | ~overlap)
        late = unchanged & overlap & (fresh | (near.gap_before < -FOUND * near.small))
        adjacent = near.pairs[np.minimum(near.gap_before, near.gap_now) <= MARGIN * near.small]
        others = np.bincount(adjacent.ravel(), minlength=ends) - 1
        others[n:] = 0
        # other contacts can push only bodies whose velocity changes, now or in the previous step: engines look for
        # pairs with the velocities at the start of a step
        change = (
            near.relative_now - near.relative_before + np.where(plane[:, None], self._setup.gravity * place[2], 0.0)
        )
        acted = lengths(change) > UNCHANGED * np.abs(closing)
        pushed = ((others[near.pairs] > 0).any(axis=1) & acted) | self._touched[near.pairs].any(axis=1)
        reached = np.minimum(near.gap_before - np.maximum(closing, 0.0) * place[2], near.gap_now) <= MARGIN * near.small
        self._touched = np.bincount(near.pairs[reached & hits & ~unchanged].ravel(), minlength=ends) > 0
        self._touched[n:] = False
        keys = near.pairs[:, 0] * ends + near.pairs[:, 1]
        rows = np.flatnonzero(fresh | late | through | np.isin(keys, list(self._open)))
        before, self._open = self._open, {}
        for row in rows.tolist():
            key = int(keys[row])
            impact = before.pop(key, None)
            if through[row]:
                yield self._begun(place[:2], near, row, closing, still, passed=True)
            elif impact is None and not late[row]:
                if not pushed[row]:
                    self._resolved.append((float(closing[row]), 0))
            elif impact is None:
                self._open[key] = self._begun(place[:2], near, row, closing, still)
                self._open[key].pushed = bool(pushed[row])
            elif unchanged[row] and overlap[row]:
                impact.steps += 1
                impact.later.append(place[:2])
                impact.pushed |= bool(pushed[row])
                self._open[key] = impact
                if impact.steps == LONGEST:
                    yield impact
            else:
                change = near.relative_now[row] - impact.relative
                gone = not plane[row] and impact.steps > 1 and bool(closing[row] <= still or not overlap[row])
                impact.passed = gone and float(np.sqrt(change @ change)) <= UNCHANGED * impact.speed
                if impact.passed and impact.steps < LONGEST:
                    yield impact
                self._resolve(impact)
        for impact in before.values():
            self._resolve(impact)

    def contained(self, place: tuple[int, float], near: Near, depth: FloatArray) -> Iterator[Inside]:
        """Yield the pairs in which one end has contained the other's centre for `STUCK` frames; depths are relative."""
        ends = len(self._setup) + len(self._setup.planes)
        before, self._inside = self._inside, {}
        for row in np.flatnonzero(depth > 1.0).tolist():
            i, j = (int(end) for end in near.pairs[row])
            found = before.get(i * ends + j) or Inside(*place, (i, j), 0, 0.0)
            found.frames += 1
            found.depth = max(found.depth, float(depth[row]))
            self._inside[i * ends + j] = found
            if found.frames == STUCK:
                yield found

    def unusual(self) -> Iterator[Unresolved]:
        """Yield the impacts that took more steps than usual; none if the engine has no usual number.

        Engines that find contacts within a margin resolve slow impacts earlier than fast impacts. An impact is
        therefore also compared with only those impacts that are not much slower.
        """
        speed, steps = np.array(self._resolved, dtype=np.float64).reshape(-1, 2).T
        for impact in self._late:
            fast = steps[speed >= ALIKE * impact.speed]
            if len(steps) >= OFTEN and not impact.pushed and self._rare(impact, steps) and self._rare(impact, fast):
                usual = min(_usual(steps), len(impact.later))
                if usual:  # index of the step in which this engine usually resolves an impact
                    impact.step, impact.time = impact.later[usual - 1]
                yield impact
        self._late = []

    @staticmethod
    def _rare(impact: Unresolved, steps: FloatArray) -> bool:
        """Return whether an impact took more steps than usual for the given impacts."""
        usual = _usual(steps)
        return impact.steps > usual and bool(np.count_nonzero(steps == usual) >= max(MOSTLY * len(steps), FEWEST))

    def go_on(self, earlier: MissedImpacts) -> None:
        """Take over the usual number of steps from an earlier set of bodies of the same engine."""
        self._resolved = earlier._resolved

    def _begun(
        self, place: tuple[int, float], near: Near, row: int, closing: FloatArray, still: float, *, passed: bool = False
    ) -> Unresolved:
        speed = float(closing[row])
        ends = int(near.pairs[row, 0]), int(near.pairs[row, 1])
        excess = speed / still if still > 0.0 else np.inf
        return Unresolved(*place, ends, speed, excess, near.relative_before[row], passed=passed)

    def _resolve(self, impact: Unresolved) -> None:
        if not impact.pushed:
            self._resolved.append((impact.speed, impact.steps))
        if impact.steps < LONGEST and not impact.passed:  # otherwise the impact was already reported
            self._late.append(impact)
