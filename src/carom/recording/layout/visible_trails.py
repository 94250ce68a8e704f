"""Trails in a view: all pieces up to the cursor."""

from __future__ import annotations

import rerun as rr
import rerun.blueprint as rrb
from rerun.blueprint.api import VisualizerLike
from rerun.encodings import EntityPathLike

from carom.recording.schema.paths import SIM_TIME, STEP

TRAILS = "trails"


def up_to_cursor() -> dict[EntityPathLike, VisualizerLike]:
    """Return the override by which a view shows all pieces up to the cursor."""
    start, end = rr.TimeRangeBoundary.infinite(), rr.TimeRangeBoundary.cursor_relative()
    ranges = [rrb.VisibleTimeRange(timeline, start=start, end=end) for timeline in (SIM_TIME, STEP)]
    return {TRAILS: rrb.VisibleTimeRanges(ranges)}
