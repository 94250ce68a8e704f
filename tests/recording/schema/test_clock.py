import numpy as np
import pytest

from carom.errors import RecordingError
from carom.recording.schema.header import TimeScale, viewer_time
from carom.scene.units.system import SI, UnitSystem


def test_an_ordinary_scene_is_shown_in_plain_seconds() -> None:
    assert TimeScale.fitting(600.0, 1e-3).scale == 1.0


@pytest.mark.parametrize("duration", [1e10, 3.2e16, 1e30])
def test_the_age_of_a_galaxy_fits_the_timeline(duration: float) -> None:
    clock = TimeScale.fitting(duration, 1.0)
    assert np.log10(clock.scale) == round(np.log10(clock.scale))
    assert 0 < clock.nanoseconds([duration])[0] < 2**63


def test_picoseconds_are_told_apart() -> None:
    clock = TimeScale.fitting(1e-9, 1e-12)
    shown = clock.nanoseconds([k * 1e-12 for k in range(1000)])
    assert len(np.unique(shown)) == 1000


@pytest.mark.parametrize("step", [1e-12, 0.9e-6])
def test_impacts_within_a_short_step_have_times_of_six_digits(step: float) -> None:
    clock = TimeScale.fitting(1e4 * step, step)
    times = step * np.linspace(1.0, 2.0, 1001)
    np.testing.assert_allclose(clock.nanoseconds(times) * 1e-9 * clock.scale, times, atol=1e-6 * step, rtol=0.0)


def test_a_long_duration_counts_for_more_than_a_short_step() -> None:
    assert TimeScale.fitting(1e5, 1e-12).nanoseconds([1e5])[0] < 2**63
    assert TimeScale.fitting(1e12, 1e-12).scale > 1


def test_times_are_rounded_and_not_truncated() -> None:
    times = np.linspace(0.0, 999.9, 10_000)
    assert np.array_equal(TimeScale().nanoseconds(times), np.arange(10_000) * 100_000_000)


def test_an_unknown_duration_needs_no_scale() -> None:
    assert TimeScale.fitting(np.inf, 0.0).scale == 1.0


@pytest.mark.parametrize("time", [np.nan, np.inf, 1e11])
def test_a_time_that_does_not_fit_is_refused(time: float) -> None:
    with pytest.raises(RecordingError, match="does not fit"):
        TimeScale().nanoseconds([time])


@pytest.mark.parametrize(
    ("units", "scale", "note"),
    [
        (SI, 1.0, ""),
        (SI, 1e3, "+1s is 1000 s"),
        (UnitSystem({"time": "year"}), 1.0, "1 year is +365.25d"),
        (UnitSystem({"time": "ms"}), 1.0, "1 ms is +0.001s"),
        (UnitSystem({"length": "mm"}), 1.0, ""),
    ],
)
def test_the_times_of_the_viewer_are_related_to_the_scenes_unit(units: UnitSystem, scale: float, note: str) -> None:
    assert viewer_time(units, TimeScale(scale)) == note
