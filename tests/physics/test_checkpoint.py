"""A run can be left at any frame and taken up again: it goes on with the same bits."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from carom.physics.schedule import every
from carom.physics.space import Space
from carom.scene.load import Scene
from carom.state.frame import Frame
from scene_strategies import documents, scene_from
from small_scenes import cloud

STEPS = 40
EXTREMES = ("stack-20", "mass-ratio-squeezed", "friction-ten", "overlapped")


def run_of(scene: Scene, steps: int, threads: int | None = None) -> list[Frame]:
    """The first steps of a scene, a frame each."""
    return list(itertools.islice(Space(scene, threads).run(schedule=every(0.0)), steps + 1))


def taken_up(scene: Scene, frame: Frame, steps: int, threads: int | None = None) -> list[Frame]:
    """What follows a frame in a space that has never been there."""
    space = Space(scene, threads)
    space.restore(frame.checkpoint)
    return list(itertools.islice(space.run(schedule=every(0.0)), steps + 1))


def assert_same_run(once: list[Frame], again: list[Frame]) -> None:
    assert [frame.step for frame in once] == [frame.step for frame in again]
    for one, other in zip(once, again, strict=True):
        assert one.fingerprint == other.fingerprint, f"step {one.step}"
        assert one.energy == other.energy
        assert one.books == other.books
        assert one.momentum_error == other.momentum_error
        assert one.angular_momentum_error == other.angular_momentum_error
    for one, other in zip(once[1:], again[1:], strict=True):  # the frame gone back to shows no contacts
        assert (one.dt, one.dt_limit, one.phase, one.sweeps) == (other.dt, other.dt_limit, other.phase, other.sweeps)
        assert np.array_equal(one.contacts.pairs, other.contacts.pairs)
        assert np.array_equal(one.contacts.overlaps, other.contacts.overlaps)
        for name in ("torque", "angular_acceleration"):
            assert (getattr(one, name) is None) == (getattr(other, name) is None)
            assert np.array_equal(getattr(one, name), getattr(other, name)) or getattr(one, name) is None


# All bundled scenes go on from a checkpoint in tests/runs/test_resume.py.
@pytest.mark.parametrize(
    "name", ["asteroid-belt", "figure-eight", "incline", *(f"extremes/{name}" for name in EXTREMES)]
)
def test_a_bundled_scene_goes_on_from_any_frame_with_the_same_bits(name: str) -> None:
    scene = Scene.load(name)
    run = run_of(scene, STEPS)
    for step in (0, 1, STEPS // 2):
        assert_same_run(run[step:], taken_up(scene, run[step], STEPS - step))


VARIANTS: list[dict[str, Any]] = [
    {"contact": {"solver": "staged"}},
    {"contact": {"colouring": "bodies"}},
    {"contact": {"stabilisation": "baumgarte"}},
    {"contact": {"stabilisation": "none"}},
    {"contact": {"search": "k-d-tree"}},
    {"contact": {"timing": "time-of-impact"}},
    {"contact": {"timing": "time-of-impact", "solver": "staged"}},
    {"contact": {"timing": "time-of-impact"}, "time": {"integrator": "euler"}},
    {"contact": {"static_friction": 0.0, "kinetic_friction": 0.0}},
    {"time": {"integrator": "euler"}},
    {"time": {"integrator": "yoshida4"}},
    {"time": {"fixed_dt": 0.01}},
    {"gravity": {"method": "tree"}},
    {"gravity": {"method": "fast-multipole"}},
    {"gravity": {"uniform": [0.0, 0.0, -1.0]}, "plane": [{"point": [0, 0, -4], "normal": [0, 0, 1]}]},
    {"gravity": {"constant": 0.0}, "domain": {"boundary": "periodic", "size": [7.0, 7.0, 7.0]}},
    {"gravity": {"uniform": [0.0, 0.0, -1.0]}, "domain": {"boundary": "walls", "size": [7.0, 7.0, 7.0]}},
]


@pytest.mark.parametrize("variant", VARIANTS, ids=str)
def test_every_method_goes_on_with_the_same_bits(variant: dict[str, Any]) -> None:
    scene = cloud(**variant)
    run = run_of(scene, 300)
    assert any(len(frame.contacts) for frame in run[:150]), "contacts are under way where it is left"
    assert_same_run(run[150:], taken_up(scene, run[150], 150))


def test_a_resumed_run_has_the_same_bits_on_any_number_of_threads() -> None:
    scene = cloud(60)
    run = run_of(scene, 100, threads=1)
    for threads in (2, 4):
        assert_same_run(run[50:], taken_up(scene, run[50], 50, threads))


@pytest.mark.parametrize("time", [{"fixed_dt": 0.01}, {"smoothing": 0.3}], ids=str)
def test_drift_kick_drift_goes_on_with_the_same_bits_whatever_is_looked_at(time: dict[str, Any]) -> None:
    # its forces are of the middle of the step: no energy that is asked for at the end may put others in their place
    scene = cloud(time={"duration": 1.0, **time, "integrator": "leapfrog-dkd"}, contact={"enabled": False})
    run = run_of(scene, STEPS)
    assert_same_run(run[7:], taken_up(scene, run[7], STEPS - 7))
    unseen, seen = Space(scene), Space(scene)
    for step in range(1, STEPS + 1):
        unseen.compute_dynamics(step)
        seen.compute_dynamics(step)
        seen.energy(), seen.frame()
    assert unseen.fingerprint() == seen.fingerprint() == run[STEPS].fingerprint


@settings(max_examples=40, deadline=None)
@given(document=documents(), step=st.integers(0, 30))
def test_a_random_scene_goes_on_from_any_step_with_the_same_bits(document: dict[str, Any], step: int) -> None:
    scene = scene_from(document)
    run = run_of(scene, 30)
    left = min(step, len(run) - 1)
    assert_same_run(run[left:], taken_up(scene, run[left], len(run) - 1 - left))
