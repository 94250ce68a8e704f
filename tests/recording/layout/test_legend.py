from collections.abc import Callable

import numpy as np
import pytest
import rerun.blueprint as rrb
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from carom.recording.layout.canvas import Area
from carom.recording.layout.plot_views import place_legend, time_axis, time_beside_legend
from carom.recording.schema.curve_outline import CurveOutline

FloatArray = NDArray[np.float64]

PLOT = Area(340.0, 175.0)
TIME = np.linspace(0.0, 10.0, 400)
TOP = (rrb.Corner2D.LeftTop, rrb.Corner2D.RightTop)
LEFT = (rrb.Corner2D.LeftTop, rrb.Corner2D.LeftBottom)


def covered(legends: list[str], curves: list[FloatArray], plot: Area = PLOT) -> int:
    """Count the points of the curves that lie behind the legend where it was measured: 20 px a row, 6 a letter."""
    place = place_legend(legends, [CurveOutline.of(TIME, curve) for curve in curves], plot)
    assert place.range is not None
    wide, tall = (6 * max(map(len, legends)) + 40) / plot.width, (20 * len(legends) + 12) / plot.height
    x = TIME / TIME[-1]
    behind = x < wide if place.corner in LEFT else x > 1 - wide
    count = 0
    for curve in curves:
        y = (curve - place.range[0]) / (place.range[1] - place.range[0])
        assert np.all((y >= 0.0) & (y <= 1.0)), "the whole curve is shown"
        count += int(np.sum(behind & (y > 1 - tall if place.corner in TOP else y < tall)))
    return count


def test_a_legend_stands_in_the_corner_that_is_free() -> None:
    rising = CurveOutline.of(TIME, TIME)
    assert place_legend(["one", "two"], [rising, rising], PLOT).corner in (
        rrb.Corner2D.LeftTop,
        rrb.Corner2D.RightBottom,
    )
    falling = CurveOutline.of(TIME, -TIME)
    assert place_legend(["one", "two"], [falling, falling], PLOT).corner in (
        rrb.Corner2D.RightTop,
        rrb.Corner2D.LeftBottom,
    )


@settings(deadline=None)  # the machine may be busy
@given(
    st.integers(2, 5),
    st.integers(0, 2**32 - 1),
    st.sampled_from(["steps", "noise", "waves", "levels"]),
    st.sampled_from([1e-9, 1.0, 1e12]),
)
def test_no_legend_covers_a_curve(count: int, seed: int, kind: str, scale: float) -> None:
    random = np.random.default_rng(seed)
    draw: dict[str, Callable[[], FloatArray]] = {
        "steps": lambda: np.cumsum(random.uniform(size=400) > 0.98).astype(np.float64),
        "noise": lambda: random.normal(size=400),
        "waves": lambda: np.sin(random.uniform(0.1, 9.0) * TIME + random.uniform(0, 6)),
        "levels": lambda: np.full(400, random.normal()),
    }
    curves = [scale * draw[kind]() for _ in range(count)]
    assert covered(["restitution", "stabilisation (put in)", "friction", "drag", "total"][:count], curves) == 0


def test_a_plot_without_a_legend_has_none_to_make_room_for() -> None:
    place = place_legend([], [CurveOutline.of(TIME, np.ones(400))], PLOT)
    assert place.range == pytest.approx((0.0, 2.0))


def test_a_curve_that_is_constant_but_for_rounding_is_shown_as_a_level_line() -> None:
    energy = np.where(TIME < 5.0, 0.5, np.nextafter(0.5, 0.0))
    place = place_legend([], [CurveOutline.of(TIME, energy)], PLOT)
    assert place.range == pytest.approx((0.0, 1.0))


def test_the_axis_is_left_to_the_viewer_while_nothing_is_known() -> None:
    assert place_legend(["one", "two"], [], PLOT).range is None


def test_a_long_legend_stands_right_of_the_last_point() -> None:
    legends = [f"a setting with a long name {k}" for k in range(12)]
    view = time_beside_legend(legends, np.array([0, 10_000_000_000]), 1600.0).view_range
    assert view is not None
    shown = view.as_arrow_array().to_pylist()[0]
    last = shown["end"] if isinstance(shown["end"], int) else next(iter(shown["end"].values()))
    assert 10_000_000_000 * 1.1 < last < 10_000_000_000 * 1.3  # 28 letters of 7 px, and a dot, of 1600 px


@pytest.mark.parametrize(
    ("length", "width", "until"),
    [
        (0.8e9, 320.0, 1e9),  # ten ticks would have 40 points each, and no label
        (0.8e9, 1600.0, 0.8e9),  # 200 points each
        (0.3e9, 320.0, 0.3e9),  # 107 points each; no second within twice the length
        (40e9, 320.0, 40e9),  # 80 points for ten seconds
        (41e9, 320.0, 60e9),
        (3000e9, 320.0, 3600e9),
        (3.7e9, 320.0, 3.7e9),
    ],
)
def test_a_time_axis_of_a_picture_has_a_second_label(length: float, width: float, until: float) -> None:
    area = Area(width + 60.0 + 28.0, 200.0)  # with the numbers beside the plot and the last one below it
    shown = time_axis(area, np.array([0, int(length)])).view_range
    assert shown is not None
    ends = shown.as_arrow_array().to_pylist()[0]
    last = ends["end"] if isinstance(ends["end"], int) else next(iter(ends["end"].values()))
    assert last == pytest.approx(until * (1.0 + 28.0 / width), rel=1e-6)
