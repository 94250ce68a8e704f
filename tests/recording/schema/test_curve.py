import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from carom.recording.schema.curve_outline import CurveOutline


@settings(deadline=None)  # the machine may be busy
@given(st.integers(1, 4000), st.integers(1, 700), st.integers(0, 2**32 - 1))
def test_the_outline_holds_every_value_whatever_the_batches(count: int, batch: int, seed: int) -> None:
    random = np.random.default_rng(seed)
    time, value = np.cumsum(random.uniform(0.1, 1.0, count)), random.normal(size=count)
    curve = CurveOutline()
    for first in range(0, count, batch):
        curve.see(time[first : first + batch], value[first : first + batch])
    assert curve.range() == (value.min(), value.max())
    start, end = np.sort(random.uniform(time[0], time[-1], 2))
    inside = value[(time >= start) & (time <= end)]
    low, high = curve.range(start, end)
    assert low <= inside.min(initial=np.inf)
    assert high >= inside.max(initial=-np.inf)


def test_a_window_is_not_much_wider_than_asked_for() -> None:
    time = np.linspace(0.0, 1.0, 100_000)
    curve = CurveOutline.of(time, time)
    low, high = curve.range(0.4, 0.6)
    assert 0.395 < low <= 0.4 and 0.6 <= high < 0.605  # spans are at most 1/512 of the time


@pytest.mark.parametrize("batch", [1, 2, 3, 5])
@pytest.mark.parametrize(
    ("values", "flat"),
    [
        ([0.0, 2.0, 2.0, 2.0 + 1e-12, 1.0], True),
        ([0.0, 2.0, 2.0, 2.1, 2.0], False),
        ([0.0, 1.9, 2.0, 2.0, 2.0], False),
        ([0.0, 2.0], True),
    ],
)
def test_a_curve_is_flat_if_it_is_constant_between_its_ends(values: list[float], flat: bool, batch: int) -> None:
    curve, value = CurveOutline(), np.array(values)
    for first in range(0, len(value), batch):
        part = value[first : first + batch]
        curve.see(first + np.arange(len(part), dtype=np.float64), part)
    assert curve.is_flat == flat


def test_a_curve_without_a_finite_value_is_zero() -> None:
    curve = CurveOutline.of(np.arange(3.0), np.full(3, np.nan))
    assert curve.largest == 0.0
    assert curve.range() == (np.inf, -np.inf)


def test_a_peak_of_a_step_between_two_frames_belongs_to_the_range_of_its_plot() -> None:
    curve = CurveOutline.of(np.arange(4.0), np.zeros(4))
    curve.insert(np.array([1.5, 2.5]), np.array([0.9, np.nan]))
    assert curve.range() == (0.0, 0.9) and curve.range(2.0, 3.0) == (0.0, 0.0)
