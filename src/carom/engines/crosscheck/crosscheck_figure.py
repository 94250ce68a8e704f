"""The figure of a crosscheck: the distance of each run from the reference over time. It needs the extra ``plot``."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from carom.engines.crosscheck.crosscheck import Crosscheck
from carom.engines.crosscheck.parting import PARTED
from carom.errors import ExperimentError
from carom.lab.figure_style import FAINT, styled
from carom.lab.tradeoff.reference import Reference
from carom.lab.tradeoff.settings_grid import SettingResult
from carom.lab.tradeoff.tradeoff_figure import LEAST
from carom.recording.write.whole_file import whole_file
from carom.scene.units.dimension import TIME
from carom.scene.wording import in_figure

OWN_COLOUR = "#1b2a3a"
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")  # colours of the engines, in their order
WIDEST = 3.0  # points, width of the first line; later lines are thinner, so that they do not hide earlier ones
STYLES = ("-", "--", ":", "-.")  # line styles of an engine's settings, in their order
MOST_IMPACTS = 40  # largest number of impacts that are marked; more would fill the figure


def draw(check: Crosscheck, path: Path) -> None:
    """Draw a crosscheck into a PNG or SVG. Raises ExperimentError without matplotlib or measurements."""
    look = styled(9)
    reference, units = check.study.reference, check.scene.unit_system
    runs = [result for result in check.results if result.status == "measured"]
    if reference is None or not runs:
        raise ExperimentError("there are no measurements to draw yet")
    from matplotlib.figure import Figure  # noqa: PLC0415 - an extra

    with look:
        figure = Figure(figsize=(10.0, 5.2), layout="constrained", dpi=110)
        ax = figure.subplots()
        for met in np.sort(reference.trajectory.met)[:MOST_IMPACTS]:
            ax.axvline(units.shown(float(met), TIME), color=FAINT, linewidth=0.6, alpha=0.5)
        _draw_runs(ax, check, reference, runs)
        ends = units.shown(check.scene.time.duration, TIME)
        sure = units.shown(reference.horizon, TIME)
        marks = "grey lines: first contacts; crosses: first violation of a law"
        if sure < ends:
            ax.axvspan(sure, ends, color=FAINT, alpha=0.12, linewidth=0.0)
            why = "is no longer certain" if reference.whole else "ends"
            marks += f"; shaded: not compared, as the reference {why}"
        ax.axhline(PARTED, color=FAINT, linewidth=0.8, linestyle=":")
        ax.annotate("diverged", (1.0, PARTED), xycoords=("axes fraction", "data"), ha="right", va="bottom", color=FAINT)
        ax.set_title(f"{in_figure(check.scene.title)}\n{marks}", fontsize=10)
        ylabel = "rms distance from the reference / size"
        ax.set(yscale="log", xlabel=units.labelled("time", TIME), ylabel=ylabel, xlim=(0.0, ends))
        ax.spines[["top", "right"]].set_visible(False)
        ax.legend(frameon=False, fontsize=8, loc="center left", bbox_to_anchor=(1.0, 0.5))
        with whole_file(path) as part:
            figure.savefig(part)


def _draw_runs(ax: Any, check: Crosscheck, reference: Reference, runs: list[SettingResult]) -> None:
    """Draw the distance of each run from the reference; later lines are thinner, so that earlier lines are visible."""
    units = check.scene.unit_system
    colours = colours_of([*(engine.name for engine in check.engines), *(run.setting.engine for run in runs)])
    seen: dict[str, int] = {}
    for number, result in enumerate(runs):
        engine = result.setting.engine
        style = STYLES[seen.get(engine, 0) % len(STYLES)]
        seen[engine] = seen.get(engine, 0) + 1
        distance, _ = reference.scale.apart(check.study.trajectory(result), reference.trajectory)
        shown = np.maximum(distance, LEAST)
        time = units.shown(1.0, TIME) * reference.trajectory.time[: len(shown)]
        width = WIDEST - (WIDEST - 1.0) * number / len(runs)
        ax.plot(time, shown, style, color=colours[engine], linewidth=width, label=result.setting.name)
        # mark the first frame that violates each law
        examination = check.examinations.get(result.setting.name)
        for broken in () if examination is None else examination.laws.values():
            at = units.shown(broken["time"], TIME)
            if len(time) and at <= time[-1]:
                ax.plot(at, np.interp(at, time, shown), "x", color=colours[engine], markersize=8, mew=2.0)


def colours_of(engines: Iterable[str]) -> dict[str, str]:
    """Return the engines' colours by name, in the order in which engines first occur; carom's name is empty."""
    names = [name for name in dict.fromkeys(engines) if name]
    return {"": OWN_COLOUR} | {name: COLOURS[k % len(COLOURS)] for k, name in enumerate(names)}
