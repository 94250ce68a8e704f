"""The numerical extremes: every scene of configs/extremes meets its own criteria."""

from __future__ import annotations

import runpy
import shutil
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from carom.cli.stress import attempt, extremes
from carom.errors import SceneError
from carom.physics.simulation import StepStatus
from carom.physics.space import Space
from carom.runs.outcome import judge
from carom.scene.load import Scene
from small_scenes import cloud

SLOW = (
    "coincident",
    "collapse-10",
    "dense-gas",
    "stack-20",
    "balls-at-rest",
    "friction-ten",
    "hub-400",
    "hub-4000",
    "mass-ratio-squeezed",
    "million-steps",
    "moving-frame",
    "pile-1000",
    "pythagorean",
    "radius-ratio",
)  # a second and a half or more each


MISSED = {"stack-dropped": "slow contacts wait for the end of a step and sink (docs/physics.md, section 9)"}


def cases() -> list[Any]:
    marks: dict[str, list[Any]] = {name: [pytest.mark.slow] for name in SLOW}
    marks["pile-1000"].append(pytest.mark.nightly)
    marks |= {name: [pytest.mark.xfail(reason=why, strict=True)] for name, why in MISSED.items()}
    return [pytest.param(name, marks=marks.get(name, [])) for name in extremes()]


def extreme(name: str, *overrides: str) -> Space:
    return Space(Scene.load(f"extremes/{name}", list(overrides)))


@cache
def ran(name: str) -> Space:
    """Return the space of an extreme at the end of its run, which several tests look at."""
    space = extreme(name)
    run_through(space)
    return space


def run_through(space: Space) -> None:
    for frame in space.run():
        for array in (frame.position, frame.velocity, frame.angular_velocity):
            assert array is None or np.isfinite(array).all(), f"step {frame.step}"


@pytest.mark.parametrize("name", cases())
def test_an_extreme_meets_its_criteria(name: str) -> None:
    if name == "pile-1000":  # its boulders come to rest in the first half of the run
        run_through(space := extreme(name, "time.duration=15000"))
    else:
        space = ran(name)
    assert space.time == space.scene.time.duration
    missed = [
        str(verdict) for verdict in judge(space.scene, space.extremes, space.time, space.state) if not verdict.met
    ]
    assert not missed


def test_extremes_are_compared_with_closed_forms_and_none_may_gain_energy() -> None:
    stated = set()
    for name in extremes():
        expect = Scene.load(f"extremes/{name}").expect
        stated |= {name} if expect.state else set()
        # error of the integrator, or what the solver leaves to contacts at rest; a start that overlaps is lifted
        assert name == "overlapped-gravity" or (expect.energy_gain or 0.0) <= 1e-3
        assert not expect.state or "# Theory: " in extremes()[name].read_text(encoding="utf-8")
    assert len(stated) >= 10


@pytest.mark.parametrize("name", extremes())
def test_an_extreme_promises_energy_and_momentum_and_says_why(name: str) -> None:
    scene = Scene.load(f"extremes/{name}")
    expect = scene.expect
    if not expect.warned:  # a run that must warn cannot be right
        assert expect.energy_error is not None and expect.energy_gain is not None
    assert (expect.momentum_error is None) is scene.anchored, "what stands still takes momentum"
    header = extremes()[name].read_text(encoding="utf-8").partition("title")[0]
    assert "# Look for:" in header and "# Criteria:" in header


def test_the_bodies_of_large_extremes_are_those_that_their_script_writes(tmp_path: Path) -> None:
    folder = extremes()["dense-gas"].parent
    copy = tmp_path / "extremes"
    shutil.copytree(folder, copy)
    runpy.run_path(str(copy / "place.py"), run_name="__main__")
    for path in folder.glob("*.toml"):
        assert (copy / path.name).read_text(encoding="utf-8") == path.read_text(encoding="utf-8"), path.name


def test_one_ball_leaves_the_elastic_chain_and_a_hundred_stay_at_rest() -> None:
    space = ran("elastic-chain")
    assert np.array_equal(space.state.velocity[:, 0], [0.0] * 99 + [1.0, 0.0])  # the striker is the last body


def test_without_friction_no_spin_changes_in_any_bit() -> None:
    space, spins = ran("friction-zero"), extreme("friction-zero").state.angular_velocity
    assert space.extremes.impacts > 100
    assert np.array_equal(space.state.angular_velocity, spins)


def test_the_overlapped_start_is_set_apart_without_any_speed() -> None:
    space = ran("overlapped")
    assert not space.state.velocity.any()
    assert space.contacts.overlaps.max() <= 1e-9 * 2.0  # the stabilisation's own tolerance, of the sum of radii


def test_the_orbit_of_eccentricity_0999_closes() -> None:
    # An error of 4 × 10⁻⁶ of the orbit's energy is one of 6 × 10⁻⁶ of its period of 2 π, twice; at
    # apocentre the comet moves at 0.022 and hardly accelerates.
    space, start = ran("kepler-0999"), extreme("kepler-0999").state.position[1]
    assert np.abs(space.state.position[1] - start).max() <= 0.022 * 2 * 2 * np.pi * 6e-6


@pytest.mark.slow
def test_a_scene_that_moves_as_a_whole_takes_the_same_steps() -> None:
    # Collisions amplify the rounding of velocities at 10⁶ m/s, so late steps may differ a little: 1 %.
    moving, resting = extreme("moving-frame"), extreme("moving-frame", "group.0.velocity.mean=[0.0, 0.0, 0.0]")
    run_through(moving)
    run_through(resting)
    assert moving.step == pytest.approx(resting.step, rel=0.01)


def test_spheres_of_a_nanometre_collapse_like_spheres_of_a_million_kilometres() -> None:
    # The two differ in rounding alone, 10⁻¹⁶ since 10¹⁸ is no power of two, and a pile that forms amplifies that:
    # to the first collisions they are the same to 10⁻⁹, in the end as one collapse is like another. (Scaled by a power
    # of two they are the same to the bit: test_invariance.)
    tiny, huge = extreme("size-tiny"), extreme("size-huge")
    spread = []
    for space, size in ((tiny, 1e-9), (huge, 1e9)):
        *_, frame = space.run(2000.0)
        spread.append(frame.position / size)
    np.testing.assert_allclose(spread[0], spread[1], rtol=0, atol=1e-9)
    run_through(tiny)
    run_through(huge)
    assert tiny.step == pytest.approx(huge.step, rel=0.02)
    lost = [space.energy().ledger.restitution / space.energy().scale for space in (tiny, huge)]
    assert lost[0] == pytest.approx(lost[1], rel=0.05)


def test_a_name_is_known_with_its_folder_and_without() -> None:
    assert list(extremes("mass-ratio")) == list(extremes("extremes/mass-ratio")) == ["mass-ratio"]


def test_an_unknown_name_is_answered_with_the_nearest() -> None:
    with pytest.raises(SceneError, match='no extreme of that name; did you mean "dense-gas"'):
        extremes("dense-gass")


def test_an_extreme_is_recorded_in_place_of_an_earlier_recording(tmp_path: Path) -> None:
    for _ in range(2):
        trial = attempt("just-touching", Scene.load("extremes/just-touching"), tmp_path)
    assert trial.met and not trial.worst and trial.reason == ""
    assert [path.name for path in tmp_path.iterdir()] == ["just-touching.rrd"]


def test_a_missed_criterion_comes_with_its_worst_moment(tmp_path: Path) -> None:
    overrides = ["expect.max_overlap=1e-9", "expect.momentum_error=0.0", "expect.impacts=3"]
    overrides.append("contact.timing=end-of-step")
    trial = attempt("mass-ratio", Scene.load("extremes/mass-ratio", overrides), tmp_path)
    assert not trial.met and trial.status == "expectation missed"
    assert set(trial.worst) == {"max_overlap", "momentum_error"}  # too few impacts have no moment
    overlap = trial.worst["max_overlap"]
    assert overlap.bodies == (0, 2) and 0.0 < overlap.time < 10.0 and overlap.value > 1e-9


def test_a_scene_that_is_refused_says_why(tmp_path: Path) -> None:
    scene = Scene.load("extremes/hub-25", ["contact.timing=time-of-impact", "time.integrator=yoshida4"])
    trial = attempt("hub-25", scene, tmp_path)
    assert not trial.met and trial.status == "refused" and "end-of-step" in trial.reason
    assert not list(tmp_path.iterdir())


def test_a_run_that_stops_being_finite_points_to_its_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    spaces: list[Space] = []

    def keep(*arguments: Any, **options: Any) -> Space:
        spaces.append(Space(*arguments, **options))
        return spaces[0]

    monkeypatch.setattr("carom.runs.run.Space", keep)

    def break_it(status: StepStatus) -> None:
        spaces[0].state.velocity[3] = np.nan

    trial = attempt("cloud", cloud(time={"duration": 3000.0}), tmp_path, watch=break_it)
    assert not trial.met and trial.status == "failed"
    assert trial.worst["the end"].step > 0
