import numpy as np

from carom.recording import arrows


def test_the_length_can_be_turned_back_into_the_magnitude() -> None:
    magnitude = np.logspace(-4, 4, 9)
    drawn = arrows.drawn(np.tile([1.0, 0.0, 0.0], (9, 1)), magnitude, np.full(9, 0.5), m_ref=2.0, l_max=3.0)
    u = (np.linalg.norm(drawn, axis=1) - 0.5) / 3.0
    np.testing.assert_allclose(2.0 * (u / (1 - u)) ** 3, magnitude, rtol=2e-4)


def test_every_arrow_sticks_out_of_its_sphere_and_none_is_longer_than_the_longest() -> None:
    magnitude = np.array([1e-3, 1.0, 1e3, 1e200])
    radius = np.array([1.0, 2.0, 0.1, 5.0])
    drawn = arrows.drawn(np.tile([0.0, 0.6, 0.8], (4, 1)), magnitude, radius, m_ref=1.0, l_max=4.0)
    sticking_out = np.linalg.norm(drawn, axis=1) - radius
    assert np.all(sticking_out > 0.08 * 4.0)
    assert np.all(sticking_out <= 4.0 * 1.000001)


def test_magnitudes_neither_overflow_nor_underflow() -> None:
    tiny, huge = np.array([3e-200, 4e-200, 0.0]), np.array([3e200, 4e200, 0.0])
    for vector, length in ((tiny, 5e-200), (huge, 5e200)):
        np.testing.assert_allclose(arrows.magnitudes(vector[None]), [length], rtol=1e-15)
    assert arrows.magnitudes(np.zeros((2, 3))).tolist() == [0.0, 0.0]


def test_rounding_noise_in_the_first_frame_is_no_measure_for_the_others() -> None:
    assert arrows.reference(np.array([1e-18, 2e-18]), natural_unit=10.0) >= 0.99e-5
    assert arrows.reference(np.array([1.0, 3.0, 5.0]), natural_unit=10.0) == 3.0
