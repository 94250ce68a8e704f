"""Errors are judged at instants that follow from the scene: what is recorded changes no verdict."""

from __future__ import annotations

from typing import Any

import pytest

from carom.physics.space import Space
from carom.runs.outcome import judge
from small_scenes import cloud, scene_of

ORBITS = [
    {"position": [x, 0.0, 0.0], "velocity": [0.0, v, 0.0], "mass": 1.0, "radius": 1e-3}
    for x, v in ((-1.0, -0.2), (1.0, 0.2))
]
BOUNCING = [
    {"mass": 1.0, "radius": 0.3, "position": [1.0, 0.2, 0.0]},
    {"mass": 0.5, "radius": 0.2, "position": [-1.0, 0.0, 0.3], "velocity": [0.0, 0.3, 0.0]},
    {"mass": 0.2, "radius": 0.1, "position": [0.0, 1.0, -0.2], "velocity": [0.4, 0.0, 0.1]},
]


def space_of(name: str, every: float | str) -> Space:
    """Make the space of a scene that records at an interval."""
    record = {"every": every, "check_every": 70, "energy_tolerance": 1e-9}
    expect = {"energy_error": 1e-9, "momentum_error": 1e-17, "angular_momentum_error": 1e-17, "max_overlap": 1e-9}
    sections: dict[str, Any] = {"gravity": {"constant": 1.0}, "record": record, "expect": expect}
    if name == "kicks and drifts":
        return Space(cloud(12, time={"duration": 1.0}, record=record, expect=expect), threads=1)
    if name == "free flight":
        del expect["max_overlap"]
        orbits = {"duration": 6.0, "fixed_dt": 4e-3, "integrator": "euler"}
        return Space(scene_of(ORBITS, time=orbits, contact={"enabled": False}, **sections), threads=1)
    return Space(scene_of(BOUNCING, time={"duration": 4.0, "integrator": name}, **sections), threads=1)


@pytest.mark.parametrize(
    "name", ["kicks and drifts", "free flight", pytest.param("gauss-radau15", marks=pytest.mark.slow)]
)
def test_a_verdict_does_not_depend_on_what_is_recorded(name: str) -> None:
    def seen(every: float | str) -> tuple[Any, ...]:
        space = space_of(name, every)
        warnings = [event for frame in space.run() for event in frame.events if event.level == "WARN"]
        return space.extremes, warnings, judge(space.scene, space.extremes, space.time), space.fingerprint()

    extremes, warnings, verdicts, bits = seen("auto")
    assert extremes.energy_error.value > 1e-14
    assert warnings or name == "gauss-radau15"
    for every in ("step", 0.31, 100.0):
        assert seen(every) == (extremes, warnings, verdicts, bits)
