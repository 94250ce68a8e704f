"""The outlines of the series of a recording, for layouts that are made after the run."""

from __future__ import annotations

import numpy as np

from carom.recording.layout.curve import Curve
from carom.recording.read.recording import Recording
from carom.recording.schema.paths import ENERGY, STEP
from carom.recording.schema.series import SERIES
from carom.recording.schema.timelines import STEP as STEPS


def recorded_curves(recording: Recording, until: int | None = None) -> dict[str, Curve]:
    """Return the outlines of all recorded and plotted series, by their paths; up to a step if one is given."""
    curves: dict[str, Curve] = {}
    tables = {ENERGY: recording.energy(), STEP: recording.steps()}
    for series in SERIES:
        table, name = tables[series.path.partition("/")[0]], series.path.rpartition("/")[2]
        if series.plot is not None and name in table.column_names:
            kept = slice(None) if until is None else table[STEPS].to_numpy() <= until
            curves[series.path] = Curve.of(table["time"].to_numpy()[kept], np.asarray(table[name])[kept])
    return curves
