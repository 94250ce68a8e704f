"""The growth of errors: distances between runs over time, extrapolated to shorter steps, and the divergence of twins.

The error with shorter steps follows from the distances between trial runs with successively shorter steps. No step of a
trial run is a multiple of the step of another trial run. If a ball stops sliding within a step of length h, after a
fraction f of the step, the error of the step is C h² f (1 - f). Halved steps would end where the longer steps end. If
such an event then coincided with the end of a step, f would be 0 in all trial runs, and they would agree on a wrong
result.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from carom.arrays import FloatArray
from carom.physics.vector import minimum_images
from carom.scene.load import Scene
from carom.scene.start import InitialBodies

# distance of the times of comparison from regular times, as a fraction of the time between two comparisons
GOLDEN = 0.3819660112501051
# Refinement of the first trial run (24 steps in a circular orbit), and ratio of the refinements of successive trial
# runs. When the first refinement was 1.06, a run with contacts that needs refinement 1 cost a tenth of its look-ahead.
COARSEST, RATIO = 0.25 * 1.0618, 1.4715
LONGEST = 1.0  # refinement of the longest useful steps
SAFETY = 3.5  # the step is chosen for an error that is smaller than the requested error by this factor
# Largest refinement relative to the finest trial run, which then costs an eighth of the run itself. The second value is
# for scenes in which nothing can touch, so that the order is known.
FARTHEST, FARTHEST_OF_SMOOTH = 8.0, 32.0
# Number of required comparisons: with contacts, one or two distances may be small by chance (see above). A distance of
# a fraction x of the accuracy occurs with a probability of about x. Fewer comparisons are enough if the product of
# these probabilities is below `CHANCE`.
TRIED, TRIED_OF_SMOOTH, CHANCE = 3, 2, 1e-3
LATEST = 4  # number of latest comparisons that are used
# a step is good enough if it keeps the accuracy for this fraction of the longest possible time, unless that time is
# the whole run
NEARLY = 0.95
FALLING = 0.82  # largest ratio of successive distances that counts as a reduction
APART = 1e-2  # distance of twins, relative to the size, above which they no longer diverge exponentially
EPS = float(np.finfo(np.float64).eps)
LEAST_POWER = 2.0  # smallest power of the time by which an error is expected to grow
UNSEEN = 3.0  # factor for errors beyond the times that trial runs reached
SMALLEST = 1e-300  # replaces an error of 0, which has no logarithm
MOST_GROWTH = 600.0  # largest growth of the logarithm of a distance, so that the distance stays finite


class Run(Protocol):
    """A trial run."""

    @property
    def times(self) -> FloatArray:
        """The times of comparison, (K,) s."""

    def at(self, sample: int) -> FloatArray | None:
        """Return the positions at one of the times, (n, 3) m; None if the run failed earlier."""


@dataclass(frozen=True, slots=True)
class Scale:
    """The size of a system, and the distances of its states relative to it."""

    size: float  # m
    box: FloatArray | None  # (3,) m, size of a periodic domain; None in open space

    @classmethod
    def of(cls, scene: Scene, start: InitialBodies) -> Scale:
        """Return the scale: half the box, or the bodies' rms distance from their centre.

        For a single body, the scale is its distance from the origin, or its radius if it is at the origin.
        """
        if scene.domain.period is not None:
            box = np.array(scene.domain.period)
            return cls(float(box.min()) / 2.0, box)
        apart = start.position - start.position.mean(axis=0)
        size = math.sqrt(float(np.mean(np.sum(apart * apart, axis=1))))
        return cls(size or math.sqrt(float(np.sum(start.position[0] ** 2))) or float(start.radius.max()), None)

    def distance(self, a: FloatArray, b: FloatArray) -> float:
        """Return the rms distance between positions, (n, 3) m, relative to the size."""
        d = a - b if self.box is None else minimum_images(a - b, self.box)
        return math.sqrt(float(np.mean(np.sum(d * d, axis=1)))) / self.size

    def apart(self, one: Run, other: Run, enough: float) -> FloatArray:
        """Compare two runs until their distance is ``enough``; return its running maximum over the size, (K,)."""
        apart = np.full(len(one.times), np.inf)
        largest = 0.0
        for k in range(len(apart)):
            a, b = one.at(k), other.at(k)
            if a is None or b is None:
                break
            apart[k] = largest = max(largest, self.distance(a, b))
            if not largest < enough:
                break
        return apart


def samples(end: float, count: int) -> FloatArray:
    """Return times up to ``end`` at which runs are compared, (count,) s."""
    return np.asarray(end * (np.arange(1, count + 1) / count))


def between_round_times(end: float, count: int) -> FloatArray:
    """Return times up to ``end`` at which steps of trial runs may end, (count,) s.

    An event within a step causes an error, an event at its end does not. Events are frequent at round fractions of the
    duration, so the times avoid such fractions.
    """
    times = end * ((np.arange(1, count + 1) - GOLDEN) / count)
    times[-1] = end
    return np.asarray(times)


def onward(times: FloatArray, values: FloatArray, later: FloatArray) -> FloatArray:
    """Return the factors by which an error, (K,) at all times (s), is expected to grow up to later times, (M,).

    An error grows like t^p e^(λ t), with p and λ from the last two doublings of the known time; p is at least 2, since
    errors of regular motion grow like t².
    """
    quarter, half, last = (
        max(float(np.interp(part * times[-1], times, values)), SMALLEST) for part in (0.25, 0.5, 1.0)
    )
    earlier, later_doubling = math.log(half / quarter), math.log(last / half)
    rate = max(4.0 * (later_doubling - earlier), 0.0)  # λ times the known time
    power = max((later_doubling - 0.5 * rate) / math.log(2.0), LEAST_POWER)
    ratio = later / times[-1]
    return np.asarray(UNSEEN * ratio**power * np.exp(np.minimum(rate * (ratio - 1.0), MOST_GROWTH)))


def with_start(values: FloatArray, start: float) -> FloatArray:
    """Return the values with the value at time 0 prepended."""
    return np.concatenate(([start], values))


def kept_until(times: FloatArray, error: FloatArray, accuracy: float) -> float:
    """Return the time (s) at which the error exceeds the accuracy; the last time if it does not."""
    over = np.flatnonzero(~(error <= accuracy))
    if not len(over):
        return float(times[-1])
    k = int(over[0])
    if k == 0:
        return 0.0
    low, high = error[k - 1], error[k]
    share = 0.0
    if math.isfinite(high) and low > 0.0:
        share = math.log(accuracy / low) / math.log(high / low)
    return float(times[k - 1] + share * (times[k] - times[k - 1]))


def extrapolate(
    times: FloatArray,
    apart: list[FloatArray],
    finest: float,
    highest: int,
    accuracy: float,
    farthest: float = FARTHEST,
) -> tuple[float, float, FloatArray]:
    """Return a refinement, the time (s) for which it keeps the accuracy, and its error.

    The refinement is a power of two, so that steps and frames end together. It is at least 1 and at least the
    refinement of the last trial run but one, and at most ``farthest`` times the last refinement, ``finest``. The
    distances of each trial run from the next, ``apart``, are (K,) relative to the size. The coefficient of h^p depends
    on where impacts happen within their steps. Therefore the largest of the latest distances is used, after each has
    been scaled according to the order, which is at most ``highest``.
    """
    order = _observed(apart, highest)
    scaled = [each / RATIO ** (order * age) for age, each in enumerate(apart[: -LATEST - 1 : -1])]
    with np.errstate(invalid="ignore"):
        error = np.max(scaled, axis=0) / (RATIO**order - 1.0)  # error of the latest run
    lowest, highest_power = math.ceil(math.log2(finest / RATIO)), math.floor(math.log2(farthest * finest))
    tried = [max(2.0**power, LONGEST) for power in range(min(lowest, highest_power), highest_power + 1)]
    errors = [error * (finest / each) ** order for each in tried]
    kept = [kept_until(times, SAFETY * each, accuracy) for each in errors]
    longest = max(kept)
    enough = longest if longest >= times[-1] else NEARLY * longest
    k = next(k for k, until in enumerate(kept) if until >= enough)
    return tried[k], kept[k], errors[k]


def by_chance(apart: list[FloatArray], accuracy: float) -> float:
    """Return the probability that all distances at the end are small by chance, (K,) each, relative to the size."""
    return math.prod(min(float(each[-1]) / accuracy, 1.0) for each in apart)


def largest_useful(order: int, accuracy: float, farthest: float) -> float:
    """Return the distance of trial runs, relative to the size, above which no later run can keep the accuracy."""
    return min(accuracy * (RATIO**order - 1.0) * (farthest * RATIO**LATEST) ** order / SAFETY, 1.0)


def stays(times: FloatArray, apart: list[FloatArray], kept: float) -> bool:
    """Return whether shorter steps hardly reduced the distance at the time when the accuracy is lost."""
    k = min(int(np.searchsorted(times, kept, side="right")), len(times) - 1)
    return len(apart) > 1 and bool(FALLING * apart[-2][k] < apart[-1][k] < APART)


def _observed(apart: list[FloatArray], order: int) -> float:
    """Return the observed order, from 1 to the integrator's order, at the last time at which distances are usable."""
    age = min(LATEST, len(apart)) - 1
    coarse, fine = apart[-1 - age], apart[-1]
    usable = np.flatnonzero((coarse < APART) & (coarse > 0.0) & (fine > 0.0) & np.isfinite(fine))
    if age == 0 or not len(usable):
        return 1.0
    k = int(usable[-1])
    return min(max(math.log(coarse[k] / fine[k]) / (age * math.log(RATIO)), 1.0), float(order))


@dataclass(frozen=True, slots=True)
class Twins:
    """The divergence of two runs with almost equal initial states."""

    apart: FloatArray  # (K,) largest distance of the runs so far, relative to the size
    exponent: float  # 1/s

    @classmethod
    def grown(cls, times: FloatArray, apart: FloatArray, began: float, known: int) -> Twins:
        """Extrapolate the twins' distance, (K,) relative to the size, to times at which it is no longer small.

        From sample ``known`` on, the distance is unknown, and set to infinity.
        """
        if known < len(apart):
            if not known:
                return cls(np.full(len(apart), np.inf), 0.0)
            part = cls.grown(times[:known], apart[:known], began, known)
            return cls(np.concatenate((part.apart, np.full(len(apart) - known, np.inf))), part.exponent)
        apart = np.maximum(apart, began)
        over = np.flatnonzero(~(apart < APART))
        last = int(over[0]) if len(over) else len(apart) - 1  # after this sample, the same rate is assumed
        apart[last] = min(apart[last], 1.0)
        exponent = math.log(apart[last] / began) / float(times[last])
        growth = np.minimum(max(exponent, 0.0) * (times[last + 1 :] - times[last]), MOST_GROWTH)
        apart[last + 1 :] = apart[last] * np.exp(growth)
        return cls(apart, exponent)

    def steps_that_count(self, began: float, steps: int) -> FloatArray:
        """Return the accumulated error at all times, (K,), in units of the error that the first step causes by then.

        An error made in a step grows like the distance G of twins, so the result is ∫ G(t - s) ds / G(t), divided by
        the length of a step. For regular motion, this is half the number of steps so far; for chaotic motion, it is the
        number of steps in the last 1 / λ.
        """
        before = with_start(self.apart[:-1], began)
        growth = np.log(self.apart / before)
        mean = np.where(growth > 0.0, (self.apart - before) / np.where(growth > 0.0, growth, 1.0), before)
        return np.asarray(np.cumsum(mean) / self.apart * (steps / len(mean)))

    def continued(self, times: FloatArray, error: FloatArray, known: FloatArray) -> FloatArray:
        """Interpolate an accumulated error, (K,) at all times (s), and continue it where it is infinite.

        The error grows like t times the distance of twins; in regular motion, this distance grows like t.
        """
        finite = np.isfinite(error)
        if not finite.any():
            return np.ones(len(times))
        share = error[finite] / (known[finite] * np.interp(known[finite], times, self.apart))
        return np.asarray(times * self.apart * np.interp(times, known[finite], share))

    def at(self, times: FloatArray, known: FloatArray, began: float) -> Twins:
        """Interpolate to other times (s); between known times, the distance grows exponentially."""
        grown = np.log(np.maximum(with_start(self.apart, began), EPS**2))
        return Twins(np.exp(np.interp(times, with_start(known, 0.0), grown)), self.exponent)


def displaced(start: InitialBodies, distance: float) -> InitialBodies:
    """Return initial states with free bodies displaced by an rms distance (m), at least by their last bits."""
    direction = 2.0 * np.random.default_rng(0).random(start.position.shape) - 1.0  # displacements of rms length 1
    moved = start.position + distance * direction
    unmoved = np.nextafter(start.position, np.copysign(np.inf, direction))
    moved = np.where(moved == start.position, unmoved, moved)
    return replace(start, position=np.where(start.fixed[:, np.newaxis], start.position, moved))
