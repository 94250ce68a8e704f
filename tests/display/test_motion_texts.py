"""The legend says what moves besides the bodies, since a still picture does not show it."""

from __future__ import annotations

import numpy as np
import pytest

from carom.display.legend import LegendContents, legend
from carom.display.legend_layout import BODIES
from carom.display.motion_texts import motion_texts
from carom.physics.space import Space
from carom.runs.run import header_of
from carom.scene.load import Scene

BALL = {"body": [{"position": [0.0, 0.0, 1.0], "radius": 0.1}]}
DRUM = {"name": "drum", "cylinder": {"radius": 2.0, "axis": [0, 1, 0]}}


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"wall": [DRUM | {"motion": {"rotation": 0.5}}]}, "drum: turns at 0.5 rad/s about +y"),
        ({"wall": [DRUM | {"motion": {"rotation": -0.5}}]}, "drum: turns at 0.5 rad/s about -y"),
        (
            {"plane": [{}, {"normal": [0, 0, -1], "point": [0, 0, 5], "motion": {"velocity": [0, 0, -0.2]}}]},
            "plane 1: moves at 0.2 m/s along -z",
        ),
        (
            {"plane": [{"name": "table", "motion": {"amplitude": [0.03, 0.04, 0], "frequency": 7}}]},
            "table: oscillates by 0.05 m along (0.6, 0.8, 0), 7 1/s",
        ),
        (
            {"domain": {"boundary": "periodic", "size": [4, 4, 4], "shear": {"rate": -2.0}}},
            "box: sheared at 2 1/s; the side at +y moves along -x",
        ),
        ({"plane": [{}]}, None),
    ],
)
def test_the_legend_of_a_picture_says_how_walls_and_boxes_move(changes: dict[str, object], said: str | None) -> None:
    still = {"gravity": {"constant": 0.0}, "time": {"duration": 1.0}}
    scene = Scene.from_dict(BALL | still | changes)
    header = header_of(Space(scene, threads=1))
    assert list(motion_texts(header)) == ([said] if said else [])
    lines = legend(header, "group", np.zeros(1, np.uint32), {}, None, LegendContents()).entries
    assert [line.text for line in lines if BODIES in line.views and line.text == said] == ([said] if said else [])
