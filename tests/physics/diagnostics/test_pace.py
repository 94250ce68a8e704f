"""A run whose steps become many times as many as its start promised says so, once."""

from __future__ import annotations

from carom.physics.diagnostics.run_monitor import PaceMonitor, remedies_of
from carom.physics.space import Space
from small_scenes import scene_of


def test_a_run_that_crawls_says_what_sets_the_step_since_when_and_what_to_raise() -> None:
    watch = PaceMonitor(duration=100.0, first_dt=1e-2)  # promises 10⁴ steps
    assert watch.check(1000, 10.0, 1e-2, "velocity") is None
    assert watch.check(1100, 10.1, 1e-4, "held") is None, "few steps so far: it may pass"
    warning = watch.check(50_000, 15.0, 1e-4, "held")
    assert warning is not None and (warning.level, warning.kind) == ("WARN", "pace")
    # Kept up, 50 000 in 15 s make 3.3 × 10⁵; the present step alone would make 9 × 10⁵.
    for said in (
        "limit held",
        "100 times shorter",
        "since t = 10.1 s",
        "3.33e+05 steps",
        "33.3 times",
        "time.target_dx",
    ):
        assert said in warning.text
    assert watch.check(60_000, 16.0, 1e-4, "held") is None, "once a run"


def test_where_held_bodies_set_the_step_the_remedy_makes_fewer_steps() -> None:
    bodies = [{"position": [0, 0, -2]}, {"position": [9, 0, -2]}]  # of 1 m, at rest on a floor
    field, floor = {"constant": 0.0, "uniform": [0, 0, -9.81]}, [{"point": [0, 0, -3]}]
    steps = []
    for target in ({}, {"target_dx": 0.006}, {"target_dx": 0.011}):
        scene = scene_of(bodies, time={"duration": 30.0} | target, gravity=field, plane=floor)
        space = Space(scene)
        for _ in space.run():
            pass
        steps.append(space.step)
    assert remedies_of(scene)["held"].endswith("more than 1 % of the smallest radius")
    automatic, small, large = steps
    assert large < automatic < small


def test_steps_that_were_short_for_a_while_are_no_crawl() -> None:
    watch = PaceMonitor(duration=100.0, first_dt=1e-2)
    watch.check(60_000, 6.0, 1e-4, "velocity")
    again = PaceMonitor(duration=100.0, first_dt=1e-2)
    assert again.check(60_000, 6.0, 1e-2, "velocity") is None
    assert again.tally.slow_since is None


def test_a_run_of_few_steps_is_not_worth_a_warning() -> None:
    assert PaceMonitor(duration=1.0, first_dt=1e-2).check(5000, 0.5, 1e-4, "velocity") is None


def test_an_accuracy_is_what_to_raise_where_it_sets_the_step() -> None:
    field, drag = {"uniform": [0.0, 0.0, -9.81]}, {"relaxation_time": 1.0}
    falling = scene_of(
        [{}], time={"duration": 1.0, "accuracy": 1e-4}, gravity=field, drag=drag, plane=[{"point": [0, 0, -3]}]
    )
    assert set(remedies_of(falling).values()) == {"time.accuracy"}
    free = scene_of([{}], time={"duration": 1.0, "accuracy": 1e-4}, gravity={"constant": 0.0})
    assert remedies_of(free) == {}, "its flights are exact with the longest steps"
    bounces = scene_of([{}], time={"duration": 1.0, "accuracy": 1e-4}, gravity=field, plane=[{"point": [0, 0, -3]}])
    assert remedies_of(bounces) == {}, "a cap may be that of leapfrog, which holds contacts at rest"
    orbit = scene_of([{}, {"position": [9, 0, 0]}], time={"accuracy": 1e-4}, contact={"enabled": False})
    assert remedies_of(orbit) == {"cap": "time.max_dt"}
    watch = PaceMonitor(duration=100.0, first_dt=1e-2, remedies={})
    warning = watch.check(50_000, 15.0, 1e-4, "velocity")
    assert warning is not None and "raise" not in warning.text
