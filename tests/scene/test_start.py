"""Half-spaces: planes and the walls of a box as normals and offsets."""

from __future__ import annotations

import numpy as np
import pytest

from carom.scene.load import scene_from_dict
from carom.scene.start import planes_of


def test_heights_and_depths_above_an_oblique_plane_are_distances_along_its_normal() -> None:
    planes = [
        {"point": [1.0, 2.0, 3.0], "normal": [2.0, 3.0, 6.0]},
        {"point": [0.0, -1.0, 0.0], "normal": [0.0, 4.0, 0.0]},
    ]
    half_spaces = planes_of(scene_from_dict({"body": [{"position": [9, 9, 9]}], "plane": planes}))
    points = np.array([[1.0, 2.0, 3.0], [3.0, 5.0, 9.0], [0.0, 1.0, 7.0]])
    # (2, 3, 6) has the length 7; the second point is at (2, 3, 6) from the first plane's own
    expected = np.array([[0.0, 3.0], [7.0, 6.0], [(-2.0 - 3.0 + 24.0) / 7.0, 2.0]])
    assert half_spaces.heights(points) == pytest.approx(expected, abs=1e-14)
    assert half_spaces.depth(points, np.full(3, 0.5)) == pytest.approx(0.5 - expected, abs=1e-14)
