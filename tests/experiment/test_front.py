"""The front is a front."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from carom.experiment.front import front, near

values = st.floats(0.01, 10.0) | st.just(float("nan")) | st.sampled_from([1.0, 2.0])
points = st.lists(st.tuples(values, values), max_size=12)


def dominates(a: tuple[float, float], b: tuple[float, float]) -> bool:
    return a[0] <= b[0] and a[1] <= b[1] and a != b


@given(points)
def test_a_point_is_on_the_front_exactly_if_no_other_one_dominates_it(given_points: list[tuple[float, float]]) -> None:
    cost, error = (np.array([point[k] for point in given_points]) for k in (0, 1))
    known = [point for point in given_points if not np.isnan(point).any()]
    marked = front(cost, error)
    for point, mark in zip(given_points, marked, strict=True):
        expected = point in known and not any(dominates(other, point) for other in known)
        assert mark == expected


@given(points, st.floats(0.0, 0.5))
def test_what_is_near_the_front_is_not_on_it_and_nothing_is_near_without_noise_but_equals(
    given_points: list[tuple[float, float]], noise: float
) -> None:
    cost, error = (np.array([point[k] for point in given_points]) for k in (0, 1))
    on, close = front(cost, error), near(cost, error, noise)
    assert not (on & close).any()
    assert not near(cost, error, 0.0).any()
    for k in np.flatnonzero(close):
        assert not any(
            other_error <= error[k] and other_cost < cost[k] * (1 - noise)
            for other_cost, other_error in given_points
            if not np.isnan(other_cost + other_error)
        )
