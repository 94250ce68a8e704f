"""The cheapest settings of a scene that were measured to keep its errors within what a person asks for."""

from __future__ import annotations

import math
from pathlib import Path

from carom.experiment.comparison import NAMES
from carom.experiment.error import ExperimentError
from carom.experiment.tradeoff import Result, Study
from carom.scene.error import SceneError
from carom.scene.nearest import suggestion


def limits(asked: list[str]) -> dict[str, float]:
    """Read limits as given to ``--error``.

    Parameters
    ----------
    asked
        ``name=value`` each, such as ``energy=1e-4``.

    Raises
    ------
    SceneError
        If one is no limit of an error that is measured.
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


def cheapest(study: Study, asked: dict[str, float]) -> Result | None:
    """Return the cheapest setting measured to keep every error asked for, None if there is none.

    An error that is not measured, such as a position beyond the horizon, is not kept. Nor is a limit below what the
    reference is uncertain by: nobody can tell.
    """
    if any(limit < study.floor(name) for name, limit in asked.items() if name != "missed"):
        return None
    kept = [result for result in study.results if result.complete and not misses(result, asked)]
    return min(kept, key=lambda result: result.cost, default=None)


def misses(result: Result, asked: dict[str, float]) -> list[str]:
    """Say which limits a setting does not keep."""
    errors = {name: getattr(result.errors, name) for name in asked}
    return [
        f"{name} not measured" if math.isnan(found) else f"{name} {found:.2g} > {asked[name]:.2g}"
        for name, found in errors.items()
        if not found <= asked[name]
    ]


def nearest(study: Study, asked: dict[str, float]) -> str:
    """Say what is in the way, in terms of the setting that misses by the smallest factor."""
    unsure = [name for name, limit in asked.items() if name != "missed" and limit < study.floor(name)]
    if unsure:
        name = unsure[0]
        return f"{name} below {study.floor(name):.2g} is rounding, or the uncertainty of the reference itself"
    done = [result for result in study.results if result.complete]
    if not done:
        return "none could be measured"

    def by(result: Result) -> float:
        worst = 0.0
        for name, limit in asked.items():
            found = getattr(result.errors, name)
            worst = max(worst, math.inf if math.isnan(found) else found / limit if limit else math.inf * (found > 0))
        return worst

    best = min(done, key=by)
    return f"the nearest is {best.setting.name}: {', '.join(misses(best, asked))}"


def write(study: Study, result: Result, asked: dict[str, float], path: Path) -> None:
    """Write the scene with a setting, the measurement in a comment, and the author's comments kept.

    Raises
    ------
    ExperimentError
        If it cannot be written.
    """
    assert study.reference is not None, "what is measured has a reference"
    measured = [f"{name} {getattr(result.errors, name):.2g} (asked for {limit:.2g})" for name, limit in asked.items()]
    cost = f"{result.cost:.3g} s, the median of {len(result.costs)}, ± {result.spread:.0%}"
    comment = [
        f"carom tune: {result.setting.name}",
        f"measured: {', '.join(measured)}; {cost}",
        f"against a reference that is {study.reference.text}; compared up to {study.reference.horizon:.6g} s",
    ]
    text = "".join(f"# {line}\n" for line in comment) + "\n" + result.setting.apply(study.scene).toml
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise ExperimentError(f"{path}: cannot be written: {error.strerror}") from None
