"""The figure of a study, and its recording. The figure needs ``plot``.

The figure plots the error against the cost, with the front, and a line through each setting at several steps. The
recording shows the trajectories of the settings together with the reference.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.csv

from carom.display import overlays
from carom.errors import ExperimentError
from carom.lab.compared_run import AS_WRITTEN
from carom.lab.figure_style import FAINT, styled
from carom.lab.tradeoff.reference import NAMES
from carom.lab.tradeoff.settings_grid import STEPS_WORD, pareto_front
from carom.lab.tradeoff.tradeoff import Study
from carom.physics.space import Space
from carom.recording.export.spreadsheet import harmless
from carom.recording.write.whole_file import whole_file
from carom.scene.units.dimension import TIME
from carom.scene.units.system import SI, UnitSystem
from carom.scene.wording import in_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes


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
OF_THE_RUN_ALONE = ("energy", "energy_gain", "overlap", "sinking")  # errors that need no reference
LEAST = 1e-14  # smallest error that is not drawn as zero, since smaller errors are rounding
ZERO_BELOW = 4.0  # ratio of the smallest drawn error to the height of the line for zeros
# colours of families
COLOURS = ("#d55e00", "#0072b2", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#1b2a3a", "#a0522d")
OWN, OTHERS = ("o", "s", "^"), ("D", "v", "P")  # markers of carom's families, in turn, and of other engines' families
MOST_LABELLED = 100.0  # largest ratio of costs at which 2 and 5 in each decade are labelled
COLUMNS = 4  # columns of the legend


class Look(NamedTuple):
    """The style in which a family of settings is drawn."""

    colour: str
    marker: str


def draw(document: dict[str, Any], *paths: Path, units: UnitSystem = SI) -> None:
    """Draw the document of a study into files (PNG, SVG, PDF); times of impacts are in the units of the scene.

    Raises ExperimentError if matplotlib is not installed, or nothing is measured.
    """
    measured = [entry for entry in document["settings"] if entry["status"] == "measured" and entry["cost"]]
    done = [entry for entry in measured if not entry.get("same_as")]
    panels = [error for error in PANELS if any((entry["errors"][error] or 0.0) > LEAST for entry in done)][:MOST_PANELS]
    if not panels:
        raise ExperimentError(
            f"no error exceeds {LEAST:g}, rounding" if done else "there are no measurements to draw yet"
        )
    families = _families(done)
    # each family has its own line and marker; other engines have other markers than carom
    looks: dict[str, Look] = {}
    counts = {OWN: 0, OTHERS: 0}
    for name, group in families.items():
        markers = OTHERS if group[0].get("engine") else OWN
        k, counts[markers] = counts[markers], counts[markers] + 1
        looks[name] = Look(COLOURS[k % len(COLOURS)], markers[k // len(COLOURS) % len(markers)])
    with styled(8):
        from matplotlib.backends.backend_agg import FigureCanvasAgg  # noqa: PLC0415 - an extra
        from matplotlib.figure import Figure  # noqa: PLC0415
        from matplotlib.lines import Line2D  # noqa: PLC0415

        rows = (len(panels) + 1) // 2
        figure = Figure(figsize=(5.4 * min(len(panels), 2), 3.6 * rows + 0.8), layout="constrained", dpi=110)
        FigureCanvasAgg(figure)
        axes = figure.subplots(rows, min(len(panels), 2), squeeze=False).ravel()
        for ax, error in zip(axes, panels, strict=False):
            _panel(ax, error, document, families, looks, units if error == "impact" else None)
        for ax in axes[len(panels) :]:
            ax.set_visible(False)
        title, reference = in_figure(document["scene"]["title"]), document["reference"]
        if not reference["complete"]:
            title += f"\npositions are compared up to t = {units.text(reference['horizon'], TIME)}"
        figure.suptitle(title, fontsize=10)
        ended = [entry for entry in document["settings"] if entry["status"] in ("stopped", "failed")]
        ends = [in_figure(f"{_short(entry)}: {entry['reason']}") for entry in ended]
        words = "filled: no other setting is as accurate and as cheap; ring: undecided; faint: another setting is both"
        noise = f"costs with their uncertainty, {document['noise']:.1%} or more; lines join steps of a setting"
        figure.legend(
            handles=[
                Line2D([], [], color=look.colour, marker=look.marker, markersize=5, linewidth=0.8, label=name)
                for name, look in looks.items()
            ],
            loc="outside lower center",
            ncols=min(COLUMNS, len(looks)),
            fontsize=7,
            frameon=False,
            title="\n".join([words, noise, *ends]),
            title_fontproperties={"size": 7},
        )
        for path in paths:
            with whole_file(path) as part:
                figure.savefig(part)


def write_table(document: dict[str, Any], path: Path) -> None:
    """Write a CSV file with a row for each measured setting: cost (s), steps and errors; an error may be 0.

    Unknown values are empty. Times of first contacts are in s.
    """
    measured = [entry for entry in document["settings"] if entry["errors"]]
    columns = {key: [entry[key] for entry in measured] for key in ("name", "engine", "cost", "spread", "steps")}
    columns |= {error: [entry["errors"].get(error) for entry in measured] for error in NAMES}
    known = {key: values for key, values in columns.items() if any(value is not None for value in values)}
    with whole_file(path) as part:
        pyarrow.csv.write_csv(harmless(pa.table(known)), str(part))


def _families(done: list[dict[str, Any]]) -> dict[str, list[dict[str, Any]]]:
    """Group settings that differ only in the step by their common name; a single setting keeps its whole name."""
    found: dict[str, list[dict[str, Any]]] = {}
    for entry in done:
        parts = [
            part
            for part in _short(entry).split(", ")
            if " × " not in part and not part.startswith(("dt =", STEPS_WORD))
        ]
        found.setdefault(", ".join(parts) or AS_WRITTEN.name, []).append(entry)
    return {name if len(group) > 1 else _short(group[0]): group for name, group in found.items()}


def _short(entry: dict[str, Any]) -> str:
    """Return the name of a setting without the key of its integrator."""
    return str(entry["name"]).replace("integrator = ", "")


def _panel(
    ax: Axes,
    error: str,
    document: dict[str, Any],
    families: dict[str, list[dict[str, Any]]],
    looks: dict[str, Look],
    units: UnitSystem | None,
) -> None:
    """Plot one error against the cost; ``units`` apply to an error that is a time."""
    from matplotlib.ticker import LogLocator, NullLocator  # noqa: PLC0415

    one, unit = (units.shown(1.0, TIME), units.unit(TIME)) if units else (1.0, "")
    ax.set(xscale="log", yscale="log", xlabel="cost / s", ylabel=f"{PANELS[error]} / {unit}" if unit else PANELS[error])
    points: list[tuple[float, float]] = []
    ax.autoscale(enable=False, axis="y")
    sizes = [entry["errors"][error] for group in families.values() for entry in group]
    zero = one * min(size for size in sizes if size is not None and size > LEAST) / ZERO_BELOW
    for name, group in families.items():
        look = looks[name]
        known = [entry for entry in group if entry["errors"][error] is not None]
        found = [(entry["cost"], entry["errors"][error]) for entry in known]
        here = [(cost, one * size if size > LEAST else zero) for cost, size in found]
        points += here
        if len(here) > 1:
            ax.plot(*zip(*sorted(here), strict=True), color=look.colour, linewidth=0.6, alpha=0.5)
        for (cost, wrong), entry in zip(here, known, strict=True):
            mark = entry["marks"][error]
            ax.errorbar(cost, wrong, xerr=cost * entry["spread"], fmt="none", ecolor=look.colour, elinewidth=0.6)
            fill, alpha = ("white", 1.0) if mark == "near" else (look.colour, 1.0 if mark else 0.35)
            point = ax.plot(cost, wrong, look.marker, markersize=5, color=look.colour, alpha=alpha, zorder=3)
            point[0].set_markerfacecolor(fill)
    cost, wrong = (np.array([point[k] for point in points]) for k in (0, 1))
    wide = cost.max() > MOST_LABELLED * cost.min()
    ax.xaxis.set_major_locator(LogLocator(subs=(1.0,) if wide else (1.0, 2.0, 5.0)))
    ax.xaxis.set_major_formatter("{x:g}")
    ax.xaxis.set_minor_locator(NullLocator())
    ax.spines[["top", "right"]].set_visible(False)
    ax.tick_params(which="both", color=FAINT)
    # draws the front of the medians: a line through the certain settings alone would have gaps
    on, _ = pareto_front(cost, wrong, np.zeros_like(cost))
    if on.any():
        ax.step(*zip(*sorted(zip(cost[on], wrong[on], strict=True)), strict=True), where="post", color=FAINT, lw=1.0)
    floor = one * (document["reference"]["uncertainty"][error] or 0.0)
    seen = error not in OF_THE_RUN_ALONE and floor > max(one * LEAST, wrong.min() / 30)
    if seen:
        ax.axhline(floor, color=FAINT, linewidth=0.8, linestyle=":")
        words, where = "the reference's own uncertainty", ("axes fraction", "data")
        ax.annotate(words, (1.0, floor), xycoords=where, ha="right", va="bottom", fontsize=6, color=FAINT)
    if wrong.min() == zero:
        ax.axhline(zero, color=FAINT, linewidth=0.5, zorder=0)
        ax.annotate(
            "zero, or rounding", (1.0, zero), xycoords=("axes fraction", "data"), ha="right", va="bottom", fontsize=6
        )
    wider = max(1.2, (cost.max() / cost.min()) ** 0.06)  # otherwise matplotlib warns if all costs are equal
    ax.set_xlim(cost.min() / wider, cost.max() * wider)
    drawn = [*wrong, floor] if seen else wrong
    least, most = min(drawn), max(drawn)
    room = max(1.2, (most / least) ** 0.08)  # otherwise matplotlib warns if all errors are equal
    ax.set_ylim(least / room, most * room)


def record(study: Study, path: Path) -> None:
    """Write a study's trajectories into one ``.rrd``, in place of an earlier one.

    Raises RecordingError if the file cannot be written.
    """
    reference = study.reference
    if reference is None or not len(reference.trajectory):
        return
    trajectories = [
        overlays.ComparedTrajectory(f"reference, {reference.kind}", reference.trajectory.position, np.empty(0))
    ]
    longest = reference.trajectory
    for result in study.results:
        if result.status == "measured" and not result.same_as:
            run = study.trajectory(result)
            distance, _ = reference.scale.apart(run, reference.trajectory)
            compared = overlays.ComparedTrajectory(result.setting.name, run.position, distance, result.setting.engine)
            trajectories.append(compared)
            longest = run
    overlays.write_trajectories(path, Space(study.scene, 1), longest.time, trajectories)
