"""Many steps in one call have the bits of single steps, in every number that a run yields."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from carom.physics.error import PhysicsError
from carom.physics.frame import Frame
from carom.physics.schedule import Schedule, every
from carom.physics.space import Space
from carom.scene.schema import Scene


def one_by_one(schedule: Schedule) -> Schedule:
    """Return a schedule that is asked after every step, so that a run takes single steps."""

    def asked(step: int, before: float, time: float) -> bool:
        return schedule(step, before, time)

    return asked


def few_bodies(count: int = 3, **sections: dict[str, Any]) -> Scene:
    """Let bodies of unequal masses, one of them fixed, pull each other where nothing can touch."""
    rng = np.random.default_rng(count)
    bodies = [
        {"mass": 0.5 + k, "position": (3.0 * x).tolist(), "velocity": (0.3 * v).tolist(), "radius": 0.1}
        for k, (x, v) in enumerate(rng.normal(size=(count, 2, 3)))
    ]
    bodies[-1] |= {"angular_velocity": [0.1, 0.2, 2.0]}
    document: dict[str, Any] = {
        "time": {"duration": 3.0, "max_dt": 0.01, "integrator": "leapfrog"},
        "gravity": {"constant": 1.0},
        "contact": {"enabled": False},
        "record": {"every": 0.7, "check_every": 37},
        "body": bodies,
    }
    return Scene.from_dict(
        {key: document.get(key, {}) | sections.get(key, {}) for key in document if key != "body"} | {"body": bodies}
    )


def bits(frame: Frame) -> tuple[Any, ...]:
    """Return all that a frame holds; arrays as bytes."""
    energy = frame.energy
    return (
        *(frame.step, frame.time, frame.dt, frame.dt_limit, frame.previous_dt, frame.fingerprint, frame.phase),
        *(energy.translational, energy.gravitational, energy.field, energy.integration_error, energy.scale),
        *(frame.momentum.tobytes(), frame.angular_momentum.tobytes(), frame.acceleration.tobytes()),
        *(frame.momentum_error, frame.angular_momentum_error, frame.expected_error, frame.events, frame.books),
        None if frame.orientation is None else frame.orientation.tobytes(),
    )


def assert_same_run(scene: Scene, least: float = 5.0) -> None:
    """Compare the frames of a run with those of single steps; a call takes at least so many steps on average."""
    interval = scene.record.every
    assert isinstance(interval, float)
    together, alone, calls = Space(scene, threads=1), Space(scene, threads=1), 0
    advance = together._stepper.advance

    def counted(*asked: Any) -> bool:
        nonlocal calls
        calls += 1
        return advance(*asked)

    setattr(together._stepper, "advance", counted)  # noqa: B010 - mypy knows no methods that are replaced
    frames = list(together.run(schedule=every(interval)))
    singly = list(alone.run(schedule=one_by_one(every(interval))))
    assert [bits(frame) for frame in frames] == [bits(frame) for frame in singly]
    assert together.extremes == alone.extremes
    assert calls * least < together.step, "many steps in a call"


@pytest.mark.parametrize("integrator", ["euler", "leapfrog", "leapfrog-dkd", "yoshida4"])
def test_steps_by_the_shortest_time_of_a_pair_are_those_of_single_steps(integrator: str) -> None:
    assert_same_run(few_bodies(time={"integrator": integrator}))


@pytest.mark.parametrize(
    "rule",
    [
        {"fixed_dt": 0.0123},
        {"target_dx": 1e-4, "smoothing": 0.3},
        {"cfl": 0.05, "smoothing": 0.2},
        {"cfl": 0.05, "velocity_limit": "fastest-body"},
        {"target_dx": 1e-5, "cfl": 0.01, "pull_fraction": 0.02, "smoothing": 0.05},
    ],
    ids=" ".join,
)
def test_steps_by_any_limit_are_those_of_single_steps(rule: dict[str, Any]) -> None:
    assert_same_run(few_bodies(time=rule))


def test_steps_in_a_uniform_field_beside_a_fixed_body_are_those_of_single_steps() -> None:
    assert_same_run(few_bodies(gravity={"uniform": [0.0, -1.0, 0.5], "softening": 0.2}))
    scene = few_bodies(4)
    held = tuple(body.model_copy(update={"fixed": k == 1}) for k, body in enumerate(scene.body))
    assert_same_run(scene.model_copy(update={"body": held}))


def test_steps_without_forces_are_those_of_single_steps() -> None:
    assert_same_run(few_bodies(gravity={"constant": 0.0}, time={"fixed_dt": 0.003}))


def test_a_clock_that_stands_still_ends_the_run_with_the_message_of_single_steps() -> None:
    scene = few_bodies(time={"fixed_dt": 1e-3, "duration": 1e16})
    said = []
    for schedule in (every(1e15), one_by_one(every(1e15))):
        space = Space(scene, threads=1)
        space._world.clock.time = 1e15
        with pytest.raises(PhysicsError) as error:
            list(space.run(schedule=schedule))
        said.append(str(error.value))
    assert said[0] == said[1] and "no longer moves the clock" in said[0]


def test_a_run_that_is_continued_from_a_frame_between_calls_has_the_same_bits() -> None:
    scene = few_bodies(time={"target_dx": 1e-4, "smoothing": 0.3})
    whole = list(Space(scene, threads=1).run(schedule=every(0.7)))
    resumed = Space(scene, threads=1)
    resumed.restore(whole[2].checkpoint)
    assert [bits(frame) for frame in resumed.run(schedule=every(0.7))][1:] == [bits(frame) for frame in whole[3:]]
