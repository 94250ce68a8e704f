"""The Pareto front contains only undominated settings, and noise does not change them."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from carom.lab.tradeoff.settings_grid import pareto_front

values = st.floats(0.01, 10.0) | st.just(float("nan")) | st.sampled_from([1.0, 2.0])
points = st.lists(st.tuples(values, values), max_size=12)
noises = st.floats(0.0, 0.5)


def dominates(a: tuple[float, float], b: tuple[float, float]) -> bool:
    return a[0] <= b[0] and a[1] <= b[1] and a != b


@given(points)
def test_without_noise_a_point_is_on_the_front_exactly_if_no_other_one_dominates_it(
    given_points: list[tuple[float, float]],
) -> None:
    cost, error = (np.array([point[k] for point in given_points]) for k in (0, 1))
    known = [point for point in given_points if not np.isnan(point).any()]
    on, near = pareto_front(cost, error, np.zeros_like(cost))
    assert not near.any()
    for point, mark in zip(given_points, on, strict=True):
        expected = point in known and not any(dominates(other, point) for other in known)
        assert mark == expected


@given(points, noises)
def test_more_noise_takes_certainty_away_and_never_adds_any(
    given_points: list[tuple[float, float]], noise: float
) -> None:
    cost, error = (np.array([point[k] for point in given_points]) for k in (0, 1))
    exact, _ = pareto_front(cost, error, np.zeros_like(cost))
    on, near = pareto_front(cost, error, np.full_like(cost, noise))
    assert not (on & near).any() and not (on & ~exact).any() and not (exact & ~on & ~near).any()


@given(
    st.lists(st.tuples(st.floats(0.01, 10.0), values, noises, noises, *[st.floats(-0.99, 0.99)] * 2), max_size=12),
    st.floats(0.5, 2.0),
)
def test_two_measurements_whose_intervals_overlap_never_contradict_each_other(
    drawn: list[tuple[float, ...]], machine: float
) -> None:
    # each measurement is off from the truth by less than its own noise; one machine may be slower than the other
    truth, error, first_noise, second_noise, first_off, second_off = np.array(drawn).reshape(-1, 6).T
    first = pareto_front(truth * (1.0 + first_noise) ** first_off, error, first_noise)
    second = pareto_front(machine * truth * (1.0 + second_noise) ** second_off, error, second_noise)
    for (on, _), (other_on, other_near) in ((first, second), (second, first)):
        assert not (on & ~other_on & ~other_near).any(), "on the front by the one, beaten by the other"


@given(
    st.lists(st.tuples(st.floats(0.01, 10.0), values, noises, *[st.floats(-0.49, 0.49)] * 2), max_size=12),
    st.floats(0.0, 2.0),
)
def test_two_references_that_are_apart_by_less_than_their_doubt_never_contradict_each_other(
    drawn: list[tuple[float, ...]], doubt: float
) -> None:
    cost, error, noise, first_off, second_off = np.array(drawn).reshape(-1, 5).T
    first = pareto_front(cost, error + doubt * first_off, noise, doubt)
    second = pareto_front(cost, error + doubt * second_off, noise, doubt)
    for (on, _), (other_on, other_near) in ((first, second), (second, first)):
        assert not (on & ~other_on & ~other_near).any()


def test_of_two_errors_that_the_reference_does_not_tell_apart_neither_beats_the_other() -> None:
    cost, error = np.array([1.0, 2.0, 3.0]), np.array([3.0e-4, 2.9e-4, 1.0e-4])
    on, near = pareto_front(cost, error, np.full(3, 0.03), 5e-5)
    assert on.tolist() == [True, False, True] and near.tolist() == [False, True, False]
    on, near = pareto_front(cost, np.array([3e-4, 3e-4, 3e-4]), np.full(3, 0.03), 5e-5)
    assert on.tolist() == [True, False, False] and not near.any(), "the very same trajectory, dearer"


def test_of_two_that_cost_the_same_the_worse_is_in_doubt_and_the_better_is_not() -> None:
    on, near = pareto_front(np.array([1.00, 1.01, 2.0]), np.array([1e-3, 1e-5, 1e-4]), np.full(3, 0.03))
    assert on.tolist() == [False, True, False] and near.tolist() == [True, False, False]


def test_of_two_that_are_the_same_but_for_noise_none_is_certain() -> None:
    on, near = pareto_front(np.array([1.00, 1.01, 1.2]), np.array([1e-3, 1e-3, 1e-3]), np.full(3, 0.03))
    assert not on.any() and near.tolist() == [True, True, False]
