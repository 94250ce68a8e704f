"""Walls that rotate about their axis: friction drags bodies along, and the ledger has the work of the wall."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import carom
from carom import Frame, Scene, Space
from carom.arrays import FloatArray
from carom.errors import SceneError
from carom.physics.schedule import every

R, r = 1.0, 0.1  # m, of the wall and of a ball
G, MU = 9.81, 0.3  # m/s² and the coefficient of friction
OMEGA = 5.0  # rad/s
RUBS = {"restitution": 0.0, "static_friction": MU, "kinetic_friction": MU}
HEAVY = {"constant": 0.0, "uniform": [0.0, 0.0, -G]}
WEIGHTLESS = {"constant": 0.0}
DRUM = {"cylinder": {"radius": R, "axis": [0, 1, 0]}}
TABLE = {"disc": {"radius": R}}
DEPTH, DT = 1e-3, 1e-3  # m, an overlap, and s
BOTTOM, ON_TABLE = [0.0, 0.0, -(R - r)], [0.5, 0.0, r]  # m, centres of balls that touch


def scene(
    wall: dict[str, Any], body: dict[str, Any], duration: float, gravity: dict[str, Any] = HEAVY, **contact: Any
) -> Scene:
    """Return a ball and a wall."""
    return Scene.from_dict(
        {
            "contact": RUBS | contact,
            "gravity": gravity,
            "wall": [wall],
            "body": [{"radius": r} | body],
            "time": {"duration": duration},
        }
    )


def rotating(wall: dict[str, Any], rotation: float = OMEGA) -> dict[str, Any]:
    """Return a wall that rotates."""
    return wall | {"motion": {"rotation": rotation}}


def frames(of: Scene) -> list[Frame]:
    """Return all steps of a run."""
    return list(Space(of).run(schedule=every(0.0)))


def kinetic(frame: Frame) -> float:
    """Return the kinetic energy in J."""
    return frame.energy.translational + frame.energy.rotational


def unexplained(run: list[Frame]) -> float:
    """Return the largest change of the energy that the ledger does not explain, over the work of the wall."""
    work = max(abs(dict(frame.energy.ledger.forces)["walls"]) for frame in run)
    return max(abs(frame.energy.integration_error) for frame in run) / work


@pytest.mark.nightly
@pytest.mark.slow  # kernels for walls are compiled for a minute
def test_a_rotating_drum_drags_a_ball_with_kinetic_friction() -> None:
    end = frames(scene(rotating(DRUM), {"position": BOTTOM}, 0.02))[-1]
    t = end.time
    # the surface moves along -x; as the ball climbs, gravity and friction change by the angle ½ μ g t²/(R - r)
    climbed = 0.5 * MU * G * t * t / (R - r)
    assert end.velocity[0, 0] == pytest.approx(-MU * G * t, rel=2.0 * climbed / MU)
    assert end.angular_velocity is not None
    assert end.angular_velocity[0, 1] == pytest.approx(2.5 * MU * G * t / r, rel=2.0 * climbed / MU)


@pytest.mark.parametrize(
    ("wall", "body"),
    [
        (DRUM, {"position": [0.0, 0.0, -(R - r + DEPTH)], "velocity": [0.2, 0.0, 0.0]}),
        (rotating(DRUM, 0.05), {"position": [0.0, 0.0, -(R - r + DEPTH)]}),
        (TABLE | {"motion": {"velocity": [0.05, 0.0, 0.01]}}, {"position": [0.0, 0.0, r - DEPTH]}),
    ],
    ids=["at rest", "rotates", "translates"],
)
@pytest.mark.nightly
@pytest.mark.slow  # kernels for walls are compiled for a minute
def test_an_overlap_with_a_wall_is_removed_without_a_velocity(wall: dict[str, Any], body: dict[str, Any]) -> None:
    # the velocity that removes it within a step would be DEPTH / dt = 1 m/s, with 50 times the weight's work over DEPTH
    document = scene(wall, body, 0.1, allow_overlap=True).model_dump(exclude_unset=True)
    run = frames(Scene.from_dict(document | {"time": {"duration": 0.1, "fixed_dt": DT}}))
    speeds = [frame.velocity[0, 2] for frame in run]
    assert max(speeds) < 0.01 + 2.0 * G * DT  # of the wall, and of the weight in one step, with its rest speed
    mass = Space(scene(wall, body, 0.1, allow_overlap=True)).state.mass[0]
    ledger = run[-1].energy.ledger
    assert ledger.restitution > -1e-3 * mass * G * DEPTH  # contacts give no energy but by the correction of positions
    assert ledger.stabilisation == pytest.approx(mass * G * DEPTH, rel=0.01)
    assert abs(run[-1].energy.integration_error) < 1e-9 * mass * G * R
    surface = 0.01 * run[-1].time if wall.get("motion", {}).get("velocity") else 0.0
    height = run[-1].position[0, 2] - r if wall.get("disc") else R - r - np.hypot(*run[-1].position[0, [0, 2]])
    assert height == pytest.approx(surface, abs=1e-6)


@pytest.mark.nightly
@pytest.mark.slow  # kernels for walls are compiled for a minute
def test_balls_side_by_side_in_a_drum_move_like_one() -> None:
    # sixteen contacts that share no ball are solved in vectors of eight, a single one by itself
    drum = {"contact": RUBS, "gravity": HEAVY, "wall": [rotating(DRUM)], "time": {"duration": 0.3, "fixed_dt": 0.002}}
    row = [{"radius": r, "position": [0.0, 3.0 * r * k, BOTTOM[2]]} for k in range(16)]
    alone, beside = (frames(Scene.from_dict(drum | {"body": balls}))[-1].velocity for balls in (row[:1], row))
    # the line search sums over the balls, so its factor is rounded otherwise
    assert beside == pytest.approx(np.repeat(alone, len(row), axis=0), rel=1e-11, abs=1e-13)


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.slow  # kernels for walls are compiled for a minute
def test_a_rotating_disc_starts_to_drag_a_ball_along_its_surface(sign: float) -> None:
    run = frames(scene(rotating(TABLE, sign * OMEGA), {"position": ON_TABLE}, 0.02))
    end, t = run[-1], run[-1].time
    along = np.array([0.0, sign, 0.0])  # Ω × p
    turned = 0.5 * MU * G * t * t / 0.5  # of the direction of the surface's velocity, at most
    assert end.velocity[0] @ along == pytest.approx(MU * G * t, rel=1e-3)
    assert np.abs(end.velocity[0] - (end.velocity[0] @ along) * along).max() < (turned + t) * MU * G * t
    assert end.angular_velocity is not None
    assert end.angular_velocity[0, 0] * sign == pytest.approx(2.5 * MU * G * t / r, rel=1e-3)


@pytest.mark.slow  # kernels for walls are compiled for a minute
def test_a_rolling_ball_moves_in_a_circle_at_two_sevenths_of_the_rotation_of_the_table() -> None:
    # a ball that rolls on a rotating table has the constant Ω 2/7 about the centre of its circle (Earnshaw 1844)
    speed = 0.4
    # no slip at p = x - r e_z: v + ω × (-r e_z) = Ω × p, at x = (0.5, 0, r) with v = (0, speed, 0)
    rolling = {"velocity": [0.0, speed, 0.0], "angular_velocity": [(OMEGA * 0.5 - speed) / r, 0.0, 0.0]}
    run = frames(scene(rotating(TABLE), {"position": ON_TABLE} | rolling, 1.0))
    angle = 2.0 / 7.0 * OMEGA * run[-1].time
    turned = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    assert run[-1].velocity[0, :2] == pytest.approx(turned @ [0.0, speed], abs=1e-3 * speed)
    assert unexplained(run) < 1e-12


@pytest.mark.parametrize(
    ("wall", "body"),
    [
        (DRUM, {"position": BOTTOM}),
        (TABLE, {"position": [0.5, 0.0, 0.3], "velocity": [0.1, 0.0, 0.0]}),
        ({"sphere": {"radius": R, "axis": [0, 1, 1]}}, {"position": [0.3, 0.1, 0.2]}),
        ({"cone": {"radius": 0.2, "end_radius": 1.2, "height": 1.0}}, {"position": [0.4, 0.0, 0.8]}),
    ],
    ids=["drum", "disc", "sphere", "cone"],
)
@pytest.mark.parametrize("law", ["", pytest.param("rolling_resistance", marks=pytest.mark.nightly)])
@pytest.mark.slow  # kernels for walls are compiled for a minute
def test_the_work_of_the_wall_closes_the_energy(wall: dict[str, Any], body: dict[str, Any], law: str) -> None:
    contact: dict[str, Any] = {"restitution": 0.7}
    if law:
        contact |= {"law": law, law: {"rolling_friction": 0.1, "twisting_friction": 0.1}}
    run = frames(scene(rotating(wall), body, 0.6, **contact))
    assert kinetic(run[-1]) > 0.0
    # impacts and contacts at rest: rounding of some 1000 sums
    assert unexplained(run) < 1e-11


@pytest.mark.slow  # kernels for walls are compiled for a minute
def test_an_elastic_impact_without_a_normal_force_gains_what_the_wall_does() -> None:
    body = {"position": [0.0, 0.0, 0.0], "velocity": [0.0, 0.0, -1.0]}
    run = frames(scene(rotating(DRUM), body, 1.2, WEIGHTLESS, restitution=1.0))
    gained = kinetic(run[-1]) - kinetic(run[0])
    ledger = run[-1].energy.ledger
    assert -dict(ledger.forces)["walls"] - ledger.friction - ledger.restitution == pytest.approx(gained, rel=1e-12)
    # one impact: J_n = 2 m v, friction μ J_n, at the surface's speed Ω R
    mass = Space(scene(DRUM, body, 1.0)).state.mass[0]
    assert -dict(ledger.forces)["walls"] == pytest.approx(MU * 2.0 * mass * OMEGA * R, rel=1e-12)


@pytest.mark.slow  # kernels for walls are compiled for a minute
def test_impacts_at_the_end_of_a_step_book_the_same_work() -> None:
    body = {"position": [0.0, 0.0, -0.5], "velocity": [0.3, 0.2, 0.0]}
    run = frames(scene(rotating(DRUM), body, 0.5, timing="end-of-step", restitution=0.5))
    assert unexplained(run) < 1e-11


@pytest.mark.slow  # kernels for walls are compiled for a minute
def test_a_wall_that_does_not_rotate_has_the_bits_of_one_without_a_motion() -> None:
    def end(wall: dict[str, Any]) -> FloatArray:
        return frames(scene(wall, {"position": [0.5, 0.0, 0.0]}, 0.3))[-1].position

    assert np.array_equal(end(DRUM), end(rotating(DRUM, 0.0)))


def many(balls: int) -> Scene:
    """Return balls in a drum."""
    front, back = ({"disc": {"radius": R, "centre": [0, y, 0], "normal": [0, 1, 0]}} for y in (-0.3, 0.3))
    return Scene.from_dict(
        {
            "contact": RUBS,
            "gravity": HEAVY,
            "wall": [rotating(DRUM), front, rotating(back)],
            "group": [
                {
                    "count": balls,
                    "radius": 0.05,
                    "region": {"shape": "box", "size": [1.2, 0.4, 1.2]},
                }
            ],
            "time": {"duration": 0.4},
        }
    )


@pytest.mark.slow  # kernels for walls are compiled for a minute
def test_a_drum_has_the_same_bits_on_any_number_of_threads_and_its_walls_do_work() -> None:
    runs = [list(Space(many(60), threads=threads).run(schedule=every(0.05))) for threads in (1, 2)]
    assert [frame.fingerprint for frame in runs[0]] == [frame.fingerprint for frame in runs[1]]
    assert runs[0][-1].energy.ledger == runs[1][-1].energy.ledger
    assert -dict(runs[0][-1].energy.ledger.forces)["walls"] > 0.0


@pytest.mark.slow  # kernels for walls are compiled for a minute
def test_a_run_is_recorded_with_the_work_of_the_wall_replayed_and_resumed(tmp_path: Path) -> None:
    file, longer = tmp_path / "drum.rrd", tmp_path / "longer.rrd"
    carom.run(scene(rotating(DRUM), {"position": BOTTOM}, 0.1), file)
    assert carom.replay(file).same
    assert carom.resume(file, 0.2, longer).finished and carom.replay(longer).same
    work = [carom.Recording.open(each).energy()["walls"].to_numpy()[-1] for each in (file, longer)]
    assert work[1] < work[0] < 0.0


@pytest.mark.parametrize(
    ("wall", "key"),
    [
        ({"rectangle": {"side": [1, 0, 0], "other_side": [0, 1, 0]}, "motion": {"rotation": 1.0}}, "no axis"),
        ({"disc": {"radius": R}, "motion": {}}, "rotation"),
        ({"disc": {"radius": R}, "motion": {"rotation": 1.0, "speed": 2.0}}, "speed"),
        ({"sphere": {"radius": R, "axis": [0, 0, 0]}}, "direction"),
    ],
    ids=["rectangle", "nothing", "unknown", "no-direction"],
)
def test_a_motion_that_a_wall_cannot_have_is_refused(wall: dict[str, Any], key: str) -> None:
    with pytest.raises(SceneError, match=key):
        scene(wall, {}, 1.0)
