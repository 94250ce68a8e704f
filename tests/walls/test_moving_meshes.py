"""Meshes that move, and other walls that move beside a mesh: as planes and other shapes do."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import carom
from carom import Frame, Scene, Space
from carom.errors import SceneError
from carom.physics.schedule import every
from meshes import box, floor, stl

pytestmark = [pytest.mark.needs("trimesh"), pytest.mark.slow]  # kernels for walls are compiled for a minute

G, r = 9.81, 0.1  # m/s²; m, of the balls
SHAKEN = {"amplitude": [0.003, 0.0, 0.01], "frequency": 9.0}  # up to 3 g


def scene(solids: dict[str, Any], bodies: list[dict[str, Any]], duration: float, **sections: Any) -> Scene:
    """Return balls and walls."""
    return Scene.from_dict(
        {
            "contact": {"restitution": 0.7, "static_friction": 0.5, "kinetic_friction": 0.4},
            "gravity": {"constant": 0.0, "uniform": [0.0, 0.0, -G]},
            "body": [{"radius": r, "density": 1000.0} | body for body in bodies],
            "time": {"duration": duration, "fixed_dt": 1e-3},
        }
        | solids
        | sections
    )


def mesh(path: Path, **motion: Any) -> dict[str, Any]:
    """Return a wall of triangles that moves."""
    return {"mesh": {"file": str(path)}} | ({"motion": motion} if motion else {})


def far(folder: Path, at: tuple[float, float, float] = (0.0, 0.0, 99.0)) -> dict[str, Any]:
    """Return a mesh that nothing touches, beside which planes and walls have the kernels of a mesh."""
    return mesh(stl(folder / "far.stl", floor(0.1, 1) + np.array(at)))


def frames(of: Scene, threads: int = 1) -> list[Frame]:
    """Return a frame each hundredth of a second."""
    return list(Space(of, threads=threads).run(schedule=every(0.01)))


def work(frame: Frame) -> float:
    """Return the work in J that moving walls have done."""
    return -dict(frame.energy.ledger.forces)["walls"]


def unexplained(run: list[Frame]) -> float:
    """Return the largest change of the energy that the ledger does not explain, over the work of the walls."""
    return max(abs(frame.energy.integration_error) for frame in run) / max(abs(work(frame)) for frame in run)


def difference(one: list[Frame], other: list[Frame]) -> float:
    """Return the largest distance of the balls of two runs, in m."""
    return max(float(np.abs(a.position - b.position).max()) for a, b in zip(one, other, strict=True))


def test_a_ball_on_a_shaken_meshed_floor_moves_as_on_a_shaken_plane(tmp_path: Path) -> None:
    file = stl(tmp_path / "floor.stl", floor(2.0, 8))
    # it bounces, slides and rolls, and is hit and carried
    for motion, ball in (
        (SHAKEN, {"position": [0.1, 0.07, 0.5]}),
        ({"amplitude": [0.01, 0, 0.004], "frequency": 6.0}, {"position": [0.1, 0.07, r], "velocity": [1, 0.5, 0]}),
        ({"velocity": [0.5, 0.2, 0.3]}, {"position": [0.1, 0.07, 0.5]}),
        ({"times": [0.2, 0.5], "velocities": [[0, 0, 0.4], [0.3, 0, 0]]}, {"position": [0.1, 0.07, r]}),
    ):
        meshed = frames(scene({"wall": [mesh(file, **motion)]}, [ball], 1.0))
        plane = frames(scene({"plane": [{"motion": motion}], "wall": [far(tmp_path)]}, [ball], 1.0))
        assert difference(meshed, plane) < 1e-12  # to rounding
        assert work(meshed[-1]) == pytest.approx(work(plane[-1]), rel=1e-12)
        assert unexplained(meshed) < 1e-12  # of 10³ steps


def test_meshed_boxes_at_constant_velocities_are_one_box_in_their_own_frames(tmp_path: Path) -> None:
    file, ends = stl(tmp_path / "box.stl", box(0.5, 2)), []
    for V in (np.array([0.3, -0.2, 0.5]), np.array([-0.1, 0.4, 0.2])):
        balls = [{"position": [0.25 * k - 0.3, 0.1 * k - 0.1, 0.1 * k], "velocity": V.tolist()} for k in range(3)]
        end = frames(scene({"wall": [mesh(file, velocity=V.tolist())]}, balls, 0.6))[-1]
        ends.append((end.position - V * end.time, end.velocity - V))
    # after some ten bounces, each of which increases differences by rounding; 7e-15 was measured
    assert ends[0][0] == pytest.approx(ends[1][0], abs=1e-12)
    assert ends[0][1] == pytest.approx(ends[1][1], abs=1e-11)


def crowd(file: Path) -> Scene:
    """Return 64 balls in a shaken box."""
    at = np.linspace(-0.36, 0.36, 4)
    places = np.stack(np.meshgrid(at, at, at), axis=-1).reshape(-1, 3).tolist()
    return scene({"wall": [mesh(file, **SHAKEN)]}, [{"position": place, "radius": 0.07} for place in places], 0.5)


def test_a_shaken_meshed_box_keeps_its_balls_its_energy_and_its_bits_on_two_threads(tmp_path: Path) -> None:
    loaded = crowd(stl(tmp_path / "box.stl", box(0.5, 2)))
    run, again = (frames(loaded, threads) for threads in (1, 2))
    assert [frame.fingerprint for frame in run] == [frame.fingerprint for frame in again]
    assert unexplained(run) < 1e-10  # of some 10⁵ sums
    shift = loaded.wall[0].motion.displacement(run[-1].time)  # type: ignore[union-attr]
    assert np.abs(run[-1].position - shift).max() < 0.5 - 0.07 + 0.01


def test_a_run_in_a_shaken_mesh_is_replayed_and_resumed(tmp_path: Path) -> None:
    file, longer = tmp_path / "shaken.rrd", tmp_path / "longer.rrd"
    carom.run(crowd(stl(tmp_path / "box.stl", box(0.5, 2))), file)
    assert carom.replay(file).same
    assert carom.resume(file, 0.6, longer).finished and carom.replay(longer).same


def test_a_piston_presses_a_ball_onto_a_mesh_as_onto_a_plane(tmp_path: Path) -> None:
    file = stl(tmp_path / "floor.stl", floor(2.0, 8))
    lid = {"point": [0, 0, 0.5], "normal": [0, 0, -1], "piston": {"mass": 5.0, "force": 20.0}}
    ball = {"position": [0.1, 0.07, r]}
    meshed = frames(scene({"plane": [lid], "wall": [mesh(file)]}, [ball], 1.0))
    plane = frames(scene({"plane": [lid, {}], "wall": [far(tmp_path, (5.0, 0.0, 0.3))]}, [ball], 1.0))
    assert difference(meshed, plane) < 1e-12  # to rounding


@pytest.mark.nightly
def test_a_drum_rotates_beside_a_mesh(tmp_path: Path) -> None:
    drum = {"cylinder": {"radius": 1.0, "axis": [0, 1, 0]}, "motion": {"rotation": 1.0}}
    run = frames(scene({"wall": [drum, far(tmp_path, (0.0, 9.0, 0.0))]}, [{"position": [0.0, 0.0, -0.9]}], 0.5))
    assert work(run[-1]) > 0.0
    assert unexplained(run) < 1e-12


def test_a_mesh_that_rotates_is_refused(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match=r"wall\.0: .*motion\.rotation of a mesh, which has no axis"):
        scene({"wall": [mesh(stl(tmp_path / "floor.stl", floor(2.0, 1)), rotation=1.0)]}, [{}], 1.0)
