"""The cheapest setting of a scene whose measured errors keep given limits, by coordinate descent or from a list.

The search begins at the best of about a dozen settings, which differ from the scene in one key each. The search changes
one key after the other until no change is an improvement. A setting is an improvement if it keeps the limits and is
cheaper. As long as no setting keeps the limits, a setting nearer to the limits is an improvement. After each change,
the step is doubled as long as doubling is an improvement, and halved until the limits are kept. An integrator of high
order is thus judged with the long steps that it allows. The result is the cheapest setting that was tried. Errors and
costs need not be monotonic in a key, so only a search of all combinations could prove that no setting is cheaper.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import tomlkit

from carom.errors import ExperimentError, SceneError
from carom.lab.compared_run import AS_WRITTEN, Setting
from carom.lab.tradeoff.budget import ALONE
from carom.lab.tradeoff.reference import COMPARED, MEASURES, NAMES, OF_SAMPLES, OVER_TIME, Teller, phrase
from carom.lab.tradeoff.settings_grid import GridPoint, SettingResult, default_points, knobs
from carom.lab.tradeoff.study_document import result_entry
from carom.lab.tradeoff.tradeoff import Study
from carom.plan import auto
from carom.plan.features import require
from carom.recording.write.whole_file import write_whole
from carom.scene.load import Scene
from carom.scene.units.dimension import TIME
from carom.scene.wording import suggestion
from carom.terminal.printing import finite

FRAMES_KEPT = 0.95  # smallest fraction of the scene's frames with which recorded motion is still smooth
NEARER = 0.9  # if half the step leaves more than this fraction of the excess, no shorter step is tried
# a setting whose cost is at least this multiple of the scene's cost does not get its step halved
DEAREST = 16.0
# a setting whose cost is at least this multiple of a rival's cost cannot win, even though costs are uncertain
HOPELESS = 2.0
SHORTEST = 2.0**-6  # shortest step, relative to the scene's step
BETWEEN = 1.5  # factor on the step that is tried if a factor of two is too large
FOR_CANDIDATES = 0.25  # fraction of the budget that is kept for the last timings
CLOSE = 1.3  # settings up to this cost, relative to the lowest, are timed again before one is chosen


class SettingSearch:
    """A search among the settings of a study; existing measurements are used again."""

    def __init__(self, study: Study, limits: dict[str, float], tell: Teller) -> None:
        self._study, self._limits, self._tell = study, limits, tell
        self._found: dict[GridPoint, SettingResult] = {}

    def run(self, repeats: int | None) -> list[SettingResult]:
        """Search; then time the scene, and settings near the lowest cost, as often as requested.

        Returns the settings that were tried; the first is the scene as written.
        """
        points, budget = default_points(self._study.scene), self._study.budget
        budget.reserve += FOR_CANDIDATES
        results = self._study.measure([point.setting(self._study.scene) for point in points], 1, self._tell)
        self._found.update(zip(points, results, strict=True))
        if not unsure(self._study, self._limits) and math.isfinite(min(map(self._excess, points))):
            best = min(points, key=self._rank)
            best, before = self._along_step(best), None
            while best != before:
                before = best
                for key, values in knobs(self._study.scene).items():
                    for value in (None, *values):
                        if value != best.value(key):
                            best = self._better(best, self._along_step(best.having(key, value), best))
                best = self._better(best, best.times(BETWEEN))
        budget.reserve -= FOR_CANDIDATES
        kept = [result for point, result in self._found.items() if not self._excess(point)]
        least = min((result.cost for result in kept), default=0.0)
        again = {result.setting: None for result in (results[0], *(r for r in kept if r.cost <= CLOSE * least))}
        self._study.measure(list(again), repeats, self._tell)
        return [result for result in self._found.values() if result.status != "left out"]

    def _along_step(self, here: GridPoint, best: GridPoint | None = None) -> GridPoint:
        """Return the point with the best step; the search ends when shorter steps only cost more."""
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

    def _cannot_win(self, point: GridPoint, best: GridPoint | None) -> bool:
        """Return whether a point is too expensive, now or with steps short enough to keep the limits.

        Half the step costs twice as much, and reduces errors by at most 2^p at the integrator's order p.
        """
        limit = DEAREST * self._see(GridPoint()).cost
        if best is not None and not self._excess(best):
            limit = self._see(best).cost
        if self._see(point).cost >= limit:
            return True
        settled_scene = point.setting(self._study.scene).apply(self._study.scene)
        chosen = auto.integrator(settled_scene)
        if chosen.controls_error or require(settled_scene).contact.modelled or not math.isfinite(self._excess(point)):
            return False
        return self._see(point).cost * math.pow(self._excess(point), 1.0 / chosen.order) >= HOPELESS * limit

    def _better(self, one: GridPoint, other: GridPoint) -> GridPoint:
        return other if self._rank(other) < self._rank(one) else one

    def _rank(self, point: GridPoint) -> tuple[float, float]:
        """Return the sort key of a point: the factor by which limits are missed, then the cost (s)."""
        excess = self._excess(point)
        return excess, self._see(point).cost if math.isfinite(excess) else math.inf

    def _excess(self, point: GridPoint) -> float:
        """Return the factor by which the worst limit is missed; 0 if all are kept, infinite if one is not known."""
        return excess(self._study, self._see(GridPoint()), self._see(point), self._limits)

    def _see(self, point: GridPoint) -> SettingResult:
        """Measure a point that is not measured yet, with one run for its errors and one run for its cost."""
        if point not in self._found:
            kept = [result.cost for place, result in self._found.items() if not self._excess(place)]
            best = f"; the cheapest so far takes {min(kept):.3g} s" if kept else ""
            (self._found[point],) = self._study.measure(
                [point.setting(self._study.scene)],
                1,
                lambda text: self._tell(f"{len(self._found)} tried{best}; {text}"),
            )
        return self._found[point]


def excess(study: Study, written: SettingResult, result: SettingResult, limits: dict[str, float]) -> float:
    """Return the factor by which a setting misses the worst limit; the number of frames is also a limit.

    The factor is 0 if all limits are kept, and infinite if one error is not measured.
    """
    if not result.complete:
        return math.inf
    found = {name: getattr(result.errors, name) for name in limits}
    factors = [found[name] / limit if limit else 1.0 + found[name] for name, limit in limits.items()]
    missed = [factor for factor, name in zip(factors, limits, strict=True) if not found[name] <= limits[name]]
    if loses_frames(study, written, result):
        missed.append(written.frames / result.frames)  # with half the step, fewer frames are missing
    return max((math.inf if math.isnan(factor) else factor for factor in missed), default=0.0)


def loses_frames(study: Study, written: SettingResult, result: SettingResult) -> bool:
    """Return whether a recording has fewer frames than the recording of the scene as written.

    If the scene records every step, a setting needs only as many frames as an automatic recording.
    """
    wanted = written.frames
    if study.scene.record.every == "step":
        duration = study.scene.time.duration
        wanted = min(wanted, round(duration / auto.auto_interval(study.scene, duration)))
    return result.frames < FRAMES_KEPT * wanted


def unsure(study: Study, limits: dict[str, float]) -> list[str]:
    """Return the errors whose limits are below the uncertainty of the reference and so cannot be checked."""
    return [name for name, limit in limits.items() if name != "missed" and limit < study.floor(name)]


WORSE = 1.1  # smallest reported increase of an error, relative to the scene as written


@dataclass(frozen=True, slots=True)
class Tuning:
    """The settings that were tried for given limits, and the cheapest setting that keeps the limits."""

    study: Study
    limits: dict[str, float]
    written: SettingResult  # the scene as written
    tried: tuple[SettingResult, ...]  # all tried settings, the scene as written among them

    @property
    def best(self) -> SettingResult | None:
        """The cheapest setting measured to keep every limit and the scene's frames; None if there is none.

        If the scene as written also keeps them, and no other setting is certainly faster, the scene is the best
        setting. An error that is not measured, such as a position error beyond the horizon, keeps no limit. A limit
        below the uncertainty of the reference is not kept either, because it cannot be checked.
        """
        if unsure(self.study, self.limits):
            return None
        kept = [result for result in self.tried if not self._excess(result)]
        best = min(kept, key=lambda result: result.cost, default=None)
        if best is None or self.written not in kept or self._gain(best)[0] > 1.0:
            return best
        return self.written

    @property
    def speed(self) -> float:
        """The best setting's speed relative to the scene as written; NaN if one of them has no cost."""
        return math.nan if self.best is None else self.written.cost / self.best.cost

    @property
    def speed_range(self) -> tuple[float, float]:
        """The range of `speed` that the uncertainties of both costs allow; NaN without costs."""
        return (math.nan, math.nan) if self.best is None else self._gain(self.best)

    @property
    def claim(self) -> str:
        """The certain gain in speed of the best setting over the scene as written; empty if these are the same."""
        low, high = self.speed_range
        if self.best is self.written or math.isnan(low):
            return ""
        if low > 1.0:
            return f"{self.speed:.2g} times as fast as the original scene ({low:.2g} to {high:.2g})"
        if high < 1.0:
            return f"{1.0 / self.speed:.2g} times as slow as the original scene ({1.0 / high:.2g} to {1.0 / low:.2g})"
        return "as fast as the original scene within the noise"

    def _gain(self, result: SettingResult) -> tuple[float, float]:
        """Return the least and the largest speed of a setting, relative to the scene as written."""
        doubt = 1.0
        for each in (result, self.written):
            doubt *= 1.0 + (self.study.doubt(each) if len(each.costs) > 1 else ALONE)
        speed = self.written.cost / result.cost
        return speed / doubt, speed * doubt

    def misses(self, result: SettingResult) -> list[str]:
        """Name the limits that a setting misses."""
        errors = {name: getattr(result.errors, name, math.nan) for name in self.limits}
        missed = [
            f"{phrase(name)} not measured"
            if math.isnan(found)
            else f"{phrase(name)} {found:.2g} > {self.limits[name]:.2g}"
            for name, found in errors.items()
            if not found <= self.limits[name]
        ]
        if loses_frames(self.study, self.written, result):
            missed.append(f"{result.frames} frames of {self.written.frames}")
        return missed

    def kept(self, result: SettingResult) -> list[str]:
        """Describe the errors of a setting, each with its limit."""
        errors = {name: getattr(result.errors, name) for name in self.limits}
        return [f"{phrase(name)} {error:.2g} (limit {self.limits[name]:.2g})" for name, error in errors.items()]

    @property
    def passed_over(self) -> SettingResult | None:
        """The cheapest setting that keeps every limit and is cheaper than the best, but loses frames; None if none."""
        if self.best is None:
            return None
        cheaper = [
            result
            for result in self.tried
            if result.cost < self.best.cost
            and loses_frames(self.study, self.written, result)
            and len(self.misses(result)) == 1
        ]
        return min(cheaper, key=lambda result: result.cost, default=None)

    def worse(self) -> dict[str, tuple[float, float]]:
        """Return the errors that the best setting increases: both values, by name."""
        if self.best is None or self.best.errors is None or self.written.errors is None:
            return {}
        before, after = asdict(self.written.errors), asdict(self.best.errors)
        return {
            name: (before[name], after[name])
            for name in NAMES
            if (name in self.limits or name in OVER_TIME or name not in OF_SAMPLES)
            and after[name] > max(WORSE * before[name], self.study.floor(name))
        }

    def why_none(self) -> str:
        """Explain why no setting keeps the limits, by the setting with the smallest excess."""
        for name in unsure(self.study, self.limits):
            floor = self.study.floor(name)
            return f"{phrase(name)} below {floor:.2g} is within rounding or the uncertainty of the reference"
        done = [result for result in self.tried if result.complete]
        if not done:
            return "no setting could be measured"
        best = min(done, key=self._excess)
        return f"the nearest is {best.setting.name}: {', '.join(self.misses(best))}"

    def document(self) -> dict[str, Any]:
        """Return the result as a JSON document."""
        best = self.best
        return _asked(self.study, self.limits) | {
            "tried": len(self.tried),
            "best": best and result_entry(best),
            "as_written": result_entry(self.written),
            "speed": finite(self.speed),
            "speed_range": finite(list(self.speed_range)),
            "budget": self.study.document()["budget"],
            "left_out": self.study.left_out,
            "worse": {name: list(values) for name, values in self.worse().items()},
            "why_none": None if best else self.why_none(),
        }

    def _excess(self, result: SettingResult) -> float:
        return excess(self.study, self.written, result, self.limits)


def stopped(study: Study, limits: Mapping[str, float]) -> dict[str, Any]:
    """Return the JSON document of a search that the user ended before it had a result."""
    return _asked(study, limits) | {"tried": len(study.results), "best": None, "why_none": "stopped by the user"}


def _asked(study: Study, limits: Mapping[str, float]) -> dict[str, Any]:
    """Return the limits of the search, and the path of its measurements."""
    return {
        "units": study.scene.unit_system.recorded,
        "scene": {"title": study.scene.title, "bodies": study.scene.count},
        "limits": dict(limits),
        "study": str(study.folder),
    }


def tuned(
    study: Study, limits: dict[str, float], repeats: int | None, tell: Teller, settings: list[Setting] | None = None
) -> Tuning:
    """Search a study for the cheapest setting that keeps limits, or choose it from given settings.

    Raises ExperimentError if a limit cannot be measured in this scene.
    """
    begin = [point.setting(study.scene) for point in default_points(study.scene)] if settings is None else settings
    reference, units = study.prepare([AS_WRITTEN, *begin], tell), study.scene.unit_system
    compared = [name for name in limits if name in COMPARED]
    if compared and not reference.whole:
        until, end = units.text(reference.horizon, TIME), units.text(study.scene.time.duration, TIME)
        alone = ", ".join(name for name in NAMES if name not in COMPARED)
        raise ExperimentError(
            f"--error {compared[0]}: cannot be measured after t = {until} of {end}, where the reference ends: "
            f'{reference.text}. Shorten the scene, as with --set "time.duration={until}", or limit an error that needs '
            f"no reference: {alone}"
        )
    at_end = [name for name in limits if name.endswith(MEASURES["end"])]
    if at_end and not reference.is_complete:
        until, end = units.text(reference.horizon, TIME), units.text(study.scene.time.duration, TIME)
        raise ExperimentError(
            f"--error {at_end[0].removesuffix(MEASURES['end'])}=…:end: the reference is certain only up to t = {until} "
            f"of {end}; limit the rms or the largest error until then (:rms, :max), or shorten the scene with --set "
            f'"time.duration={until}"'
        )
    (written,) = study.measure([AS_WRITTEN], 0, tell)
    for name in limits if written.errors else ():  # an error may be impossible, such as an overlap if nothing can touch
        if math.isnan(getattr(written.errors, name)):
            own = [each for each in NAMES if each in OVER_TIME or each not in OF_SAMPLES]
            known = ", ".join(each for each in own if not math.isnan(getattr(written.errors, each)))
            raise ExperimentError(f"--error {name}: this scene has no such error; it has {known}")
    if settings is None:
        tried = SettingSearch(study, limits, tell).run(repeats)
    else:
        tried = study.measure([AS_WRITTEN, *settings], repeats, tell)
    distinct = {(result.setting.overrides, result.setting.threads): result for result in tried}
    return Tuning(study, limits, tried[0], tuple(distinct.values()))


def limits(asked: list[str]) -> dict[str, float]:
    """Read limits as given to ``--error``, such as ``energy=1e-4`` or ``position=1e-5:end``.

    Raises SceneError if there are none, or one does not limit a measured error.
    """
    named = [name for name in NAMES if name in OVER_TIME or name not in OF_SAMPLES]
    if not asked:
        raise SceneError(f"name an error and its limit, such as --error position=1e-3; {suggestion('', named)}")
    found = {}
    for text in asked:
        name, separator, value = (part.strip() for part in text.partition("="))
        if name not in named:
            raise SceneError(f"--error {text}: no error of that name; {suggestion(name, named)}")
        value, over_time, measure = (part.strip() for part in value.partition(":"))
        if over_time and name not in OVER_TIME:
            raise SceneError(
                f"--error {text}: only {', '.join(OVER_TIME)} are measured over time; leave out :{measure}"
            )
        if over_time and measure not in MEASURES:
            raise SceneError(
                f"--error {text}: expected :rms (over time, the default), :max (the largest) or :end (at the end)"
            )
        try:
            limit = float(value)
        except ValueError:
            limit = math.nan
        if not separator or not 0.0 <= limit < math.inf:
            raise SceneError(f"--error {text}: expected a number of 0 or more, such as {name}=1e-4")
        found[name + MEASURES[measure or "rms"]] = limit
    return found


def write(tuning: Tuning, path: Path) -> None:
    """Write the scene with the best setting, the scene's own comments, and a comment on the measurement.

    Raises ExperimentError if the file cannot be written.
    """
    study, result = tuning.study, tuning.best
    assert study.reference is not None and result is not None, "the measured errors need a reference"
    cost = f"{result.cost:.3g} s, the median of {len(result.costs)}, ± {result.spread:.0%}"
    horizon = study.scene.unit_system.text(study.reference.horizon, TIME)
    comment = [
        f"carom tune: {result.setting.name}",
        f"measured: {', '.join(tuning.kept(result))}; {cost}",
        f"the cheapest of {len(tuning.tried)} settings tried" + (f", {tuning.claim}" if tuning.claim else ""),
        f"against a reference that is {study.reference.text}; compared up to {horizon}",
    ]
    text = "".join(f"# {line}\n" for line in comment) + "\n" + _toml_for(result.setting.apply(study.scene), path.parent)
    try:
        write_whole(path, text)
    except OSError as error:
        raise ExperimentError(f"{path}: cannot be written: {error.strerror}") from None


def _toml_for(scene: Scene, folder: Path) -> str:
    """Return the text of a scene with names of data files relative to a folder."""
    files = None if scene.held is None else scene.held.files
    if files is None or files.folder.resolve() == folder.resolve():
        return scene.toml
    document = tomlkit.parse(scene.toml)
    for section, table in zip(scene.bodies, document["bodies"], strict=True):
        if section.file is not None and not Path(section.file).is_absolute():
            table["file"] = Path(os.path.relpath(files.folder / section.file, folder)).as_posix()
    return tomlkit.dumps(document)
