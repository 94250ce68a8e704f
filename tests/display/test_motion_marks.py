"""Arrows in a picture show which way walls, planes and sheared boxes move."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from carom.arrays import FloatArray
from carom.display.motion_marks import motion_marks
from carom.physics.space import Space
from carom.recording.layout.canvas import Area, CameraMotion, View
from carom.recording.schema.header import Header
from carom.recording.write.static_entities import _rims
from carom.runs.run import header_of
from carom.scene.load import Scene
from carom.scene.wall_shapes import SIDES, Mesh, shape_called
from meshes import box, tube

BALL = {"body": [{"position": [0.0, 0.0, 1.0], "radius": 0.1}]}
EYE = View(np.array([0.0, 0.0, 1.0]), 10.0, CameraMotion.STILL, np.array([0.0, -1.0, 0.0]))
AREA = Area(800.0, 500.0)


def header(changes: dict[str, Any]) -> Header:
    return header_of(Space(Scene.from_dict(BALL | changes), threads=1))


def marks(changes: dict[str, Any], origin: FloatArray | None = None) -> tuple[FloatArray, FloatArray]:
    """Return origins and vectors of the arrows of a scene, (k, 3) m."""
    shown = dict(motion_marks(header(changes), np.zeros(3) if origin is None else origin, EYE, AREA, 0.0))
    arrows: Any = next(iter(shown.values()))
    origins, vectors = (np.array(part.as_arrow_array().to_pylist()) for part in (arrows.origins, arrows.vectors))
    return origins, vectors


@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_the_arc_of_a_drum_turns_in_its_sense_at_the_end_nearer_to_the_eye(sense: float) -> None:
    drum = {"cylinder": {"radius": 2.0, "axis": [0, 1, 0]}, "motion": {"rotation": 0.5 * sense}}
    (place,), (vector,) = marks({"wall": [drum]})
    assert np.cross([0.0, sense, 0.0], place) @ vector > 0.0, "v = ω × r"
    assert place[1] < 0.0 < place[2], "at the nearer end, at the top"
    assert np.hypot(place[0], place[2]) > 2.0, "outside of the wall"


@pytest.mark.slow  # it compiles kernels that no cheaper test needs
def test_a_shaken_floor_has_arrows_both_ways_on_it_and_inside_the_picture() -> None:
    floor = {"plane": [{"point": [0, 0, 0.2], "motion": {"amplitude": [0, 0, 0.1], "frequency": 3.0}}]}
    origins, vectors = marks(floor, origin=np.array([0.0, 0.0, 0.5]))
    assert vectors[:, 2].min() < 0.0 < vectors[:, 2].max() and not vectors[:, :2].any()
    assert origins[:, 2] == pytest.approx([0.2 - 0.5] * 2, abs=1e-6), "on the floor, from the origin of the recording"
    assert np.all(np.abs(EYE.on_screen(origins)) <= [AREA.aspect, 1.0])


def test_the_sides_of_a_sheared_box_move_opposite_ways() -> None:
    box = {"size": [4, 4, 4], "boundary": "periodic", "shear": {"rate": 0.25, "flow": "x", "gradient": "z"}}
    origins, vectors = marks({"domain": box, "gravity": {"constant": 0.0}})
    assert origins[:, 2] == pytest.approx([-2.12, 2.12]), "beside both faces"
    assert np.sign(vectors[:, 0]).tolist() == [-1.0, 1.0]
    assert not vectors[:, 1:].any()


def test_what_stands_still_has_no_arrow() -> None:
    assert not list(motion_marks(header({"plane": [{}]}), np.zeros(3), EYE, AREA, 0.0))


@pytest.mark.parametrize(
    ("wall", "lines"),
    [
        ({"cylinder": {"radius": 2.0}}, 2 * SIDES),
        ({"sphere": {"radius": 2.0}}, 0),
        ({"rectangle": {"centre": [0, 0, 0], "side": [1, 0, 0], "other_side": [0, 1, 0]}}, 4),
    ],
)
def test_a_wall_has_lines_at_its_borders(wall: dict[str, Any], lines: int) -> None:
    (found,) = header({"wall": [wall]}).shapes or ()
    mesh = shape_called(found.shape).mesh(found.section, np.zeros(3), 5.0)
    assert len(_rims(mesh)) == lines
    assert (len(mesh.lines) > 0) == (found.shape == "sphere"), "only a curved profile has lines inside"


@pytest.mark.parametrize(("triangles", "lines"), [(box(0.5, 2), 24), (tube(1.0, 2.0, 8), 24), (tube(1.0, 2.0, 24), 48)])
def test_a_mesh_has_lines_at_its_edges_but_not_where_it_is_flat_or_round(triangles: FloatArray, lines: int) -> None:
    corners, number = np.unique(triangles.reshape(-1, 3), axis=0, return_inverse=True)
    assert len(_rims(Mesh(corners, number.reshape(-1, 3)))) == lines
