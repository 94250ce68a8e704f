"""A uniform field along a periodic axis, as on a chute that repeats along the flow."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

import carom
from carom.physics.space import Space
from carom.scene.load import Scene
from small_scenes import scene_of

G = [4.905, 0.0, -8.4957]  # m/s², 9.81 m/s² inclined by 30 degrees
SLOPE: dict[str, Any] = {
    "plane": [{}],
    "gravity": {"constant": 0.0, "uniform": G},
    "contact": {"restitution": 0.5, "static_friction": 0.5, "kinetic_friction": 0.4},
    "domain": {"boundary": ["periodic", "periodic", "open"], "size": [1.0, 0.8, 1.0]},
    "time": {"duration": 2.0, "fixed_dt": 1 / 512},
}
BALL: dict[str, Any] = {"position": [0.0, 0.0, 0.1], "radius": 0.1, "mass": 1.5}
BALLS = {
    "count": 12,
    "radius": 0.09,
    "density": 1000.0,
    "region": {"shape": "box", "size": [1.0, 0.8, 0.6], "centre": [0.0, 0.0, 0.4]},
}


def test_a_ball_rolls_down_a_periodic_slope_with_five_sevenths_of_the_field_along_it() -> None:
    space = Space(scene_of([BALL], **SLOPE))
    *_, last = space.run()
    a = 5 / 7 * G[0]
    # the field is constant, so the trapezoidal rule is exact: 1024 steps of round-off
    assert last.velocity[0] == pytest.approx([a * 2.0, 0.0, 0.0], rel=1e-12, abs=1e-12)
    distance = 0.5 * a * 2.0**2  # seven lengths of the box
    assert abs(last.position[0, 0]) <= 0.5
    assert (distance - last.position[0, 0]) % 1.0 == pytest.approx(0.0, abs=1e-11) or (
        distance - last.position[0, 0]
    ) % 1.0 == pytest.approx(1.0, abs=1e-11)
    energy = last.energy
    assert energy.ledger.entry("driving_field") == pytest.approx(-BALL["mass"] * G[0] * distance, rel=1e-12)
    assert energy.field == pytest.approx(-BALL["mass"] * G[2] * 0.1, rel=1e-12)  # only of the height
    assert energy.relative_error < 1e-12


@pytest.mark.parametrize("further", [{}, {"drag": {"relaxation_time": 0.7}}], ids=["vacuum", "drag"])
def test_impacts_friction_and_drag_dissipate_what_the_field_along_a_periodic_slope_supplies(
    further: dict[str, Any],
) -> None:
    ball = BALL | {"position": [0.0, 0.0, 0.6], "velocity": [1.0, -0.7, 0.0]}
    *_, last = Space(scene_of([ball], **SLOPE | further)).run()
    ledger = last.energy.ledger
    assert ledger.entry("driving_field") < -5.0
    assert ledger.restitution > 0.0 and ledger.friction > 0.0
    # bounces, sliding and rolling of one ball are exact in a constant field; drag is solved exactly along its path
    assert last.energy.relative_error < 1e-10


def test_spheres_that_settle_in_a_periodic_box_reach_stokes_velocity_through_all_impacts() -> None:
    tau, size = 0.1, 1.0
    group = {"count": 60, "radius": 0.05, "density": 1000.0, "velocity": {"dispersion": 1.0}}
    scene = Scene.from_dict(
        {
            "gravity": {"constant": 0.0, "uniform": [0.0, 0.0, -9.81]},
            "drag": {"relaxation_time": tau},
            "domain": {"boundary": "periodic", "size": [size] * 3},
            "contact": {"restitution": 0.5},
            "time": {"duration": 4.0},
            "group": [group | {"region": {"shape": "box", "size": [size] * 3}}],
        }
    )
    *_, last = Space(scene).run()
    # exp(-t/τ) = 4e-18 of the first velocities is left, and impacts change no sum of momenta
    assert last.velocity.mean(axis=0) == pytest.approx([0.0, 0.0, -9.81 * tau], abs=1e-12)
    assert last.energy.ledger.restitution > 0.0, "some of them met"
    assert last.energy.relative_error < 1e-12


def test_balls_on_a_periodic_slope_have_the_same_bits_on_any_number_of_threads_and_after_resuming(
    tmp_path: Path,
) -> None:
    document = SLOPE | {"group": [BALLS], "time": {"duration": 0.4, "fixed_dt": 1 / 256}}
    runs = [list(Space(Scene.from_dict(document), threads).run()) for threads in (1, 2)]
    assert [frame.fingerprint for frame in runs[0]] == [frame.fingerprint for frame in runs[1]]
    work = [run[-1].energy.ledger.entry("driving_field") for run in runs]
    assert work[0] == work[1] < 0.0
    short, longer = tmp_path / "short.rrd", tmp_path / "longer.rrd"
    carom.run(Scene.from_dict(document | {"time": {"duration": 0.2, "fixed_dt": 1 / 256}}), short)
    assert carom.resume(short, 0.4, longer).finished
    assert carom.replay(longer).same
    assert carom.Recording.open(longer).energy()["driving_field"].to_numpy()[-1] == work[0]
