"""The figure of the statistics: a panel for each histogram. It needs `carom[plot]`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from carom.errors import RecordingError
from carom.extend import UnitSystem, needing, whole_file
from carom.lab.statistics.statistic import Histogram
from carom.lab.statistics.statistics_report import Statistics

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLUMNS = 3
FEWEST_BINS = 3  # in a panel; a histogram with fewer bins shows no shape
PANEL = 3.5, 2.7  # inches
INK, FAINT, MEASURED, THEORY = "#1b2a3a", "#8a94a0", "#0072b2", "#d55e00"


def draw(statistics: Statistics, path: Path) -> None:
    """Draw all histograms into a PNG or SVG, in the units of the scene.

    Raises
    ------
    RecordingError
        If there is no histogram.
    ExperimentError
        If matplotlib is not installed.
    """
    with needing("plot", "a figure", "matplotlib"):
        import matplotlib as mpl  # noqa: PLC0415 - an extra
        from matplotlib.figure import Figure  # noqa: PLC0415
    histograms = [
        histogram
        for kind in statistics.kinds.values()
        for histogram in kind.histograms.values()
        if len(histogram.values) >= FEWEST_BINS
    ]
    if not histograms:
        raise RecordingError("there are too few impacts and contacts for a figure")
    interval = statistics.interval
    columns = min(COLUMNS, len(histograms))
    rows = -(-len(histograms) // columns)
    style: Any = {
        "font.size": 8,
        "axes.edgecolor": FAINT,
        "text.color": INK,
        "axes.labelcolor": INK,
        "svg.fonttype": "none",
    }
    with mpl.rc_context(style):
        figure = Figure(figsize=(PANEL[0] * columns, PANEL[1] * rows + 0.4), layout="constrained", dpi=150)
        panels = figure.subplots(rows, columns, squeeze=False).ravel()
        for axes, histogram in zip(panels, histograms, strict=False):
            _panel(axes, histogram, statistics.units)
        for axes in panels[len(histograms) :]:
            axes.set_visible(False)
        figure.suptitle(f"{interval.recording.title}, {interval.text}", fontsize=10)
        with whole_file(path) as part:
            figure.savefig(part)


def _panel(axes: Axes, histogram: Histogram, units: UnitSystem) -> None:
    """Draw one histogram as steps, with the theoretical curve through the middles of the bins."""
    one = units.shown(1.0, histogram.dimension)
    edges = histogram.edges * one
    values, expected = histogram.values, histogram.expected
    unit = units.unit(histogram.dimension)
    label = histogram.function
    if not label:  # a density
        values, expected = values / one, None if expected is None else expected / one
        inverse = f"({unit})⁻¹" if "/" in unit or " " in unit else f"{unit}⁻¹"
        label = f"density / {inverse}" if unit else "density"
    axes.stairs(values, edges, color=MEASURED, fill=True, alpha=0.25)
    axes.stairs(values, edges, color=MEASURED, linewidth=1.0, label="measured")
    if expected is not None:
        axes.plot((edges[1:] + edges[:-1]) / 2, expected, color=THEORY, linewidth=1.0, label=histogram.theory)
        axes.legend(frameon=False, fontsize=7)
    if histogram.function.startswith("pair"):
        axes.axhline(1.0, color=FAINT, linewidth=0.8, linestyle=":")
    if histogram.falls and (values > 0.0).sum() >= FEWEST_BINS:
        axes.set_yscale("log")
    else:
        axes.set_ylim(bottom=0.0)
    axes.set(xlabel=f"{histogram.label} / {unit}" if unit else histogram.label, ylabel=label)
    axes.set_xlim(edges[0], edges[-1])
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(which="both", color=FAINT)
