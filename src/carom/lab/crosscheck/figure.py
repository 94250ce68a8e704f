"""The figure of a crosscheck: how far each run is from the reference, over time. Needs the extra ``plot``."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from carom.errors import ExperimentError
from carom.lab.crosscheck.crosscheck import Crosscheck
from carom.lab.crosscheck.parting import PARTED
from carom.lab.tradeoff.figure import FAINT, LEAST, styled
from carom.lab.tradeoff.reference import Reference
from carom.lab.tradeoff.result import Result
from carom.recording.write.whole_file import whole_file
from carom.scene.units.dimension import TIME
from carom.scene.units.system import UnitSystem

OWN_COLOUR = "#1b2a3a"
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")  # of the engines, in their order
WIDEST = 3.0  # points, of the first line, or later ones would hide those that agree with them
STYLES = ("-", "--", ":", "-.")  # of the settings of one engine, in their order
MOST_IMPACTS = 40  # that are marked; more would fill the figure


def draw(check: Crosscheck, path: Path) -> None:
    """Draw a crosscheck into a PNG or SVG.

    Raises
    ------
    ExperimentError
        If matplotlib is not there, or nothing is measured.
    """
    look = styled(9)
    reference, units = check.study.reference, check.scene.unit_system
    runs = [result for result in check.results if result.status == "measured"]
    if reference is None or not runs:
        raise ExperimentError("nothing has been measured yet, so there is nothing to draw")
    from matplotlib.figure import Figure  # noqa: PLC0415 - an extra

    with look:
        figure = Figure(figsize=(10.0, 5.2), layout="constrained", dpi=110)
        ax = figure.subplots()
        for met in np.sort(reference.trajectory.met)[:MOST_IMPACTS]:
            ax.axvline(units.shown(float(met), TIME), color=FAINT, linewidth=0.6, alpha=0.5)
        _draw_runs(ax, check, reference, runs)
        ends = units.shown(check.scene.time.duration, TIME)
        sure = units.shown(reference.horizon, TIME)
        marks = "grey lines: first contacts; crosses: a law is broken first"
        if sure < ends:
            ax.axvspan(sure, ends, color=FAINT, alpha=0.12, linewidth=0.0)
            marks += (
                "; shaded: not compared, as the reference is no longer sure"
                if reference.whole
                else ("; shaded: not compared, as the reference ends")
            )
        ax.axhline(PARTED, color=FAINT, linewidth=0.8, linestyle=":")
        ax.annotate("diverged", (1.0, PARTED), xycoords=("axes fraction", "data"), ha="right", va="bottom", color=FAINT)
        ax.set_title(f"{check.scene.title}\n{marks}", fontsize=10)
        ax.set(
            yscale="log",
            xlabel=units.labelled("time", TIME),
            ylabel="rms distance from the reference / size",
            xlim=(0.0, ends),
        )
        ax.spines[["top", "right"]].set_visible(False)
        ax.legend(frameon=False, fontsize=8, loc="center left", bbox_to_anchor=(1.0, 0.5))
        with whole_file(path) as part:
            figure.savefig(part)


def _draw_runs(ax: Any, check: Crosscheck, reference: Reference, runs: list[Result]) -> None:
    """Draw how far each run is from the reference; later lines are thinner, and earlier ones show behind them."""
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
        _mark(ax, check.examinations.get(result.setting.name), time, shown, colours[engine], units)


def colours_of(engines: Iterable[str]) -> dict[str, str]:
    """Return the colours of the runs of each engine, in the order in which they are named; carom has no name."""
    names = [name for name in dict.fromkeys(engines) if name]
    return {"": OWN_COLOUR} | {name: COLOURS[k % len(COLOURS)] for k, name in enumerate(names)}


def _mark(ax: Any, examination: Any, time: Any, distance: Any, colour: str, units: UnitSystem) -> None:
    """Mark the first frame that broke each law."""
    laws = {} if examination is None else examination.laws
    for broken in laws.values():
        at = units.shown(broken["time"], TIME)
        if len(time) and at <= time[-1]:
            ax.plot(at, np.interp(at, time, distance), "x", color=colour, markersize=8, mew=2.0)
