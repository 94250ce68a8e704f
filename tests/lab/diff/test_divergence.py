from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from carom.lab.diff.divergence import DistanceCurve, divergence_of, verdict

SIZE, REACH = 10.0, 15.0  # m


def curve(rms: Any, first: int, every: int = 1, dt: float = 0.05) -> DistanceCurve:
    """Make a curve of a difference that begins at a frame."""
    count = len(rms)
    steps = every * np.arange(count)
    return DistanceCurve(
        step=steps,
        time=np.asarray(dt * steps, dtype=np.float64),
        rms=np.asarray(rms, dtype=np.float64),
        floor=np.zeros(count),
        energy=np.zeros(count),
        differs=np.arange(count) >= first,
        size=SIZE,
        reach=REACH,
    )


def exponential(rate: float, amplitude: float = 1e-15, count: int = 200, first: int = 10) -> DistanceCurve:
    time = 0.05 * np.arange(count)
    grown = amplitude * np.exp(rate * (time - time[first]))
    return curve(np.where(np.arange(count) >= first, np.minimum(grown, SIZE), 0.0), first)


@pytest.mark.parametrize("rate", [1.5, 4.0, 20.0])
def test_the_rate_of_an_exponential_is_found_to_its_standard_error(rate: float) -> None:
    clean = exponential(rate)
    noise = np.exp(np.random.default_rng(3).normal(0.0, 0.3, len(clean.rms)))
    grown = divergence_of(replace(clean, rms=clean.rms * noise))
    assert grown is not None and grown.is_exponential
    assert abs(grown.rate - rate) < 4 * grown.standard_error, "4σ: one seed in 16 000 misses it"
    assert grown.standard_error < 0.05 * rate
    assert grown.doubling_time == pytest.approx(np.log(2) / grown.rate)
    assert grown.end < clean.time[-1] or rate < 3.6, "the plateau at the system's size is left out"


def test_round_off_that_grows_exponentially_is_chaos() -> None:
    found = exponential(3.0)
    said = verdict(found, divergence_of(found))
    assert said.kind == "chaos" and said.first == 10
    assert "λ = 3 ± " in said.text and "doubles every 0.231 s" in said.text


@pytest.mark.parametrize("size", [1e-9, 1e-3])
def test_a_difference_that_is_there_at_once_is_a_jump_even_if_it_grows_afterwards(size: float) -> None:
    steady = curve(np.where(np.arange(200) >= 60, size, 0.0), 60)
    growing = exponential(1.0, amplitude=size, first=60)
    for found in (steady, growing):
        said = verdict(found, divergence_of(found))
        assert said.kind == "jump" and said.first == 60
        assert said.jump == pytest.approx(size) and said.jump > said.allowed
        assert "step 60, t = 3 s" in said.text


def test_round_off_that_chaos_amplifies_between_two_frames_far_apart_is_not_a_jump() -> None:
    # One frame in 100 steps, 5 s: λ = 3 makes 3 million of 1 in that time.
    count, rate = 12, 3.0
    time = 5.0 * np.arange(count)
    rms = np.minimum(1e-15 * np.exp(rate * time), 1e-15 * np.exp(rate * 5.0 * np.minimum(np.arange(count), 2)))
    fine = exponential(rate, count=300)
    sparse = replace(curve(rms * (np.arange(count) >= 1), 1, every=100))
    assert verdict(sparse, divergence_of(fine)).kind == "chaos"
    assert verdict(sparse, None).kind == "jump", "without the rate there is no reason for so much"


@pytest.mark.parametrize("power", [1.0, 2.0])
def test_a_power_of_time_is_not_taken_for_chaos(power: float) -> None:
    time = 0.05 * np.arange(400)
    found = curve(1e-14 * time**power, 1)
    grown = divergence_of(found)
    assert grown is not None and not grown.is_exponential
    assert grown.power == pytest.approx(power, rel=0.1)
    assert verdict(found, grown).kind == "drift"


def test_a_small_difference_that_does_not_grow_is_called_that() -> None:
    found = curve(np.where(np.arange(100) >= 7, 1e-15, 0.0), 7)
    assert divergence_of(found) is None
    assert verdict(found, None).kind == "small"


def test_differences_below_single_precision_are_not_fitted() -> None:
    found = exponential(3.0)
    blurred = replace(found, floor=np.full(len(found.rms), 1e-6))
    grown = divergence_of(blurred)
    assert grown is not None
    assert found.rms[np.searchsorted(found.time, grown.begin)] > 1e-6
    said = verdict(blurred, grown)
    assert said.jump == 0.0 and "less than the precision of the recording, 1e-06 m" in said.text


def test_the_same_bits_are_the_same_whatever_the_positions() -> None:
    said = verdict(curve(np.zeros(50), 50), None)
    assert (said.kind, said.first) == ("same", None)
    assert "all 50 common frames" in said.text
