"""The search for the cheapest setting of a scene that keeps limits on its errors: coordinate descent.

The search begins at the best of about a dozen settings that differ from the scene in one key each. It changes one key
after the other until no change is an improvement. A setting is an improvement if it keeps the limits and is cheaper,
or, while no setting keeps them, if it is nearer to keeping them.

After each change the step is doubled as long as that is an improvement, and halved until the limits are kept. An
integrator of high order is thus judged with the long steps that it allows.

The result is the cheapest setting that was tried. Errors and costs need not be monotonic in a key, so only a search of
all combinations would prove that none is cheaper.
"""

from __future__ import annotations

import math

from carom.lab.tradeoff.result import Result
from carom.lab.tradeoff.settings_grid import Point, default_points, knobs
from carom.lab.tradeoff.tradeoff import Study, Teller
from carom.plan.auto import auto_interval, integrator
from carom.plan.features import require

FRAMES_KEPT = 0.95  # of the frames in a recording of the scene; a longer step would make it jerky
NEARER = 0.9  # half the step must reduce the factor by which limits are missed to this fraction
DEAREST = 16.0  # times the cost of the scene; at a higher cost no step is halved
HOPELESS = 2.0  # times the cost of a rival, that a setting would have which keeps the limits; costs are uncertain
SHORTEST = 2.0**-6  # of the scene's step
BETWEEN = 1.5  # times the step, where twice the step is too long
CLOSE = 1.3  # times the lowest cost; settings up to this cost are timed again before one is chosen


class Search:
    """A search in a study.

    Parameters
    ----------
    study
        The study that measures settings; existing measurements are reused.
    limits
        Of errors, by their names.
    """

    def __init__(self, study: Study, limits: dict[str, float], tell: Teller) -> None:
        self._study, self._limits, self._tell = study, limits, tell
        self._found: dict[Point, Result] = {}

    @property
    def results(self) -> list[Result]:
        """The settings that were tried; the first is the scene as written."""
        return list(self._found.values())

    def run(self, repeats: int) -> None:
        """Search; then time the scene and the settings near the lowest cost as often as requested."""
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
        """Return the best step for the other coordinates of a point; stops at shorter steps that cost more."""
        if not self._excess(here):
            while self._better(here, here.times(2.0)) != here:
                here = here.times(2.0)
            return here
        while self._excess(here) and here.step > SHORTEST and not self._cannot_win(here, best):
            shorter = here.times(0.5)
            if self._excess(shorter) > NEARER * self._excess(here):
                break
            here = shorter
        return here

    def _too_dear(self, point: Point, best: Point | None) -> bool:
        """Tell whether a point is too expensive to be tried with half the step."""
        if best is not None and not self._excess(best):
            return self._see(point).cost >= self._see(best).cost
        return self._see(point).cost >= DEAREST * self._see(Point()).cost

    def _cannot_win(self, point: Point, best: Point | None) -> bool:
        """Tell whether a point is too expensive, now or once its steps are short enough to keep the limits.

        Half the step costs twice as much, and errors of smooth motion fall by the order of the integrator at most.
        """
        if self._too_dear(point, best):
            return True
        settled_scene = point.setting(self._study.scene).apply(self._study.scene)
        chosen = integrator(settled_scene)
        if chosen.controls_error or require(settled_scene).contact.modelled or not math.isfinite(self._excess(point)):
            return False
        cost = self._see(point).cost * math.pow(self._excess(point), 1.0 / chosen.order)
        if best is not None and not self._excess(best):
            return cost >= HOPELESS * self._see(best).cost
        return cost >= HOPELESS * DEAREST * self._see(Point()).cost

    def _better(self, one: Point, other: Point) -> Point:
        return other if self._rank(other) < self._rank(one) else one

    def _rank(self, point: Point) -> tuple[float, float]:
        """Return the sort key of a point: the factor by which limits are missed, then the cost in s."""
        excess = self._excess(point)
        return excess, self._see(point).cost if math.isfinite(excess) else math.inf

    def _excess(self, point: Point) -> float:
        """Return the factor by which the worst limit is missed; 0 if all are kept, infinite if one cannot be judged."""
        return excess(self._study, self._see(Point()), self._see(point), self._limits)

    def _see(self, point: Point) -> Result:
        """Measure a point that is not measured yet, with one run for its errors and one for its cost."""
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
    """Return the factor by which a setting misses the worst limit, the number of frames included.

    It is 0 if all are kept, and infinite if one of them is not measured.
    """
    if not result.complete:
        return math.inf
    found = {name: getattr(result.errors, name) for name in limits}
    factors = [found[name] / limit if limit else 1.0 + found[name] for name, limit in limits.items()]
    missed = [factor for factor, name in zip(factors, limits, strict=True) if not found[name] <= limits[name]]
    if loses_frames(study, written, result):
        missed.append(written.frames / result.frames)  # half the step reduces this factor
    return max((math.inf if math.isnan(factor) else factor for factor in missed), default=0.0)


def loses_frames(study: Study, written: Result, result: Result) -> bool:
    """Tell whether a recording has fewer frames than one of the scene as written.

    If the scene records every step, the number of frames of an automatic recording is enough.
    """
    wanted = written.frames
    if study.scene.record.every == "step":
        duration = study.scene.time.duration
        wanted = min(wanted, round(duration / auto_interval(study.scene, duration)))
    return result.frames < FRAMES_KEPT * wanted


def unsure(study: Study, limits: dict[str, float]) -> list[str]:
    """Return the errors whose limits are below the uncertainty of the reference and so cannot be checked."""
    return [name for name, limit in limits.items() if name != "missed" and limit < study.floor(name)]
