"""Ordinary steps, or the end of a run, where an accuracy can no longer be kept."""

from __future__ import annotations

import pytest

from carom.physics.space import Space
from carom.plan.auto import step_limits
from carom.scene.load import Scene, scene_from_text

HORIZON = 0.1  # s
# a ball that slides on a floor, and one that bounces on it, with steps 4 times shorter than those between frames
TEXT = f"""
[time]
duration = 0.12
accuracy = 1e-6
[gravity]
constant = 0.0
uniform = [0, 0, -9.81]
[contact]
restitution = 0.5
[record]
every = "step"
[[plane]]
[[body]]
position = [0, 0, 0.1]
velocity = [2, 0, 0]
radius = 0.1
[[body]]
position = [0, 2, 0.12]
radius = 0.1
[promise]
refinement = 4.0
until = 0.12
horizon = {HORIZON}
lyapunov = 0.0
error = [1e-7, 1e-5]
"""


def scene(*changes: str) -> Scene:
    return scene_from_text(TEXT, "two balls", list(changes))


@pytest.mark.parametrize("integrator", ["auto", "leapfrog"])
def test_where_an_accuracy_ends_ordinary_steps_go_on_with_the_same_bits_from_any_frame(integrator: str) -> None:
    space = Space(scene(f"time.integrator={integrator}"), 1)
    frames = list(space.run())
    at = next(k for k, frame in enumerate(frames) if frame.time == HORIZON)
    before, after = frames[at - 1].dt, frames[at + 5].dt
    assert frames[at].dt_limit == "horizon"
    assert after > 3.0 * before
    assert after <= step_limits(scene("time.accuracy=", "promise=")).max_dt
    said = [event.text for frame in frames for event in frame.events if event.kind == "horizon"]
    assert said == ["The accuracy of 1e-06 is kept up to t = 0.1 s; ordinary steps go on."]
    for k in (at - 1, at, at + 1):
        again = Space(space.scene, 1)
        again.restore(frames[k].checkpoint)
        *_, last = again.run()
        assert (last.step, last.fingerprint) == (frames[-1].step, frames[-1].fingerprint)


def test_a_run_ends_where_its_accuracy_does_if_the_scene_asks_for_that() -> None:
    space = Space(scene("time.after_horizon=end"), 1)
    *_, last = space.run()
    assert space.time == last.time == HORIZON == space.scene.end
    assert [event.text for event in last.events if event.kind == "horizon"] == [
        "The accuracy of 1e-06 is kept up to t = 0.1 s; the run ends there."
    ]
