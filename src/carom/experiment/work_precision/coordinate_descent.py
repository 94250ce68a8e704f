"""The search for the cheapest setting of a scene that keeps limits on its errors: coordinate descent.

It begins at the best of about a dozen settings that differ from the scene in one key each, and changes one key after
the other, until no change is an improvement. A setting improves on another one if it keeps the limits and is cheaper,
or while none keeps them, if it is nearer to that.

After each change the step is doubled as long as that improves the setting, and halved until the limits are kept. So an
integrator of high order is judged with the long steps that it allows, not with those of another one.

What is found is the cheapest setting that was tried. Errors and costs need not be monotonic in a key, and no search
short of all combinations proves that none is cheaper.
"""

from __future__ import annotations

import math

from carom.experiment.work_precision.settings_grid import Point, default_points, knobs
from carom.experiment.work_precision.tradeoff import Result, Study, Teller
from carom.plan.auto import auto_interval

FRAMES_KEPT = 0.95  # of the frames that a recording of the scene has: a longer step is not worth a jerking picture
NEARER = 0.9  # of the factor by which limits are missed, that half the step has to come down to
DEAREST = 16.0  # times the cost of the scene: beyond it no step is halved
SHORTEST = 2.0**-6  # of the scene's step
BETWEEN = 1.5  # times the step, where twice the step is too long
CLOSE = 1.3  # times the cost of the cheapest: what is timed again before one of them is chosen


class Search:
    """A search in a study.

    Parameters
    ----------
    study
        Where settings are measured; what is measured in it already is not measured again.
    limits
        Of errors, by their names.
    """

    def __init__(self, study: Study, limits: dict[str, float], tell: Teller) -> None:
        self._study, self._limits, self._tell = study, limits, tell
        self._found: dict[Point, Result] = {}

    @property
    def results(self) -> list[Result]:
        """What was tried; the first is the scene as it is written."""
        return list(self._found.values())

    def run(self, repeats: int) -> None:
        """Search; then time the scene and what is about as cheap as the cheapest as often as asked for."""
        points = default_points(self._study.scene)
        results = self._study.measure([point.setting(self._study.scene) for point in points], 1, self._tell)
        self._found.update(zip(points, results, strict=True))
        if not unsure(self._study, self._limits) and math.isfinite(min(map(self._excess, points))):
            self._descend(min(points, key=self._rank))
        kept = [result for point, result in self._found.items() if not self._excess(point)]
        least = min((result.cost for result in kept), default=0.0)
        again = {result.setting: None for result in (results[0], *(r for r in kept if r.cost <= CLOSE * least))}
        self._study.measure(list(again), repeats, self._tell)

    def _descend(self, best: Point) -> None:
        best, before = self._along_step(best), None
        while best != before:
            before = best
            for key, values in knobs(self._study.scene).items():
                for value in (None, *values):
                    if value != best.value(key):
                        best = self._better(best, self._along_step(best.having(key, value), best))
            best = self._better(best, best.times(BETWEEN))

    def _along_step(self, here: Point, best: Point | None = None) -> Point:
        """Return the best step for the other coordinates of a point; shorter ones are not tried once they cost more."""
        if not self._excess(here):
            while self._better(here, here.times(2.0)) != here:
                here = here.times(2.0)
            return here
        while self._excess(here) and here.step > SHORTEST and not self._too_dear(here, best):
            shorter = here.times(0.5)
            if self._excess(shorter) > NEARER * self._excess(here):
                break
            here = shorter
        return here

    def _too_dear(self, point: Point, best: Point | None) -> bool:
        """Tell whether a point costs so much that it need not be tried with half the step."""
        if best is not None and not self._excess(best):
            return self._see(point).cost >= self._see(best).cost
        return self._see(point).cost >= DEAREST * self._see(Point()).cost

    def _better(self, one: Point, other: Point) -> Point:
        return other if self._rank(other) < self._rank(one) else one

    def _rank(self, point: Point) -> tuple[float, float]:
        """Return what is the smaller the better: by what factor limits are missed, and the cost in s."""
        excess = self._excess(point)
        return excess, self._see(point).cost if math.isfinite(excess) else math.inf

    def _excess(self, point: Point) -> float:
        """Return by what factor the worst limit is missed; 0 if all are kept, infinite if one cannot be judged."""
        return excess(self._study, self._see(Point()), self._see(point), self._limits)

    def _see(self, point: Point) -> Result:
        """Measure a point, unless it is measured; one run tells its errors, and one its cost."""
        if point not in self._found:
            kept = [result.cost for place, result in self._found.items() if not self._excess(place)]
            best = f"; the cheapest so far takes {min(kept):.3g} s" if kept else ""
            (self._found[point],) = self._study.measure(
                [point.setting(self._study.scene)],
                1,
                lambda text: self._tell(f"{len(self._found)} tried{best}; {text}"),
            )
        return self._found[point]


def excess(study: Study, written: Result, result: Result, limits: dict[str, float]) -> float:
    """Return by what factor a setting misses the worst of the limits and of the frames; 0 if it keeps all of them.

    It is infinite where one of them is not measured.
    """
    if not result.complete:
        return math.inf
    found = {name: getattr(result.errors, name) for name in limits}
    factors = [found[name] / limit if limit else 1.0 + found[name] for name, limit in limits.items()]
    missed = [factor for factor, name in zip(factors, limits, strict=True) if not found[name] <= limits[name]]
    if loses_frames(study, written, result):
        missed.append(written.frames / result.frames)  # a factor that half the step brings down
    return max((math.inf if math.isnan(factor) else factor for factor in missed), default=0.0)


def loses_frames(study: Study, written: Result, result: Result) -> bool:
    """Tell whether a recording has fewer frames than one of the scene as written.

    Where that records every step, it is enough to have as many as a recording that chooses its frames itself.
    """
    wanted = written.frames
    if study.scene.record.every == "step":
        wanted = min(wanted, round(study.scene.time.duration / auto_interval(study.scene)))
    return result.frames < FRAMES_KEPT * wanted


def unsure(study: Study, limits: dict[str, float]) -> list[str]:
    """Return the errors whose limits are below what the reference is uncertain by: nobody can tell who keeps them."""
    return [name for name, limit in limits.items() if name != "missed" and limit < study.floor(name)]
