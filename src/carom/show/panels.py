"""Content of panels that is not in the file: a strip of the impacts, and logarithms of growing energies."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import rerun as rr

from carom.recording.layout.plot_views import DECADES, CurveOutline, Curves, curve_style, grows_by_decades, shown_series
from carom.recording.read.recorded_impacts import impacts_by_number
from carom.recording.read.recording import Recording
from carom.recording.schema import palette, paths
from carom.recording.schema.header import Header
from carom.recording.schema.paths import STEP
from carom.recording.schema.series import PLOTS
from carom.recording.write.rows import Index, Rows
from carom.show.supplement import Static

MOST_BANDS = 100
MOST_POINTS = 1000  # of impacts; with a few more, a picture takes the software driver seconds
_BANDS = (palette.ORANGE, palette.YELLOW)  # of alternate impacts


def impact_strip(recording: Recording) -> tuple[Curves, list[Rows], list[Static]]:
    """Return the outline of impulses, a band for each impact, which lasts until the next, and the bands' colours.

    If there are too many impacts there are no bands, and if there are far too many no outline.
    """
    entries = [entry for entry in recording.store.entries if entry.entity_path == paths.IMPACTS]
    if not 0 < sum(entry.rows for entry in entries if not entry.is_static) <= MOST_POINTS:
        return {}, [], []
    numbers, _ = impacts_by_number(recording)
    impacts = recording.impacts()
    if impacts.num_rows != len(numbers):
        return {}, [], []
    index = Index(impacts[STEP].to_numpy(), impacts["time"].to_numpy())
    outline = {paths.IMPACTS: CurveOutline.of(index.times, impacts["normal_impulse"].to_numpy())}
    if len(numbers) > MOST_BANDS:
        return outline, [], []
    names = [f"impact {number}" for number in numbers.tolist()]
    colours = np.array([_BANDS[k % len(_BANDS)] for k in range(len(names))], dtype=np.uint32)
    rows = Rows(paths.IMPACTS, index, list(rr.StateChange.columns(state=names)), sum(map(len, names)))
    return outline, [rows], [(paths.IMPACTS, rr.StateConfiguration(values=names, colors=colours))]


def decades(recording: Recording, header: Header, curves: Curves) -> tuple[Curves, list[Rows], list[Static]]:
    """Return the logarithms of the energies with their outlines and styles; nothing unless they grow by decades."""
    series = shown_series(header, PLOTS[0][0], curves)
    if not grows_by_decades(curves[each.path] for each in series):
        return {}, [], []
    table = recording.energy()
    index = Index(table[STEP].to_numpy(), table["time"].to_numpy())
    outlines, rows = dict[str, CurveOutline](), list[Rows]()
    statics: list[Static] = []
    for each in series:
        with np.errstate(divide="ignore"):
            values = np.log10(np.abs(table[each.path.rpartition("/")[2]].to_numpy() / header.plot_factor(each.unit)))
        values[~np.isfinite(values)] = np.nan
        path = f"{DECADES}/{each.path}"
        outlines[each.path] = CurveOutline.of(index.times, values)
        rows.append(Rows(path, index, list(rr.Scalars.columns(scalars=values)), values.nbytes))
        statics.append((path, curve_style(each.legend, each.colour, each.width)))
    return outlines, rows, statics


def whole_span(recording: Recording) -> Sequence[float]:
    """Return the times (s) of the first and of the last frame."""
    times = recording.fingerprints()["time"].to_numpy()
    return [float(times[0]), float(times[-1])]
