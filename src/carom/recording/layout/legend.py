"""Placement of a plot's legend, so that it covers no curve.

Rerun draws the legend into a corner of the plot, over the curves. The size of the legend follows from its texts, and
that of the plot from the layout and its window. If a curve passes behind the legend, the vertical axis is extended on
that side. The legend gets the corner that needs the shortest axis.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

from carom.recording.layout.canvas import Area
from carom.recording.layout.curve import Curve

_ROW, _FRAME = 23.0, 14.0  # px, height of a line, and of the frame with its distance from the border; measured
_LETTER, _DOT = 7.0, 44.0  # px, width of a wide letter, and of the dot with the frame; measured
_PAD = 0.05  # of the range of the values, left free above and below
_FLAT = 1e-9  # of a value; a smaller range is rounding, and is not shown enlarged
_LARGEST = 0.75  # of the plot's height; a larger legend would leave too little room for the curves


@dataclass(frozen=True, slots=True)
class Place:
    """The legend's corner, and the range of the vertical axis; None if the viewer fits it to the values."""

    corner: rrb.Corner2D
    range: tuple[float, float] | None


def place_legend(legends: Sequence[str], curves: Sequence[Curve], plot: Area) -> Place:
    """Choose the corner of a legend and the range of the axis.

    Parameters
    ----------
    legends
        The lines of the legend; without any the plot has none.
    curves
        The outlines of the curves; empty if they are unknown.
    plot
        The area between its axes.
    """
    low, high = _union(curves)
    if not high >= low:
        return Place(rrb.Corner2D.LeftTop, None)
    size = max(abs(low), abs(high))
    pad = _PAD * (high - low) if high - low > _FLAT * size else size or 1.0
    bottom, top = low - pad, high + pad
    if not legends:
        return Place(rrb.Corner2D.LeftTop, (bottom, top))
    tall = min(_LARGEST, (_ROW * len(legends) + _FRAME) / plot.height)
    wide = min(1.0, _width(legends) / plot.width)
    start, end = min(curve.times()[0] for curve in curves), max(curve.times()[1] for curve in curves)
    left, right = (start, start + wide * (end - start)), (end - wide * (end - start), end)
    places = []
    for corner, window in ((rrb.Corner2D.LeftTop, left), (rrb.Corner2D.RightTop, right)):
        reach = _union(curves, *window)[1]
        places.append(Place(corner, (bottom, max(top, (reach - tall * bottom) / (1.0 - tall)))))
    for corner, window in ((rrb.Corner2D.RightBottom, right), (rrb.Corner2D.LeftBottom, left)):
        reach = _union(curves, *window)[0]
        places.append(Place(corner, (min(bottom, (reach - tall * top) / (1.0 - tall)), top)))
    return min(places, key=_length)


def time_beside_legend(legends: Sequence[str], nanoseconds: NDArray[np.int64], width: float) -> rrb.TimeAxis:
    """Return a time axis that is long enough for a legend to the right of all curves.

    Parameters
    ----------
    legends
        The lines of the legend.
    nanoseconds
        The first and the last time, as recorded, (2,).
    width
        Of the plot, in px.
    """
    start, end = nanoseconds.tolist()
    wide = min(_LARGEST, _width(legends) / width) if legends else 0.0
    later = int(end + (end - start) * wide / (1.0 - wide))
    absolute = [rr.TimeRangeBoundary.absolute(nanos=at) for at in (start, later)]
    return rrb.TimeAxis(view_range=rr.TimeRange(start=absolute[0], end=absolute[1]))


def _width(legends: Sequence[str]) -> float:
    return _LETTER * max(map(len, legends)) + _DOT


def _length(place: Place) -> float:
    assert place.range is not None
    return place.range[1] - place.range[0]


def _union(curves: Sequence[Curve], *window: float) -> tuple[float, float]:
    """Return the lowest and the highest value of all curves in a window of time."""
    ranges = [curve.range(*window) for curve in curves]
    return min((low for low, _ in ranges), default=float("inf")), max(
        (high for _, high in ranges), default=-float("inf")
    )
