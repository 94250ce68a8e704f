"""Walls from a mesh: faces, edges and corners, flat neighbours, convergence, and no leak."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import carom
from carom import Scene, Space
from carom.arrays import FloatArray
from meshes import box, floor, stl, tube

pytestmark = [pytest.mark.needs("trimesh"), pytest.mark.slow]  # kernels for walls are compiled for a minute

G, r = 9.81, 0.1  # m/s²; m, of the balls
DOWN = [0.0, 0.0, -G]
ROUGH = {"restitution": 0.8, "static_friction": 0.5, "kinetic_friction": 0.4}
PLANE = [{"normal": [0, 0, 1]}]


def mesh_wall(path: Path, **keys: Any) -> dict[str, Any]:
    """Return the section of a scene with a mesh."""
    return {"wall": [{"mesh": {"file": str(path), **keys}}]}


def far(folder: Path) -> dict[str, Any]:
    """Return a wall that nothing touches, beside which walls of other shapes have the kernels of a mesh."""
    return mesh_wall(stl(folder / "far.stl", floor(0.1, 1) + np.array([0.0, 0.0, 99.0])))["wall"][0]  # type: ignore[no-any-return]


def end_of(walls: dict[str, Any], bodies: list[dict[str, Any]], duration: float, **sections: Any) -> Space:
    """Run balls and walls to the end."""
    scene = {
        "contact": ROUGH,
        "gravity": {"constant": 0.0, "uniform": DOWN},
        "body": [{"radius": r, "density": 1000.0} | body for body in bodies],
        "time": {"duration": duration, "fixed_dt": 1e-3},
    }
    space = Space(Scene.from_dict(scene | walls | sections), threads=1)
    for _ in space.run():
        pass
    return space


def test_a_ball_that_bounces_on_a_meshed_floor_moves_as_on_a_plane(tmp_path: Path) -> None:
    ball = {"position": [0.1, 0.07, 1.0], "velocity": [0.3, 0.1, 0.0]}
    meshed = end_of(mesh_wall(stl(tmp_path / "floor.stl", floor(2.0, 8))), [ball], 1.5).state
    plane = end_of({"plane": PLANE, "wall": [far(tmp_path)]}, [ball], 1.5).state
    assert np.abs(meshed.position - plane.position).max() < 1e-12  # a few bounces, to rounding
    assert np.abs(meshed.angular_velocity - plane.angular_velocity).max() < 1e-11


def test_a_ball_that_rolls_over_a_thousand_flat_triangles_does_not_notice(tmp_path: Path) -> None:
    ball = {"position": [-1.6, -0.9, r], "velocity": [3.0, 1.7, 0.0]}  # it slides first, then rolls
    meshed = end_of(mesh_wall(stl(tmp_path / "floor.stl", floor(2.0, 23))), [ball], 1.0).state
    plane = end_of({"plane": PLANE, "wall": [far(tmp_path)]}, [ball], 1.0).state
    assert plane.position[0, 0] - ball["position"][0] > 2.0, "it rolls over many triangles"
    # impulses begin anew on each triangle, and iterations end within their tolerance
    assert np.abs(meshed.position - plane.position).max() < 1e-9
    assert np.abs(meshed.angular_velocity - plane.angular_velocity).max() < 1e-7


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("place", "nearest"),
    [([1.05, 0.3], [1.0, 0.3]), ([1.03, 1.04], [1.0, 1.0]), ([0.0, 0.0], [0.0, 0.0]), ([0.25, 0.4], [0.25, 0.4])],
    ids=["edge", "corner", "flat corner", "flat edge"],
)
def test_a_ball_bounces_along_the_line_to_the_nearest_point(
    tmp_path: Path, place: list[float], nearest: list[float]
) -> None:
    sheet = mesh_wall(stl(tmp_path / "sheet.stl", floor(1.0, 8)))
    beside = math.hypot(place[0] - nearest[0], place[1] - nearest[1])
    touching = math.sqrt(r * r - beside * beside)
    fall, after = math.sqrt(2.0 * (1.0 - touching) / G), 0.05
    n = np.array([place[0] - nearest[0], place[1] - nearest[1], touching]) / r
    speed = np.array(DOWN) * fall
    along = speed - (speed @ n) * n
    speed = 5.0 / 7.0 * along - ROUGH["restitution"] * (speed @ n) * n  # a ball that sticks to the surface
    expected = np.array([*place, touching]) + speed * after + 0.5 * np.array(DOWN) * after * after
    space = end_of(sheet, [{"position": [*place, 1.0]}], fall + after)
    assert np.abs(space.state.position[0] - expected).max() < 1e-11  # one impact, and steps of 1 ms


@pytest.mark.nightly
def test_a_ball_in_a_groove_touches_both_sides_and_stays_there(tmp_path: Path) -> None:
    groove = np.array(
        [
            [[0, -1, 0], [1, -1, 1], [1, 1, 1]],
            [[0, -1, 0], [1, 1, 1], [0, 1, 0]],
            [[0, -1, 0], [-1, 1, 1], [-1, -1, 1]],
            [[0, -1, 0], [0, 1, 0], [-1, 1, 1]],
        ]
    )
    lowest = r * math.sqrt(2.0)
    space = end_of(mesh_wall(stl(tmp_path / "groove.stl", groove)), [{"position": [0.02, 0.3, 0.5]}], 3.0)
    assert space.state.position[0] == pytest.approx([0.0, 0.3, lowest], abs=1e-6)  # m, overlaps at rest
    assert len(space.frame().contacts.pairs) == 2


def test_no_ball_leaves_a_closed_box_through_edges_or_corners(tmp_path: Path) -> None:
    triangles = box(0.5, 2)
    path = stl(tmp_path / "box.stl", triangles)
    at = np.linspace(-0.35, 0.35, 4)
    start = np.stack(np.meshgrid(at, at, at), axis=-1).reshape(-1, 3)
    random = np.random.default_rng(62)
    corners = triangles.reshape(-1, 3)
    middles = 0.5 * (triangles + np.roll(triangles, -1, axis=1)).reshape(-1, 3)
    aims = np.concatenate((corners, middles))[random.integers(0, 2 * len(corners), len(start))]
    speed = aims - start
    speed *= 5.0 / np.linalg.norm(speed, axis=1)[:, None]
    balls = [
        {"position": x, "velocity": v, "radius": 0.04} for x, v in zip(start.tolist(), speed.tolist(), strict=True)
    ]
    space = end_of(mesh_wall(path), balls, 1.0, contact=ROUGH | {"restitution": 1.0})
    assert np.abs(space.state.position).max() < 0.5 - 0.04 + 1e-9  # m
    speeds = np.linalg.norm(space.state.velocity, axis=1)
    assert speeds.max() > 1.0, "they still move"


@pytest.mark.nightly
def test_a_recording_replays_without_the_file_on_two_threads(tmp_path: Path) -> None:
    path, run = stl(tmp_path / "floor.stl", floor(2.0, 8)), tmp_path / "run.rrd"
    balls = [{"position": [0.3 * k - 0.9, 0.1 * k, 0.3 + 0.1 * k], "radius": r, "density": 1000.0} for k in range(7)]
    scene = {
        "contact": ROUGH,
        "gravity": {"constant": 0.0, "uniform": DOWN},
        "body": balls,
        "time": {"duration": 0.6, "fixed_dt": 1e-3},
    }
    recording = carom.run(Scene.from_dict(scene | mesh_wall(path)), run, threads=1)
    path.unlink()
    assert recording.outcome == "completed"
    assert carom.replay(run, threads=2).same


@pytest.mark.nightly
def test_a_meshed_cylinder_converges_to_the_cylinder_at_the_order_of_its_facets(tmp_path: Path) -> None:
    angle = np.random.default_rng(1).uniform(0.0, 2.0 * np.pi, 24)
    balls = [
        {"position": [0.0, 0.0, 0.25 * k - 3.0], "velocity": [2.0 * math.cos(each), 2.0 * math.sin(each), 0.0]}
        for k, each in enumerate(angle.tolist())
    ]

    def end(walls: dict[str, Any]) -> FloatArray:
        return end_of(walls, balls, 0.8).state.position.copy()

    exact = end({"wall": [{"cylinder": {"radius": 1.0}}, far(tmp_path)]})
    errors = []
    for sides in (24, 96):
        path = stl(tmp_path / f"tube-{sides}.stl", tube(1.0, 9.0, sides))
        errors.append(float(np.abs(end(mesh_wall(path)) - exact).max()))
    assert 2.5 < errors[0] / errors[1] < 6.0, errors  # normals differ by π/sides at most: a factor of 4
    assert errors[1] < 2.0 * 0.7 * math.pi / 96 * 1.2  # m, twice the angle by the way since the bounce
