"""The coefficients of restitution of isolated impacts, compared over a whole run with similar impacts.

Where two ends touch nothing else, the velocities of both ends before and after an impact give the coefficient of this
impact. At the end of a run, it is known which coefficient this engine has at each speed. An impact of the same
materials and a similar speed with another coefficient breaks the law.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from carom.engines.engine_contacts import EngineMoment, lengths
from carom.engines.faults import MOSTLY, RESTITUTION, SPREADS, Broken, BrokenThen
from carom.engines.source import Setup

ALIKE = 9  # impacts at neighbouring speeds that give the expected coefficient of restitution
FEWEST = 3  # smallest number of impacts between the same materials
# Fraction of an impact's speed below which other impacts are slower. Engines stop rebounds below a speed that states
# show only roughly.
SLOWER = 0.75
# Smallest deviation of a coefficient of restitution. The coefficients of soft contacts vary by 0.07 with the phase.
OFF = 0.1
OVER = 0.05  # change of velocity in the next frame, over the impact's speed, that shows a lasting contact
RIGID, RARELY = 10, 0.1  # smallest number of impacts that shows rigid contacts, and fraction that may outlast a frame
MOST_SAMPLES = 100_000  # impacts kept for comparison


@dataclass(frozen=True, slots=True)
class IsolatedImpact:
    """An impact of two ends that touched nothing else, from the frame before it to the frame after it."""

    step: int
    time: float  # s
    ends: tuple[int, int]
    speed: float  # m/s, closing speed
    restitution: float
    uncertainty: float  # uncertainty of the coefficient

    def differs(self, usual: float) -> float:
        """Return the difference of the coefficient from the usual coefficient, beyond its uncertainty."""
        return abs(self.restitution - usual) - self.uncertainty

    def unlike(self, usual: float, allowed: float, source: str) -> Broken:
        """Return the broken law, which expects another coefficient of restitution."""
        what = f"rebound with a coefficient of restitution of {self.restitution:.3g}; {source} {usual:.3g}"
        return Broken(RESTITUTION, self.differs(usual) / allowed, self.ends, what)


class Rebounds:
    """The isolated impacts of a run, of one set of bodies."""

    def __init__(self, setup: Setup, allowed: float) -> None:
        self._setup = setup
        self._allowed = allowed  # error of a coefficient of restitution
        self._pending: list[IsolatedImpact] = []  # impacts of the last frame; a soft contact continues in the next one
        self.impacts: list[IsolatedImpact] = []
        self._lasting = 0  # number of impacts that continued in the next frame
        self._counts: list[tuple[int, int, int]] = []  # step, impacts that had ended by then, and impacts that lasted
        self.suspected: list[BrokenThen] = []  # laws broken if contacts are not soft

    def note(self, impact: IsolatedImpact) -> Iterator[Broken]:
        """Compare an isolated impact with the model, once the next frame has shown that the impact was over."""
        self._pending.append(impact)
        known = self._setup.restitution
        if known is not None and impact.differs(known) > self._allowed:
            yield impact.unlike(known, self._allowed, "the model says")

    def settle(self, step: int, before: EngineMoment, now: EngineMoment, dt: float) -> None:
        """Keep the impacts of the previous frame that were over by then."""
        n, field = len(self._setup), self._setup.gravity * dt
        for impact in self._pending:
            bodies = [end for end in impact.ends if end < n and not self._setup.fixed[end]]
            mass = self._setup.mass[bodies]
            # a contact between both bodies changes both, so the smaller change limits its impulse
            impulse = float((mass * lengths(now.velocity[bodies] - before.velocity[bodies] - field)).min())
            if impulse * float((1.0 / mass).sum()) > OVER * impact.speed:
                self._lasting += 1
            elif len(self.impacts) < MOST_SAMPLES:
                self.impacts.append(impact)
        if self._pending:
            self._counts.append((step, len(self.impacts), self._lasting))
        self._pending = []

    def concluded(self) -> Iterator[BrokenThen]:
        """Yield the broken laws, judged by all impacts of the run."""
        for step, time, broken in self.suspected:
            if self._is_rigid(step):  # overlaps in this engine store no energy
                yield step, time, broken
        for impact, broken in self._outliers():
            yield impact.step, impact.time, broken
        self.suspected, self.impacts = [], []

    def _is_rigid(self, step: int) -> bool:
        """Return whether impacts last at most one frame, judged by the impacts up to a step or until there were enough.

        Later impacts do not count: a fault may let a pile sink, whose contacts then last in any engine.
        """
        later = self._counts[bisect_left(self._counts, (step, 0, 0)) :] or self._counts[-1:]
        over, lasting = next(((over, lasting) for _, over, lasting in later if over >= RIGID), (0, 0))
        return over >= RIGID and lasting <= RARELY * (over + lasting)

    def _outliers(self) -> Iterator[tuple[IsolatedImpact, Broken]]:
        """Yield the impacts whose coefficients of restitution differ from those of similar impacts.

        A faulty coefficient differs from the coefficients of the next slower and the next faster impacts, since
        coefficients may depend on the speed.
        """
        groups: dict[int, list[IsolatedImpact]] = {}
        for impact in self.impacts:
            groups.setdefault(max(impact.ends[1] - len(self._setup), -1), []).append(impact)  # plane, or -1 for bodies
        compared: list[tuple[IsolatedImpact, list[float]]] = []  # impacts with the usual coefficients
        for group in groups.values():
            group.sort(key=lambda impact: impact.speed)
            e = np.array([impact.restitution for impact in group])
            for k, impact in enumerate(group):
                slower, faster = e[max(k - ALIKE, 0) : k], e[k + 1 : k + 1 + ALIKE]
                slowest = sum(other.speed < SLOWER * impact.speed for other in group[:k])
                if impact.restitution < float(np.median(e)) and slowest < FEWEST:
                    continue
                sides = [float(np.median(side)) for side in (slower, faster) if len(side) >= FEWEST]
                if sides:
                    compared.append((impact, [*sides, float(np.median(e))]))
        if not compared:
            return
        off = [min(abs(impact.restitution - usual) for usual in usuals) for impact, usuals in compared]
        allowed = max(OFF, SPREADS * float(np.quantile(off, MOSTLY)))
        for impact, usuals in compared:
            usual = min(usuals, key=impact.differs)
            if impact.differs(usual) > allowed:
                yield impact, impact.unlike(usual, allowed, "other impacts of this speed have")
