"""The figure of a study: error over cost, the front drawn, each setting labelled. Needs the extra ``plot``."""

from __future__ import annotations

from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from carom.experiment.error import ExperimentError
from carom.experiment.work_precision.pareto_front import pareto_front
from carom.scene.units.dimension import TIME
from carom.scene.units.system import SI, UnitSystem

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.backend_bases import RendererBase

PANELS = {
    "position": "position, rms / size",
    "impact": "first contacts, rms",
    "energy": "integration error / energy",
    "overlap": "deepest overlap / radius",
    "sinking": "mean overlap at rest / radius",
    "energy_gain": "rise of the energy / energy",
    "impacts": "number of impacts, relative",
}
MOST_PANELS = 6
LEAST = 1e-14  # rounding; smaller errors are drawn here
INK, FAINT, ACCENT = "#1b2a3a", "#8a94a0", "#d55e00"
OWN, OTHER = "o", "D"  # markers of carom's settings, and of other engines'
MOST_LABELLED = 100.0  # highest cost over the lowest up to which 2 and 5 of each power of ten are labelled
LINE = 9.0  # points between two lines of labels


def styled(size: float) -> AbstractContextManager[None]:
    """Return the context in which carom's figures are drawn, with a size of letters in points.

    Raises
    ------
    ExperimentError
        If matplotlib is not there.
    """
    try:
        import matplotlib as mpl  # noqa: PLC0415 - an extra
    except ImportError:
        raise ExperimentError('a figure needs matplotlib: install carom with its extra "plot"') from None
    return mpl.rc_context({"font.size": size, "axes.edgecolor": FAINT, "text.color": INK, "axes.labelcolor": INK})


def draw(document: dict[str, Any], path: Path, units: UnitSystem = SI) -> None:
    """Draw the document of a study into a PNG or SVG; times of impacts are drawn in units of its scene.

    Raises
    ------
    ExperimentError
        If matplotlib is not there, or nothing is measured.
    """
    look = styled(8)
    done = [entry for entry in document["settings"] if entry["status"] == "measured" and entry["cost"]]
    panels = [error for error in PANELS if any((entry["errors"][error] or 0.0) > LEAST for entry in done)][:MOST_PANELS]
    if not panels:
        raise ExperimentError("nothing is measured yet that could be drawn")
    from matplotlib.backends.backend_agg import FigureCanvasAgg  # noqa: PLC0415 - an extra
    from matplotlib.figure import Figure  # noqa: PLC0415

    with look:
        rows = (len(panels) + 1) // 2
        figure = Figure(figsize=(5.4 * min(len(panels), 2), 3.9 * rows), layout="constrained", dpi=110)
        canvas = FigureCanvasAgg(figure)
        axes = figure.subplots(rows, min(len(panels), 2), squeeze=False).ravel()
        for ax, error in zip(axes, panels, strict=False):
            _panel(ax, error, document, done, units if error == "impact" else None)
        for ax in axes[len(panels) :]:
            ax.set_visible(False)
        figure.suptitle(document["scene"]["title"], fontsize=10)
        noise = f"costs ± half their range; filled: on the front; ring: in doubt; least noise {document['noise']:.1%}"
        noise += "; diamonds: another engine" if any(entry.get("engine") for entry in done) else ""
        figure.supxlabel(f"cost / s ({noise})", fontsize=7, color=FAINT)
        figure.draw_without_rendering()
        for ax in axes[: len(panels)]:
            _label(ax, canvas.get_renderer())  # type: ignore[no-untyped-call]
        figure.savefig(path)


def _panel(
    ax: Axes, error: str, document: dict[str, Any], done: list[dict[str, Any]], units: UnitSystem | None
) -> None:
    """Draw one error over the cost; ``units`` are those of an error that is a time."""
    from matplotlib.ticker import LogLocator, NullLocator  # noqa: PLC0415

    one, unit = (units.shown(1.0, TIME), units.unit(TIME)) if units else (1.0, "")
    points = [(e["cost"], one * max(e["errors"][error], LEAST), e) for e in done if e["errors"][error] is not None]
    ax.set(xscale="log", yscale="log", ylabel=f"{PANELS[error]} / {unit}" if unit else PANELS[error])
    costs = [point[0] for point in points]
    wide = max(costs) > MOST_LABELLED * min(costs)
    ax.xaxis.set_major_locator(LogLocator(subs=(1.0,) if wide else (1.0, 2.0, 5.0)))
    ax.xaxis.set_major_formatter("{x:g}")
    ax.xaxis.set_minor_locator(NullLocator())
    ax.spines[["top", "right"]].set_visible(False)
    ax.tick_params(which="both", color=FAINT)
    for cost, wrong, entry in points:
        on, near = (entry["marks"][error] == mark for mark in ("front", "near"))
        ax.errorbar(cost, wrong, xerr=cost * entry["spread"], fmt="none", ecolor=FAINT, elinewidth=0.8)
        edge, fill = ACCENT if on or near else FAINT, ACCENT if on else "white" if near else FAINT
        marker = OTHER if entry.get("engine") else OWN
        ax.plot(cost, wrong, marker, markersize=5, color=edge, markerfacecolor=fill, zorder=3)
        name = entry["name"].replace("integrator = ", "")
        ax.annotate(
            name,
            (cost, wrong),
            xytext=(6, 3),
            textcoords="offset points",
            color=INK if on or near else FAINT,
            fontsize=7,
        )
    cost, wrong = (np.array([point[k] for point in points]) for k in (0, 1))
    # of the medians: a line through the settings that are certainly on the front would have gaps
    on, _ = pareto_front(cost, wrong, np.zeros_like(cost))
    if on.any():
        ax.step(*zip(*sorted(zip(cost[on], wrong[on], strict=True)), strict=True), where="post", color=ACCENT, lw=1.0)
    floor = document["reference"]["uncertainty"][error]
    if (
        error not in ("energy", "energy_gain", "overlap", "sinking")
        and floor
        and floor > LEAST
        and one * floor > min(w for _, w, _ in points) / 30
    ):
        ax.axhline(one * floor, color=FAINT, linewidth=0.8, linestyle=":")
        words, where = "the reference's own uncertainty", ("axes fraction", "data")
        ax.annotate(words, (1.0, one * floor), xycoords=where, ha="right", va="bottom", fontsize=6, color=FAINT)
    ax.margins(x=0.12, y=0.12)


def _label(ax: Axes, renderer: RendererBase) -> None:
    """Move labels that lie on each other apart, upwards, and to the left of their points at the right edge."""
    edge = ax.get_window_extent().x1
    placed: list[Any] = []
    labels = [text for text in ax.texts if text.get_fontsize() == 7]
    for label in sorted(labels, key=lambda text: text.get_window_extent(renderer).y0):
        if label.get_window_extent(renderer).x1 > edge:
            label.set_horizontalalignment("right")
            label.set_position((-6, 3))
        for _ in range(len(labels)):
            box = label.get_window_extent(renderer)
            if not any(box.overlaps(other) for other in placed):
                break
            x, y = label.get_position()
            label.set_position((x, y + LINE / 2))
        placed.append(label.get_window_extent(renderer))
