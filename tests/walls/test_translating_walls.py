"""Planes and walls that move at constant velocity or oscillate: impacts, lifts, belts, and the work of the wall."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq

import carom
from carom import Frame, Scene, Space
from carom.arrays import FloatArray
from carom.errors import SceneError
from carom.physics.schedule import every
from carom.recording.edit.clip import clip

r, M = 0.1, 2.0  # m and kg, of a ball
G, MU = 9.81, 0.3  # m/s² and the coefficient of friction
HEAVY = {"constant": 0.0, "uniform": [0.0, 0.0, -G]}
WEIGHTLESS = {"constant": 0.0}
ON_FLOOR = [0.0, 0.0, r]


def scene(
    solids: dict[str, Any], body: dict[str, Any], duration: float, gravity: dict[str, Any] = HEAVY, **contact: Any
) -> Scene:
    """Return a ball, and planes and walls."""
    rough = {"restitution": 0.0, "static_friction": MU, "kinetic_friction": MU}
    return Scene.from_dict(
        {
            "contact": rough | contact,
            "gravity": gravity,
            "body": [{"radius": r, "mass": M} | body],
            "time": {"duration": duration},
        }
        | solids
    )


def floor(**motion: Any) -> dict[str, Any]:
    """Return a plane that moves."""
    return {"plane": [{"motion": motion}]}


def frames(of: Scene) -> list[Frame]:
    """Return all steps of a run."""
    return list(Space(of).run(schedule=every(0.0)))


def work(frame: Frame) -> float:
    """Return the work in J that moving walls have done."""
    return -dict(frame.energy.ledger.forces)["walls"]


def unexplained(run: list[Frame]) -> float:
    """Return the largest change of the energy that the ledger does not explain, over the work of the wall."""
    return max(abs(frame.energy.integration_error) for frame in run) / max(abs(work(frame)) for frame in run)


@pytest.mark.slow  # kernels for walls are compiled for a minute
def test_a_ball_rides_on_a_lift_that_does_all_of_the_work() -> None:
    # at most half of g, so the ball stays on the floor
    A, f = 0.05, math.sqrt(0.5 * G / 0.05) / (2.0 * math.pi)
    run = frames(scene(floor(amplitude=[0, 0, A], frequency=f, phase="-90 deg"), {"position": [0, 0, r - A]}, 1.3))
    time = np.array([frame.time for frame in run])
    angle = 2.0 * math.pi * f * time - 0.5 * math.pi
    place, speed = A * np.sin(angle), 2.0 * math.pi * f * A * np.cos(angle)
    assert np.array([frame.position[0, 2] for frame in run]) == pytest.approx(r + place, abs=1e-12 * r)
    assert np.array([frame.velocity[0, 2] for frame in run]) == pytest.approx(speed, abs=1e-9 * speed.max())
    gained = M * (G * (place - place[0]) + 0.5 * speed**2)
    # the trapezoidal sum of the work over steps, of which there are 100 in an oscillation
    assert np.array([work(frame) for frame in run]) == pytest.approx(gained, abs=1e-3 * gained.max())
    assert unexplained(run) < 1e-12
    ledger = run[-1].energy.ledger
    assert abs(ledger.restitution) + abs(ledger.friction) < 1e-3 * gained.max()


@pytest.mark.slow  # kernels for walls are compiled for a minute
def test_a_ball_leaves_a_floor_that_falls_faster_than_itself() -> None:
    # twice g: the floor accelerates by -g where A ω² sin θ = g, at θ = 30 degrees
    A = 0.01
    omega = math.sqrt(2.0 * G / A)
    motion = floor(amplitude=[0, 0, A], frequency=omega / (2.0 * math.pi), phase="-90 deg")
    rises = 0.5 * math.pi / omega  # until θ = 0
    leaves = rises + math.pi / 6.0 / omega
    run = frames(scene(motion, {"position": [0, 0, r - A]}, leaves + 0.3 * math.pi / omega))
    speed = A * omega * math.cos(math.pi / 6.0)
    flown = run[-1].time - leaves
    expected = r + A * 0.5 + speed * flown - 0.5 * G * flown * flown
    # the ball leaves within a step of the moment, where its acceleration differs from the floor's by less than 2 g dt ω
    dt = max(frame.dt for frame in run)
    assert run[-1].position[0, 2] == pytest.approx(expected, abs=2.0 * G * dt * flown)
    assert run[-1].position[0, 2] > r + A


@pytest.mark.slow  # kernels for walls are compiled for a minute
def test_a_wall_at_constant_velocity_reflects_a_ball_in_its_own_frame() -> None:
    e, V, v = 0.8, 0.7, -2.0
    smooth = {"restitution": e, "static_friction": 0.0, "kinetic_friction": 0.0}
    run = frames(
        scene(floor(velocity=[0, 0, V]), {"position": [0, 0, 1], "velocity": [0.3, 0, v]}, 1.0, WEIGHTLESS, **smooth)
    )
    meets = (1.0 - r) / (V - v)
    after = V + e * (V - v)
    assert run[-1].velocity[0] == pytest.approx([0.3, 0.0, after], rel=1e-14)
    assert run[-1].position[0, 2] == pytest.approx(r + V * meets + after * (run[-1].time - meets), rel=1e-13)
    assert work(run[-1]) == pytest.approx(M * (after - v) * V, rel=1e-13)
    assert unexplained(run) < 1e-13


def bounces(height: float, e: float, A: float, f: float, phase: float, duration: float) -> tuple[float, float, int]:
    """Return height and velocity of a ball on an oscillating plate after a time, by roots found independently."""
    omega, t, z, v, count = 2.0 * math.pi * f, 0.0, height, 0.0, 0

    def gap(s: float) -> float:
        return z + v * s - 0.5 * G * s * s - r - A * math.sin(omega * (t + s) + phase)

    while True:
        steps = np.linspace(1e-9, duration - t, 4000)
        closed = [k for k in range(1, len(steps)) if gap(steps[k - 1]) > 0.0 >= gap(steps[k])]
        if not closed:
            s = duration - t
            return z + v * s - 0.5 * G * s * s, v - G * s, count
        s = brentq(gap, steps[closed[0] - 1], steps[closed[0]], xtol=1e-16, rtol=1e-15)
        plate = A * omega * math.cos(omega * (t + s) + phase)
        z, v, t = z + v * s - 0.5 * G * s * s, plate - e * (v - G * s - plate), t + s
        count += 1


@pytest.mark.slow  # kernels for walls are compiled for a minute
def test_impacts_with_an_oscillating_plate_are_exact() -> None:
    A, f, phase, e = 0.01, 11.0, 0.4, 0.9
    expected = bounces(0.5, e, A, f, phase, 3.0)
    motion = floor(amplitude=[0, 0, A], frequency=f, phase=phase)
    run = frames(scene(motion, {"position": [0, 0, 0.5]}, 3.0, restitution=e))
    assert expected[2] >= 4
    # errors of a time of impact, 1e-15 s, grow with each bounce by a factor of up to 2 A ω² e/g = 9
    assert (run[-1].position[0, 2], run[-1].velocity[0, 2]) == pytest.approx(expected[:2], rel=1e-7)
    assert unexplained(run) < 1e-12


@pytest.mark.slow  # kernels for walls are compiled for a minute
def test_a_belt_drags_a_ball_until_it_rolls_without_slip() -> None:
    V = 1.0
    run = frames(scene(floor(velocity=[V, 0, 0]), {"position": ON_FLOOR}, 0.4))
    # the ball slides for t = 2 V/(7 μ g), and then moves at 2 V/7 (of its centre; its surface moves with the belt)
    stops = 2.0 * V / (7.0 * MU * G)
    sliding = [frame for frame in run if frame.time < 0.9 * stops]
    assert sliding[-1].velocity[0, 0] == pytest.approx(MU * G * sliding[-1].time, rel=1e-9)
    assert run[-1].velocity[0, 0] == pytest.approx(2.0 / 7.0 * V, rel=1e-9)
    assert run[-1].angular_velocity is not None
    assert run[-1].angular_velocity[0, 1] == pytest.approx(-5.0 / 7.0 * V / r, rel=1e-9)
    assert work(run[-1]) == pytest.approx(M * V * V * 2.0 / 7.0, rel=1e-9)
    assert unexplained(run) < 1e-12


BOX: list[dict[str, Any]] = [
    {"point": [0, 0, 0], "normal": [0, 0, 1]},
    {"point": [0, 0, 1], "normal": [0, 0, -1]},
    {"point": [-0.5, 0, 0], "normal": [1, 0, 0]},
    {"point": [0.5, 0, 0], "normal": [-1, 0, 0]},
    {"point": [0, -0.5, 0], "normal": [0, 1, 0]},
    {"point": [0, 0.5, 0], "normal": [0, -1, 0]},
]


def in_box(motion: dict[str, Any], balls: int = 40) -> dict[str, Any]:
    """Return balls in a box that moves."""
    group = {"count": balls, "radius": 0.07, "region": {"shape": "box", "size": [0.9, 0.9, 0.9], "centre": [0, 0, 0.5]}}
    return {
        "contact": {"restitution": 0.7, "static_friction": MU, "kinetic_friction": MU},
        "gravity": HEAVY,
        "plane": [plane | ({"motion": motion} if motion else {}) for plane in BOX],
        "group": [group],
        "time": {"duration": 0.6, "max_dt": 0.001},
    }


@pytest.mark.slow  # kernels for walls are compiled for a minute
def test_a_box_at_constant_velocity_is_a_box_at_rest_in_its_own_frame() -> None:
    V = np.array([0.3, -0.2, 0.5])
    document = in_box({}, 3)
    moved = in_box({"velocity": V.tolist()}, 3)
    moved["group"] = [document["group"][0] | {"velocity": {"mean": V.tolist()}}]
    ends = [frames(Scene.from_dict(each))[-1] for each in (document, moved)]
    # after some ten bounces, each of which increases the differences by rounding
    shifted = ends[1].position - V * ends[1].time
    assert shifted == pytest.approx(ends[0].position, abs=1e-7)
    assert ends[1].velocity - V == pytest.approx(ends[0].velocity, abs=1e-6)


SHAKEN = {"amplitude": [0.003, 0.0, 0.01], "frequency": 9.0}


@pytest.mark.slow  # kernels for walls are compiled for a minute
@pytest.mark.parametrize("timing", ["time-of-impact", "end-of-step"])
def test_the_work_of_a_shaken_box_closes_the_energy(timing: str) -> None:
    document = in_box(SHAKEN)
    document["contact"] |= {"timing": timing}
    run = frames(Scene.from_dict(document))
    assert max(abs(work(frame)) for frame in run) > 0.0
    assert unexplained(run) < 1e-10  # of some 10⁵ sums


@pytest.mark.slow  # kernels for walls are compiled for a minute
def test_a_shaken_box_keeps_its_balls_and_their_bits_on_any_number_of_threads() -> None:
    scene_of = Scene.from_dict(in_box(SHAKEN, 60))
    runs = [list(Space(scene_of, threads=threads).run(schedule=every(0.05))) for threads in (1, 2)]
    assert [frame.fingerprint for frame in runs[0]] == [frame.fingerprint for frame in runs[1]]
    assert runs[0][-1].energy.ledger == runs[1][-1].energy.ledger
    end = runs[0][-1]
    angle = 2.0 * math.pi * SHAKEN["frequency"] * end.time  # type: ignore[operator]
    inside = end.position - np.array(SHAKEN["amplitude"]) * math.sin(angle) - [0.0, 0.0, 0.5]
    assert np.abs(inside).max() < 0.5 - 0.07 + 0.01


@pytest.mark.slow  # kernels for walls are compiled for a minute
@pytest.mark.parametrize(
    ("wall", "body"),
    [
        ({"cylinder": {"radius": 1.0, "axis": [0, 1, 0]}}, {"position": [0.0, 0.0, -0.9]}),
        ({"disc": {"radius": 1.0}}, {"position": [0.2, 0.0, 0.3]}),
        ({"rectangle": {"side": [1, 0, 0], "other_side": [0, 1, 0]}}, {"position": [0.1, 0.0, 0.3]}),
        ({"sphere": {"radius": 1.0}}, {"position": [0.3, 0.1, 0.2]}),
        ({"cone": {"radius": 0.2, "end_radius": 1.2, "height": 1.0}}, {"position": [0.4, 0.0, 0.8]}),
    ],
    ids=["cylinder", "disc", "rectangle", "sphere", "cone"],
)
def test_walls_of_any_shape_move(wall: dict[str, Any], body: dict[str, Any]) -> None:
    motion = {"velocity": [0.2, 0.0, 0.1], "amplitude": [0.01, 0.0, 0.02], "frequency": 5.0}
    run = frames(scene({"wall": [wall | {"motion": motion}]}, body, 0.5, restitution=0.5))
    assert max(abs(work(frame)) for frame in run) > 0.0
    assert unexplained(run) < 1e-10  # of some 10³ impacts and contacts
    assert run[-1].position[0, 2] > -1.0  # still in or on the wall


@pytest.mark.slow  # kernels for walls are compiled for a minute
def test_a_plane_that_moves_at_no_speed_has_the_bits_of_one_at_rest() -> None:
    def end(solids: dict[str, Any]) -> FloatArray:
        return frames(scene(solids, {"position": [0.0, 0.0, 0.5]}, 0.3))[-1].position

    assert np.array_equal(end({"plane": [{}]}), end(floor(velocity=[0, 0, 0])))


@pytest.mark.slow  # kernels for walls are compiled for a minute
def test_a_run_on_a_moving_plane_is_recorded_replayed_resumed_and_cut(tmp_path: Path) -> None:
    file, longer, part = tmp_path / "shaken.rrd", tmp_path / "longer.rrd", tmp_path / "part.rrd"
    shaken = scene(floor(amplitude=[0, 0, 0.01], frequency=9.0), {"position": [0, 0, 0.2]}, 0.5, restitution=0.6)
    carom.run(shaken, file)
    assert carom.replay(file).same
    assert carom.resume(file, 0.8, longer).finished and carom.replay(longer).same
    clip(longer, part, 0.3, 0.6)
    assert carom.replay(part).same


@pytest.mark.parametrize(
    ("motion", "message"),
    [
        ({}, "add rotation, velocity, times and velocities, or an amplitude"),
        ({"amplitude": [0, 0, 1]}, "amplitude without frequency"),
        ({"frequency": 3.0}, "frequency without amplitude"),
        ({"velocity": [1, 0, 0], "phase": 0.1}, "phase without amplitude"),
        ({"rotation": 1.0}, "plane, which has no axis"),
        ({"times": [0.5], "velocities": [[0, 0, 1], [0, 0, 0]]}, "1 times and 2 velocities"),
        ({"times": [0.5, 0.5], "velocities": [[0, 0, 1], [0, 0, 0]]}, "do not ascend"),
        ({"times": [0.5], "velocities": [[0, 0, 1]], "velocity": [1, 0, 0]}, "velocity and velocities"),
        ({"amplitude": [0, 0, 1], "frequency": 0.0}, "frequency"),
    ],
)
def test_a_motion_that_is_none_is_refused(motion: dict[str, Any], message: str) -> None:
    with pytest.raises(SceneError, match=message):
        scene(floor(**motion), {}, 1.0)


@pytest.mark.parametrize(
    ("section", "message"),
    [
        ({"drag": {"relaxation_time": 1.0}}, "drag"),
        ({"time": {"duration": 1.0, "accuracy": 1e-6}}, "time.accuracy"),
        ({"time": {"duration": 1.0, "integrator": "gauss-radau15"}}, "gauss-radau15"),
    ],
    ids=["drag", "accuracy", "integrator"],
)
def test_what_does_not_know_moving_planes_is_refused(section: dict[str, Any], message: str) -> None:
    with pytest.raises(SceneError, match=message):
        Space(scene(floor(velocity=[0, 0, 1]) | section, {}, 1.0))
