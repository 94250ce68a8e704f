import numpy as np

from carom.recording.layout import drawing


def test_magnitudes_neither_overflow_nor_underflow() -> None:
    tiny, huge = np.array([3e-200, 4e-200, 0.0]), np.array([3e200, 4e200, 0.0])
    for vector, length in ((tiny, 5e-200), (huge, 5e200)):
        np.testing.assert_allclose(drawing.magnitudes(vector[None]), [length], rtol=1e-15)
    assert drawing.magnitudes(np.zeros((2, 3))).tolist() == [0.0, 0.0]


def test_rounding_noise_in_the_first_frame_is_no_measure_for_the_others() -> None:
    assert drawing.reference(np.array([1e-18, 2e-18]), natural_unit=10.0) >= 0.99e-5
    assert drawing.reference(np.array([1.0, 3.0, 5.0]), natural_unit=10.0) == 3.0
