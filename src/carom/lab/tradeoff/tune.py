"""Finds the cheapest setting of a scene whose measured errors keep given limits, by search or from a list."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from carom.errors import ExperimentError, SceneError
from carom.lab.tradeoff.coordinate_descent import Search, excess, loses_frames, unsure
from carom.lab.tradeoff.error_measures import COMPARED, NAMES
from carom.lab.tradeoff.result import Result
from carom.lab.tradeoff.settings_grid import AS_WRITTEN, Setting, default_points
from carom.lab.tradeoff.stored_study import result_entry
from carom.lab.tradeoff.tradeoff import Study, Teller
from carom.recording.write.whole_file import write_whole
from carom.runs.json_numbers import finite
from carom.scene.toml_text import toml_for
from carom.scene.units.dimension import TIME
from carom.scene.wording import suggestion

WORSE = 1.1  # times an error of the scene as written; smaller increases are not reported


@dataclass(frozen=True, slots=True)
class Tuning:
    """The settings that were tried for given limits, and the cheapest that keeps them."""

    study: Study
    limits: dict[str, float]
    written: Result  # the scene as written
    tried: tuple[Result, ...]  # including the scene as written

    @property
    def best(self) -> Result | None:
        """The cheapest setting measured to keep every limit and the scene's frames; None if there is none.

        An unmeasured error, such as a position beyond the horizon, keeps no limit. A limit below the uncertainty of the
        reference is not kept either, because it cannot be checked.
        """
        if unsure(self.study, self.limits):
            return None
        kept = [result for result in self.tried if not self._excess(result)]
        return min(kept, key=lambda result: result.cost, default=None)

    @property
    def speed(self) -> float:
        """Speed of the best setting over that of the scene as written; NaN if one of them has no cost."""
        return math.nan if self.best is None else self.written.cost / self.best.cost

    def misses(self, result: Result) -> list[str]:
        """Name the limits that a setting misses."""
        errors = {name: getattr(result.errors, name, math.nan) for name in self.limits}
        missed = [
            f"{name} not measured" if math.isnan(found) else f"{name} {found:.2g} > {self.limits[name]:.2g}"
            for name, found in errors.items()
            if not found <= self.limits[name]
        ]
        if loses_frames(self.study, self.written, result):
            missed.append(f"{result.frames} frames of {self.written.frames}")
        return missed

    @property
    def passed_over(self) -> Result | None:
        """The cheapest setting that keeps every limit and is cheaper than the best, but loses frames; None if none."""
        if self.best is None:
            return None
        cheaper = [
            result
            for result in self.tried
            if result.cost < self.best.cost and loses_frames(self.study, self.written, result)
        ]
        return min((each for each in cheaper if len(self.misses(each)) == 1), key=lambda each: each.cost, default=None)

    def worse(self) -> dict[str, tuple[float, float]]:
        """Return the errors that are worse in the best setting than as written: both values, by name."""
        if self.best is None or self.best.errors is None or self.written.errors is None:
            return {}
        before, after = asdict(self.written.errors), asdict(self.best.errors)
        return {
            name: (before[name], after[name])
            for name in NAMES
            if after[name] > max(WORSE * before[name], self.study.floor(name))
        }

    def why_none(self) -> str:
        """Explain why no setting keeps the limits, by the one that misses by the smallest factor."""
        for name in unsure(self.study, self.limits):
            return f"{name} below {self.study.floor(name):.2g} is rounding, or the uncertainty of the reference itself"
        done = [result for result in self.tried if result.complete]
        if not done:
            return "none could be measured"
        best = min(done, key=self._excess)
        return f"the nearest is {best.setting.name}: {', '.join(self.misses(best))}"

    def document(self) -> dict[str, Any]:
        """Return the result as a JSON document."""
        best, speed = self.best, self.speed
        return _asked(self.study, self.limits) | {
            "tried": len(self.tried),
            "best": best and result_entry(best),
            "as_written": result_entry(self.written),
            "speed": finite(speed),
            "worse": {name: list(values) for name, values in self.worse().items()},
            "why_none": None if best else self.why_none(),
        }

    def _excess(self, result: Result) -> float:
        return excess(self.study, self.written, result, self.limits)


def stopped(study: Study, limits: Mapping[str, float]) -> dict[str, Any]:
    """Return the JSON document of a search that the user ended before it had a result."""
    none = {"best": None, "why_none": "stopped by the user"}
    return _asked(study, limits) | {"tried": len(study.results)} | none


def _asked(study: Study, limits: Mapping[str, float]) -> dict[str, Any]:
    """Return what was searched for, and where the measurements are."""
    return {
        "units": study.scene.unit_system.recorded,
        "scene": {"title": study.scene.title, "bodies": study.scene.count},
        "limits": dict(limits),
        "study": str(study.folder),
    }


def tuned(
    study: Study, limits: dict[str, float], repeats: int, tell: Teller, settings: list[Setting] | None = None
) -> Tuning:
    """Search a study for the cheapest setting that keeps limits, or choose it from given settings.

    Raises
    ------
    ExperimentError
        If a limit cannot be measured in this scene.
    """
    begin = [point.setting(study.scene) for point in default_points(study.scene)] if settings is None else settings
    study.prepare([AS_WRITTEN, *begin], tell)
    _refuse_beyond_reference(study, limits)
    _refuse_unmeasured(limits, *study.measure([AS_WRITTEN], 0, tell))
    if settings is None:
        search = Search(study, limits, tell)
        search.run(repeats)
        tried = search.results
    else:
        tried = study.measure([AS_WRITTEN, *settings], repeats, tell)
    distinct = {(result.setting.overrides, result.setting.threads): result for result in tried}
    return Tuning(study, limits, tried[0], tuple(distinct.values()))


def _refuse_beyond_reference(study: Study, limits: Mapping[str, float]) -> None:
    """Refuse limits of errors that a reference which ends early does not have."""
    reference, units = study.reference, study.scene.unit_system
    asked = [name for name in limits if name in COMPARED]
    if reference is None or reference.whole or not asked:
        return
    until, end = units.text(reference.horizon, TIME), units.text(study.scene.time.duration, TIME)
    alone = ", ".join(name for name in NAMES if name not in COMPARED)
    raise ExperimentError(
        f"--error {asked[0]}: cannot be measured after t = {until} of {end}, where the reference ends: "
        f'{reference.text}. Shorten the scene, as with --set "time.duration={until}", or limit an error that needs '
        f"no reference: {alone}"
    )


def _refuse_unmeasured(limits: Mapping[str, float], written: Result) -> None:
    """Refuse limits of errors that the scene as written does not have, such as overlaps where nothing can touch."""
    if written.errors is None:
        return
    for name in limits:
        if math.isnan(getattr(written.errors, name)):
            known = ", ".join(each for each in NAMES if not math.isnan(getattr(written.errors, each)))
            raise ExperimentError(f"--error {name}: this scene has no such error; it has {known}")


def limits(asked: list[str]) -> dict[str, float]:
    """Read limits as given to ``--error``.

    Parameters
    ----------
    asked
        ``name=value`` each, such as ``energy=1e-4``.

    Raises
    ------
    SceneError
        If one does not limit a measured error.
    """
    found = {}
    for text in asked:
        name, separator, value = (part.strip() for part in text.partition("="))
        if name not in NAMES:
            raise SceneError(f"--error {text}: no error of that name; {suggestion(name, NAMES)}")
        try:
            found[name] = float(value)
        except ValueError:
            found[name] = math.nan
        if not separator or not 0.0 <= found[name] < math.inf:
            raise SceneError(f"--error {text}: expected a number of 0 or more, such as {name}=1e-4")
    return found


def write(tuning: Tuning, path: Path) -> None:
    """Write the scene with the best setting and the measurement in a comment; keeps the comments of the scene.

    Raises
    ------
    ExperimentError
        If it cannot be written.
    """
    study, result = tuning.study, tuning.best
    assert study.reference is not None and result is not None, "what is measured has a reference"
    measured = [f"{e} {getattr(result.errors, e):.2g} (asked for {limit:.2g})" for e, limit in tuning.limits.items()]
    cost = f"{result.cost:.3g} s, the median of {len(result.costs)}, ± {result.spread:.0%}"
    horizon = study.scene.unit_system.text(study.reference.horizon, TIME)
    comment = [
        f"carom tune: {result.setting.name}",
        f"measured: {', '.join(measured)}; {cost}",
        f"the cheapest of {len(tuning.tried)} settings tried, {tuning.speed:.3g} times as fast as before",
        f"against a reference that is {study.reference.text}; compared up to {horizon}",
    ]
    text = "".join(f"# {line}\n" for line in comment) + "\n" + toml_for(result.setting.apply(study.scene), path.parent)
    try:
        write_whole(path, text)
    except OSError as error:
        raise ExperimentError(f"{path}: cannot be written: {error.strerror}") from None
