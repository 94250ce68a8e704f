"""The impact at which a run diverges from the reference: the recorded number of the first whose outcome differs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from carom.engines.crosscheck.parting import NumberedImpacts, parting_of
from carom.lab.tradeoff.reference import Reference, make_reference
from carom.recording.read.named_events import named_event
from carom.recording.read.recording import Recording
from carom.runs.run import recording_space, simulate
from carom.scene.wording import Names
from small_scenes import scene_of

NAMES = Names(["wall", "ball", "end"], [])


@pytest.fixture(scope="module")
def bounced(tmp_path_factory: pytest.TempPathFactory) -> tuple[Reference, Path]:
    """A light ball between two heavy ones, which it hits in turn."""
    bodies = [
        {"name": name, "position": [x, 0.0, 0.0], "velocity": [v, 0.0, 0.0], "radius": 0.5, "mass": m}
        for name, x, v, m in (("wall", -3.0, 0.0, 1e9), ("ball", 0.0, 4.0, 1.0), ("end", 3.0, 0.0, 1e9))
    ]
    scene = scene_of(bodies, gravity={"constant": 0.0}, contact={"restitution": 1.0}, time={"duration": 6.0})
    path = tmp_path_factory.mktemp("parting") / "carom.rrd"
    simulate(recording_space(scene, 1), path)
    return make_reference(scene), path


@pytest.mark.slow
def test_a_missed_impact_is_named_by_the_number_that_event_takes(bounced: tuple[Reference, Path]) -> None:
    # impacts at 0.5 s, and then every 1 s: of ball and end, wall and ball, in turn; the fourth, at 3.5 s, is missed
    reference, path = bounced
    best, numbered = reference.trajectory, NumberedImpacts.of(path)
    assert best.struck_at == pytest.approx([0.5, 1.5, 2.5, 3.5, 4.5, 5.5], abs=1e-6)
    late = best.time > best.struck_at[3]
    position, velocity = best.position.copy(), best.velocity.copy()
    velocity[late, 1, 0] = velocity[~late, 1, 0][-1]
    position[late, 1, 0] = position[~late, 1, 0][-1] + velocity[late, 1, 0] * (best.time[late] - best.time[~late][-1])
    broken = [(3.6, "missed-impact"), (0.7, "energy")]
    run = replace(best, position=position, velocity=velocity)
    parting = parting_of(run, reference, broken, 0.01, NAMES, numbered)
    assert parting is not None and parting.between == NAMES.pair([0, 1]) and parting.laws == ["missed-impact"]
    event = named_event(Recording.open(path), f"impact:{parting.impact}")
    assert event.pair is not None and (event.pair.i, event.pair.j) == (0, 1)
    assert event.time == pytest.approx(parting.impact_time) == pytest.approx(3.5, abs=1e-6)


def test_an_outcome_that_differs_is_named_though_the_runs_part_after_later_impacts(
    bounced: tuple[Reference, Path],
) -> None:
    # the ball is 5 % too slow from its second impact on, but its path deviates by a hundredth only after its fifth
    reference, path = bounced
    best = reference.trajectory
    late = best.time > best.struck_at[1]
    velocity, position = best.velocity.copy(), best.position.copy()
    velocity[late, 1, 0] *= 0.95
    position[late & (best.time > 4.6), 1, 0] += 0.1
    parting = parting_of(
        replace(best, position=position, velocity=velocity), reference, [], 0.01, NAMES, NumberedImpacts.of(path)
    )
    assert parting is not None and parting.time > 4.6
    assert parting.impact == 2 and parting.impact_time == pytest.approx(1.5, abs=1e-6)


def test_an_impact_that_is_not_on_record_has_no_number_and_none_comes_before_the_first(
    bounced: tuple[Reference, Path],
) -> None:
    reference, path = bounced
    best = reference.trajectory
    shifted = replace(best, position=best.position + 1.0)
    parting = parting_of(shifted, reference, [], 0.0, NAMES, NumberedImpacts.of(path))
    assert parting is not None and parting.impact == 0 and parting.between == ""
    position, none = best.position.copy(), NumberedImpacts.of(path.parent / "none.rrd")
    position[best.time > 4.0] += 1.0
    parting = parting_of(replace(best, position=position), reference, [], 0.0, NAMES, none)
    assert parting is not None and parting.impact is None and parting.between == NAMES.pair([0, 1])


def test_a_pair_that_touches_at_the_start_has_its_impact_when_it_meets_again(bounced: tuple[Reference, Path]) -> None:
    """A refined reference has first contacts only; with these, the outcome of 1.5 s would differ at the start."""
    reference, path = bounced
    best = reference.trajectory
    late = best.time > best.struck_at[1]
    velocity, position = best.velocity.copy(), best.position.copy()
    velocity[late, 1, 0] *= 0.5
    position[late, 1, 0] += 0.5 * velocity[late, 1, 0] * (best.time[late] - best.struck_at[1])
    touching = replace(
        best,
        struck=np.empty((0, 2), np.int64),
        struck_at=np.empty(0),
        pair=np.array([[0, 1], [1, 2]]),
        met=np.array([1e-4, best.struck_at[0]]),
    )
    run, numbered = replace(best, position=position, velocity=velocity), NumberedImpacts.of(path)
    parting = parting_of(run, replace(reference, trajectory=touching), [], 0.01, NAMES, numbered)
    assert parting is not None and parting.impact == 2 and parting.between == NAMES.pair([0, 1])
    assert parting.impact_time == pytest.approx(best.struck_at[1], abs=1e-6)
