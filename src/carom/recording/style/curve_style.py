"""The style of a curve in a plot."""

from __future__ import annotations

import rerun as rr
from rerun.components import AggregationPolicy

from carom.recording.schema.series import THIN


def curve_style(legend: str, colour: int, width: float = THIN) -> rr.SeriesLines:
    """Style a curve. Where many frames share a pixel it shows the lowest and the highest, so that no peak is lost."""
    return rr.SeriesLines(names=legend, colors=colour, widths=width, aggregation_policy=AggregationPolicy.MinMax)
