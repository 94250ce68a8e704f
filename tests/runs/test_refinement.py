"""Shorter steps tell the same story of a scene that is right, and another of one whose outcome depends on the step."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

import carom
from carom.recording.read.recording import Recording
from carom.runs.refinement import Refinement, refine
from carom.scene.load import Scene
from small_scenes import pair, scene_of

FEW = 20  # instants


def observables(result: Refinement) -> set[str]:
    return {moved.observable for moved in result.moved}


@pytest.mark.parametrize("name", ["two-spheres", "billiards", "newtons-cradle", "kepler-orbits", "bouncing-ball"])
def test_shorter_steps_tell_the_same_story_of_bundled_scenes(name: str) -> None:
    """Impacts at exact times, a loaded impact with friction, simultaneous impacts, orbits, and bounces in a field."""
    result = refine(Scene.load(name, ["time.duration=0.6"] if name == "billiards" else []), threads=1, instants=FEW)
    assert result.same, [moved.text() for moved in result.moved]
    assert result.compared > 0.8 and result.refined_steps > 3.9 * result.steps


def late(**time: Any) -> Scene:
    """Build two spheres that meet in the middle of a step, off centre, and are pushed apart at its end."""
    return pair(offset=1.0, time={"duration": 3.0, **time}, contact={"timing": "end-of-step", "static_friction": 0.0})


def test_an_impact_at_the_end_of_a_step_overlaps_less_with_shorter_steps() -> None:
    result = refine(late(fixed_dt=0.25), threads=1)
    assert not result.same and observables(result) >= {"overlap"}
    overlap = next(moved for moved in result.moved if moved.observable == "overlap")
    assert overlap.bodies == (0, 1) and overlap.run > overlap.refined + 0.02, (
        "a step moves the spheres by half a radius"
    )
    assert overlap.begin < 1.2 < overlap.time, "the moment at which they meet, 4 - 2 t = √3"
    assert refine(late(fixed_dt=0.0005), threads=1, instants=FEW).same, "the same method, with a step that is fine"


def test_an_orbit_of_first_order_drifts() -> None:
    """Semi-implicit Euler at 30 steps an orbit; the same steps of leapfrog are wrong by less than the tolerance."""
    bodies: list[dict[str, Any]] = [{"mass": 1.0, "fixed": True, "radius": 0.01}]
    bodies.append({"position": [1.0, 0.0, 0.0], "velocity": [0.0, 1.2, 0.0], "mass": 1e-9, "radius": 0.01})
    gravity, contact = {"constant": 1.0}, {"enabled": False}

    def orbit(**time: Any) -> Refinement:
        scene = scene_of(bodies, time={"duration": 3.0, **time}, gravity=gravity, contact=contact)
        return refine(scene, threads=1, instants=FEW)

    assert observables(orbit(fixed_dt=0.03, integrator="euler")) & {"distance covered", "velocity"}
    assert orbit(fixed_dt=0.003, integrator="leapfrog").same


def test_chaos_is_no_fault() -> None:
    """Forty elastic spheres collide so often that rounding decides where they are at the end."""
    scene = Scene.from_dict(
        {
            "seed": 2,
            "time": {"duration": 20.0},
            "gravity": {"constant": 0.0},
            "domain": {"boundary": "periodic", "size": [4.0, 4.0, 4.0]},
            "contact": {"restitution": 1.0, "static_friction": 0.0},
            "group": [
                {
                    "count": 40,
                    "radius": 0.3,
                    "density": 1.0,
                    "region": {"shape": "box", "size": [4.0, 4.0, 4.0]},
                    "velocity": {"dispersion": 1.0},
                }
            ],
        }
    )
    result = refine(scene, threads=1, instants=100)
    assert result.same and result.windows > 5, "windows end when twins part"
    assert result.compared > 0.2


def test_a_ball_that_slides_and_then_rolls_loses_the_same_energy_with_shorter_steps() -> None:
    """The end of sliding lies within a step."""
    result = refine(
        scene_of(
            [{"position": [0.0, 0.0, 0.1], "velocity": [1.0, 0.0, 0.0], "radius": 0.1}],
            time={"duration": 0.3},
            gravity={"constant": 0.0, "uniform": [0.0, 0.0, -9.81]},
            contact={"restitution": 0.0, "static_friction": 0.2, "kinetic_friction": 0.2},
            plane=[{}],
        ),
        threads=1,
        instants=FEW,
    )
    assert result.same and result.compared == 1.0


def test_a_heavy_ball_that_a_correction_lifts_by_a_hundred_millionth_is_no_fault() -> None:
    """A stack between two walls, found by a hunt; the heavy ball rests on the light one, 3e-6 radii deep."""
    radius = 0.1778279
    result = refine(
        scene_of(
            [
                {"position": [0.0, 0.0, -0.177828], "radius": radius},
                {"position": [0.0, 0.0, 0.177828], "radius": radius, "mass": 20000.0},
            ],
            time={"duration": 0.007},
            gravity={"constant": 0.0, "uniform": [0.0, 0.0, -2.0]},
            contact={"restitution": 0.0, "static_friction": 0.0},
            domain={"boundary": "walls", "size": [0.4, 0.4, 0.7113118]},
        ),
        threads=1,
        instants=FEW,
    )
    assert result.same


def test_what_sweeps_leave_to_a_heavy_ball_on_a_light_one_is_no_fault() -> None:
    """Found by a hunt: contacts still close by 1e-8 of g dt, which is 3e-12 J of the heavy ball."""
    result = refine(
        scene_of(
            [
                {"position": [0.0, 0.0, 18.0], "radius": 18.0, "mass": 0.01},
                {"position": [0.0, 0.0, 92.0], "radius": 56.0},
            ],
            time={"duration": 0.11},
            gravity={"constant": 0.0, "uniform": [0.0, 0.0, -0.56]},
            contact={"static_friction": 0.0, "stabilisation": "none", "restitution": 0.0},
            plane=[{}],
        ),
        threads=1,
    )
    assert result.same


@pytest.mark.parametrize(
    "balls, ratio, gap, e, gravity", [(5, 5.623, 0.01, 0.0, 0.316), (4, 10.0, 0.001, 0.5, 0.003162)]
)
def test_a_column_that_buckles_under_ever_heavier_balls_is_no_fault(
    balls: int, ratio: float, gap: float, e: float, gravity: float
) -> None:
    """Found by hunts: loads that change from step to step, and what they do to the impacts of the lightest ball."""
    result = refine(
        scene_of(
            [
                {"position": [0.001 * (k % 2), 0.0, 1.0 + gap + (2.0 + gap) * k], "radius": 1.0, "mass": ratio**k}
                for k in range(balls)
            ],
            time={"duration": 2.7 if e > 0.0 else 1.07},
            gravity={"constant": 0.0, "uniform": [0.0, 0.0, -gravity]},
            contact={"restitution": e, "static_friction": 0.0},
            plane=[{}],
        ),
        threads=1,
    )
    assert result.same, [moved.text() for moved in result.moved]


@pytest.mark.slow  # it compiles kernels that no cheaper test needs
def test_a_ball_whose_rolling_turns_or_ends_within_a_step_is_no_fault() -> None:
    """The torque that resists rolling lags behind the axis that turns, an error of first order."""
    for speed, turn in ((0.3, 0.0), (0.3, -9.0)):
        result = refine(
            scene_of(
                [
                    {
                        "position": [0.0, 0.0, 0.1],
                        "velocity": [speed, 0.0, 0.0],
                        "angular_velocity": [3.0, turn, 2.0],
                        "radius": 0.1,
                    }
                ],
                time={"duration": 0.6},
                gravity={"constant": 0.0, "uniform": [0.0, 0.0, -9.81]},
                contact={
                    "restitution": 0.0,
                    "static_friction": 0.3,
                    "kinetic_friction": 0.3,
                    "law": "rolling_resistance",
                    "rolling_resistance": {"rolling_friction": 0.1, "twisting_friction": 0.1},
                },
                plane=[{}],
            ),
            threads=1,
            instants=FEW,
        )
        assert result.same, [moved.text() for moved in result.moved]


def test_a_part_of_a_recording_is_compared_from_the_checkpoint_before(tmp_path: Path) -> None:
    recording = carom.run(late(fixed_dt=0.25), tmp_path / "late.rrd", threads=1)
    assert not refine(recording, 4.0, 0.0, 2.0, threads=1).same
    early = refine(Recording.open(recording.path), 4.0, 0.0, 0.8, threads=1)
    assert early.same and early.end == 0.75 and early.differs is None, "the spheres meet later"
    late_part = refine(recording, 4.0, 2.0, threads=1)
    assert late_part.begin == 1.0 and late_part.end == 3.0 and late_part.moved[0].begin >= 1.0


def test_a_factor_of_one_is_refused() -> None:
    with pytest.raises(ValueError, match="more than 1"):
        refine(pair(), 1.0)
