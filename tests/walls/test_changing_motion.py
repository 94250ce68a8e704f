"""Walls whose velocity changes at given times, and walls that rotate and translate at once."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import carom
from carom import Frame, Scene, Space
from carom.arrays import FloatArray
from carom.physics.schedule import every

r, M, G, MU = 0.1, 2.0, 9.81, 0.3  # m and kg, of a ball; m/s²; the coefficient of friction


def run_of(document: dict[str, Any]) -> list[Frame]:
    """Return all steps of a run with a ball of radius r."""
    rough = {"restitution": 0.0, "static_friction": MU, "kinetic_friction": MU}
    given = {"contact": rough, "gravity": {"constant": 0.0, "uniform": [0.0, 0.0, -G]}}
    return list(Space(Scene.from_dict(given | document)).run(schedule=every(0.0)))


def ball(z: float, **more: Any) -> list[dict[str, Any]]:
    """Return a ball above the origin."""
    return [{"radius": r, "mass": M, "position": [0.0, 0.0, z]} | more]


def work(frame: Frame) -> float:
    """Return the work in J that moving walls have done."""
    return -dict(frame.energy.ledger.forces)["walls"]


def unexplained(run: list[Frame]) -> float:
    """Return the largest change of the energy that the ledger does not explain, over the work of the wall."""
    return max(abs(frame.energy.integration_error) for frame in run) / max(abs(work(frame)) for frame in run)


TIMES, SPEEDS = (0.13, 0.31, 0.77, 1.2), (1.5, -0.8, 0.9, 0.0)  # s and m/s, of a piston
TOP, FLIES = 1.4, -2.0  # m, the height of a wall at rest; m/s, of the ball at the start


def height_of_piston(time: float) -> float:
    """Return the integral of the speeds, in m."""
    ends = [*TIMES[1:], np.inf]
    return sum(v * max(0.0, min(time, end) - at) for at, end, v in zip(TIMES, ends, SPEEDS, strict=True))


def bounces(e: float, duration: float) -> tuple[float, float, int]:
    """Return height, velocity and impacts of a weightless ball between a piston and a wall, by linear equations."""
    t, z, v, count = 0.0, 0.7, FLIES, 0
    while True:
        best, after = duration - t, v
        for begin, end, speed in zip((0.0, *TIMES), (*TIMES, np.inf), (0.0, *SPEEDS), strict=True):
            if end > t and v < speed:
                start = max(begin, t)
                s = (z + v * (start - t) - r - height_of_piston(start)) / (speed - v)
                if 0.0 <= s <= end - start and start - t + s < best:
                    best, after = start - t + s, speed - e * (v - speed)
        if v > 0.0 and (TOP - r - z) / v < best:
            best, after = (TOP - r - z) / v, -e * v
        z, t = z + v * best, t + best
        if after == v:
            return z, v, count
        v, count = after, count + 1


@pytest.mark.slow  # kernels for walls are compiled for a minute
@pytest.mark.parametrize("step", [{}, {"fixed_dt": 0.017}], ids=["chosen step", "fixed step"])
def test_impacts_with_a_piston_that_changes_its_velocity_are_exact(step: dict[str, float]) -> None:
    e = 0.8
    smooth = {"restitution": e, "static_friction": 0.0, "kinetic_friction": 0.0}
    velocities = [[0.0, 0.0, speed] for speed in SPEEDS]
    motion = {"times": list(TIMES), "velocities": velocities}
    planes = [{"motion": motion}, {"point": [0, 0, TOP], "normal": [0, 0, -1]}]
    box = {"plane": planes, "body": ball(0.7, velocity=[0, 0, FLIES]), "time": {"duration": 2.0} | step}
    run = run_of(box | {"contact": smooth, "gravity": {"constant": 0.0}})
    expected = bounces(e, 2.0)
    assert expected[2] >= 5
    assert (run[-1].position[0, 2], run[-1].velocity[0, 2]) == pytest.approx(expected[:2], rel=1e-12)
    assert unexplained(run) < 1e-12
    ends = {frame.time: frame.dt_limit for frame in run}
    assert [ends.get(time) for time in TIMES] == ["motion"] * len(TIMES)  # to the last bit


@pytest.mark.slow  # kernels for walls are compiled for a minute
@pytest.mark.parametrize("e", [0.0, 0.5])
def test_a_floor_that_jerks_up_hits_the_ball_that_rests_on_it(e: float) -> None:
    V, begins = 2.0, 0.1
    lift = {"plane": [{"motion": {"times": [begins], "velocities": [[0, 0, V]]}}]}
    contact = {"restitution": e, "static_friction": 0.0, "kinetic_friction": 0.0}
    run = run_of(lift | {"body": ball(r), "contact": contact, "time": {"duration": begins + 0.01}})
    before = [frame for frame in run if frame.time <= begins]
    assert np.abs([frame.velocity[0, 2] for frame in before]).max() < 1e-12
    # an impact at the closing speed V; with e = 0 the ball rides on the floor
    left = (1.0 + e) * V - (G * (run[-1].time - begins) if e > 0.0 else 0.0)
    assert run[-1].velocity[0, 2] == pytest.approx(left, rel=1e-9)
    assert run[-1].energy.ledger.restitution == pytest.approx(0.5 * M * V * V * (1.0 - e * e), rel=1e-3)
    assert unexplained(run) < 1e-12


@pytest.mark.slow  # kernels for walls are compiled for a minute
def test_a_ball_leaves_a_lift_that_stops() -> None:
    V, stops = 1.5, 0.3
    lift = {"plane": [{"motion": {"times": [0.0, stops], "velocities": [[0, 0, V], [0, 0, 0]]}}]}
    run = run_of(lift | {"body": ball(r), "time": {"duration": 0.5}})
    flown = run[-1].time - stops
    top = r + V * stops + V * flown - 0.5 * G * flown * flown
    assert run[-1].position[0, 2] == pytest.approx(top, rel=1e-9)
    assert work(run[-1]) == pytest.approx(M * V * V + M * G * V * stops, rel=1e-9)  # half of M V² is lost
    assert unexplained(run) < 1e-12


@pytest.mark.slow  # kernels for walls are compiled for a minute
def test_a_run_is_resumed_between_two_changes_and_replayed_with_the_same_bits(
    tmp_path: Path,
) -> None:
    motion = {"times": [0.05, 0.2], "velocities": [[0, 0, 1.0], [0.5, 0, -0.3]]}
    scene = Scene.from_dict(
        {
            "plane": [{"motion": motion}],
            "gravity": {"constant": 0.0, "uniform": [0.0, 0.0, -G]},
            "body": ball(r),
            "time": {"duration": 0.3},
        }
    )
    file, longer = tmp_path / "lift.rrd", tmp_path / "longer.rrd"
    carom.run(scene.changed(["time.duration=0.1"]), file)
    assert carom.resume(file, 0.3, longer).finished and carom.replay(longer).same


DISC = {"disc": {"radius": 3.0}}


def on_turntable(start: FloatArray, **motion: Any) -> list[Frame]:
    """Return the run of a ball that rolls on a turntable; it starts at a velocity (m/s), without spin."""
    disc = {"wall": [DISC | {"motion": {"rotation": 2.0} | motion}]}
    body = [{"radius": r, "mass": M, "position": [0.5, 0.0, r], "velocity": start.tolist()}]
    return run_of(disc | {"body": body, "time": {"duration": 1.0, "max_dt": 0.002}})


@pytest.mark.nightly
@pytest.mark.slow  # kernels for walls are compiled for a minute
@pytest.mark.parametrize(
    "motion",
    [
        {"velocity": [0.4, -0.3, 0.0]},
        {"times": [0.0], "velocities": [[0.4, -0.3, 0.0]]},
        {"velocity": [0.0, 0.0, 0.6]},
    ],
    ids=["sideways", "from the first moment", "upwards"],
)
def test_a_turntable_at_constant_velocity_is_one_at_rest_in_its_own_frame(motion: dict[str, Any]) -> None:
    V = np.array(motion.get("velocity") or motion["velocities"][0])
    start = np.array([0.1, 0.2, 0.0])
    still, moved = on_turntable(start), on_turntable(start + V, **motion)
    assert moved[-1].time == still[-1].time
    # the iterations of friction end at changes of 1e-8 of a velocity, in each of 500 steps
    assert moved[-1].position - V * moved[-1].time == pytest.approx(still[-1].position, abs=1e-6)
    assert moved[-1].velocity - V == pytest.approx(still[-1].velocity, abs=1e-6)
    assert unexplained(moved) < 1e-10


@pytest.mark.nightly
@pytest.mark.slow  # kernels for walls are compiled for a minute
def test_bounces_in_a_drum_that_rotates_and_shakes_close_the_energy() -> None:
    motion = {"rotation": 8.0, "amplitude": [0.01, 0.0, 0.02], "frequency": 7.0}
    drum = {"wall": [{"cylinder": {"radius": 1.0, "axis": [0, 1, 0]}, "motion": motion}]}
    contact = {"restitution": 0.7, "static_friction": MU, "kinetic_friction": MU}
    run = run_of(drum | {"body": ball(0.5, velocity=[1.0, 0.2, 0.0]), "contact": contact, "time": {"duration": 1.5}})
    assert abs(work(run[-1])) > 0.1
    assert unexplained(run) < 1e-11


@pytest.mark.slow  # kernels for walls are compiled for a minute
@pytest.mark.parametrize("kind", ["cylinder", "rectangle"])
def test_walls_along_a_periodic_axis_are_endless(kind: str) -> None:
    walls = {
        "cylinder": [{"cylinder": {"radius": 0.5, "axis": [0, 1, 0], "point": [0, 0, 0.4]}}],
        "rectangle": [{"rectangle": {"side": [0, 0.8, 0], "other_side": [4, 0, 0]}}],
    }
    body = ball(0.3, velocity=[0.4, 1.7, 0.0])
    ends = []
    for boundary, size in (("open", 8), ("periodic", 0.8)):
        domain = {"boundary": ["open", boundary, "open"], "size": [1, size, 1]} if boundary == "periodic" else {}
        longer = {"rectangle": {"side": [0, 8, 0], "other_side": [4, 0, 0]}}
        wall = [longer] if kind == "rectangle" and not domain else walls[kind]
        scene = {"wall": wall, "body": body, "contact": {"restitution": 0.9}, "time": {"duration": 1.5}}
        ends.append(run_of(scene | ({"domain": domain} if domain else {}))[-1])
    still, periodic = (end.position[0] for end in ends)
    laps = (still[1] - periodic[1]) / 0.8
    assert laps > 1.0
    assert laps == pytest.approx(round(laps), abs=1e-9)
    assert periodic[[0, 2]] == pytest.approx(still[[0, 2]], abs=1e-9)
