"""Radii of lines and arrows in scenes of any size."""

import numpy as np
import pytest

from carom.recording.layout.drawing import line_radii


@pytest.mark.parametrize("body", [1e-4, 1.0, 1e5])
def test_lines_are_a_share_of_the_body_where_half_precision_holds_it(body: float) -> None:
    assert line_radii([0.06, 0.3], body) == pytest.approx([0.06 * body, 0.3 * body], rel=1e-7)  # single precision


@pytest.mark.parametrize("body", [1e-12, 1e-5, 6.4e6, 1e20])
def test_lines_of_scenes_beyond_half_precision_have_widths_on_the_screen(body: float) -> None:
    radii = line_radii(np.array([0.06, 0.3]), body)
    assert np.all(radii < 0.0), "negative: points of the screen"
    assert radii[1] / radii[0] == pytest.approx(5.0), "a hard contact is thicker than a soft one"
