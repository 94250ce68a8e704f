"""Bodies that enter and leave during a run, against closed forms; their number is constant."""

from __future__ import annotations

import math
import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import carom
from carom import Frame, Recording, Scene, Space
from carom.arrays import FloatArray
from carom.display import close_up
from carom.display.presentation import presentation
from carom.engines.engine import problem_of
from carom.errors import ExperimentError, PhysicsError, RecordingError, SceneError
from carom.lab.tradeoff.tradeoff import Study
from carom.physics.placement import place
from carom.physics.schedule import every
from carom.plan.features import require
from carom.recording.edit.clip import clip
from carom.recording.layout import CLOSE_UP
from carom.recording.read.named_events import pair_of_extreme
from carom.runs.recomputed import snapshots
from carom.runs.refinement import refine
from carom.runs.resume import resume
from carom.scene.scene_file import bundled_scenes
from carom.state.checkpoint import GONE, PRESENT, ReleaseCheckpoint

G, SPEED = 9.81, 2.0  # m/s², m/s
r = 0.02  # m
STREAM = {"at": 0.1, "rate": 20.0}
EDGE = {"name": "edge", "point": [0.0, 0.0, -1.0], "normal": [0.0, 0.0, 1.0]}
ALONE = {"shape": "box", "size": [2.4 * r, 2.4 * r, 2.4 * r]}  # m, room for one body


def scene(group: dict[str, Any], duration: float = 1.0, **others: Any) -> Scene:
    """Return a scene in which bodies fall, if they are there."""
    falling = {"radius": r, "density": 1000.0, "region": ALONE, "velocity": {"mean": [0.0, 0.0, -SPEED]}}
    values = {"title": "", "gravity": {"constant": 0.0, "uniform": [0.0, 0.0, -G]}, "time": {"duration": duration}}
    return Scene.from_dict(values | {"group": [falling | group]} | others)


def slope(count: int = 40, duration: float = 1.5) -> Scene:
    """Return bodies that fall onto a slope, slide off, and come back."""
    edge = {"name": "edge", "point": [0.3, 0.0, 0.0], "normal": [-1.0, 0.0, 0.0]}
    region = {"shape": "cylinder", "radius": 0.08, "height": 0.1, "centre": [0.0, 0.0, 0.2]}
    group = {"count": count, "region": region, "release": {"rate": 80.0}}
    return scene(group, duration, plane=[{"normal": [0.6, 0.0, 1.0]}], outlet=[edge])


def steps(of: Scene, threads: int = 1) -> list[Frame]:
    return list(Space(of, threads).run(schedule=every(0.0)))


def release(frame: Frame) -> ReleaseCheckpoint:
    assert frame.memory is not None and frame.memory.release is not None
    return frame.memory.release


def waits(frame: Frame) -> Any:
    found = frame.waits
    assert found is not None
    return found


def heights_of(of: Scene) -> FloatArray:
    """Return the heights at which bodies enter, (n,) m."""
    return np.asarray(place(of).position[:, 2])


def test_bodies_of_a_stream_enter_at_their_times_and_fall_as_one_does_alone() -> None:
    of = scene({"count": 5, "release": STREAM}, 0.5)
    due = STREAM["at"] + np.arange(5) / STREAM["rate"]
    for frame in steps(of)[1:]:
        entered = due < frame.time - 1e-12
        assert np.array_equal(~waits(frame), entered)
        fallen = (frame.time - due)[entered]
        height = heights_of(of)[entered] - SPEED * fallen - 0.5 * G * fallen**2
        assert frame.position[entered, 2] == pytest.approx(height, rel=1e-12, abs=1e-13)
        assert frame.velocity[entered, 2] == pytest.approx(-SPEED - G * fallen, rel=1e-12)
        assert not frame.velocity[~entered].any()


def test_what_enters_is_all_the_energy_of_free_bodies() -> None:
    of = scene({"count": 5, "release": STREAM, "region": ALONE | {"centre": [0.0, 0.0, 0.7]}}, 0.5)
    each = place(of).mass * (0.5 * SPEED**2 + G * heights_of(of))
    for frame in steps(of):
        entered = float(each[~waits(frame)].sum())
        assert frame.energy.total == pytest.approx(entered, rel=1e-12, abs=1e-15)
        assert frame.energy.ledger.entry("passage") == pytest.approx(-entered, rel=1e-12, abs=1e-15)


def test_fixed_steps_let_bodies_enter_as_the_next_step_begins() -> None:
    of = scene({"count": 1, "release": {"at": 0.105}}, time={"duration": 0.2, "fixed_dt": 0.01})
    first = next(frame for frame in steps(of) if not waits(frame).any())
    assert first.time == pytest.approx(0.12)  # the step from 0.11 on


def test_a_body_waits_until_nothing_is_in_its_place() -> None:
    slow = {"velocity": {"mean": [0.0, 0.0, -0.1]}, "count": 2, "release": {"rate": 4.0}}
    of = scene(slow, 1.0, gravity={"constant": 0.0})  # a place is free after 0.4 s, and a body due after 0.25 s
    came = next(frame for frame in steps(of) if not waits(frame).any())
    assert came.time - came.dt == pytest.approx(2.0 * r / 0.1, abs=2.0 * came.dt)
    assert not len(came.contacts)


def test_a_place_that_never_gets_free_is_said_after_a_while() -> None:
    stone = {"fixed": True, "radius": 0.1}
    ball = {"position": [0.0, 0.0, 0.12], "radius": r, "density": 1000.0}  # rests on it, so that there are contacts
    of = scene({"count": 1, "name": "drops", "release": {"at": 0.1}}, 1.0, body=[stone, ball])
    frames = steps(of)
    events = [event for frame in frames for event in frame.events if "could not enter" in event.text]
    assert len(events) == 1 and "A body of drops could not enter for 0.05 s" in events[0].text
    assert 0.15 < events[0].time < 0.16
    assert np.array_equal(release(frames[-1]).since, [PRESENT, PRESENT, 0.1])


def test_nothing_enters_after_the_inlet_is_closed() -> None:
    frames = steps(scene({"count": 9, "release": STREAM | {"until": 0.26}}, 0.5))
    assert np.count_nonzero(~waits(frames[-1])) == 4  # at 0.1, 0.15, 0.2 and 0.25 s
    assert np.count_nonzero(release(frames[-1]).since == GONE) == 5


def test_bodies_that_wait_touch_nothing_wherever_they_are() -> None:
    """A large body sweeps through the places where they wait, above the scene."""
    big = {"position": [0.0, 0.0, 1.0], "radius": 0.5, "velocity": [0.0, 0.0, 40.0], "density": 10.0}
    of = scene({"count": 60, "release": {"at": 0.299, "rate": 10.0}}, 0.3, body=[big])
    frames = [frame for frame in steps(of) if frame.time < 0.299]
    outside = frames[0].position[1:]
    assert np.abs(outside - frames[-1].position[0]).max(axis=0).min() < 10.0
    assert (outside[:, 2].max() < frames[-1].position[0, 2]) and not sum(len(f.contacts) for f in frames)
    assert np.array_equal(frames[-1].position[1:], outside)


def test_bodies_that_leave_come_back_and_the_ledger_has_what_they_took() -> None:
    of = scene({"count": 1}, 3.0, outlet=[EDGE])
    period = (math.sqrt(SPEED**2 + 2.0 * G * (1.0 + heights_of(of)[0])) - SPEED) / G  # s, of a fall
    frames, mass = steps(of), float(place(of).mass[0])
    passed = int(release(frames[-1]).totals[0, 0])
    assert passed == pytest.approx(3.0 / period, abs=1.0 + 3.0 / period * frames[-1].dt / period)
    assert release(frames[-1]).totals[0, 1] == pytest.approx(passed * mass)
    last = frames[-1]
    assert last.energy.integration_error == pytest.approx(0.0, abs=1e-12)
    # each one leaves with the energy with which it came, so nothing remains in the ledger
    assert last.energy.ledger.entry("passage") == pytest.approx(0.0, abs=1e-12)


def test_what_goes_out_does_not_come_back() -> None:
    frames = steps(scene({"count": 3, "release": STREAM}, 1.0, outlet=[EDGE | {"to": "out"}]))
    assert np.array_equal(release(frames[-1]).since, [GONE] * 3)
    assert release(frames[-1]).totals[0, 0] == 3
    assert frames[-1].energy.total == 0.0


@pytest.mark.parametrize(
    "region",
    [
        {"shape": "ball", "radius": 0.3},
        {"shape": "box", "size": [0.6, 0.6, 0.6]},
        {"shape": "cylinder", "radius": 0.3, "height": 0.6},
        {"shape": "shell", "inner_radius": 0.01, "radius": 0.3},
    ],
    ids=lambda region: region["shape"],
)
def test_a_body_leaves_where_its_centre_enters_a_region(region: dict[str, Any]) -> None:
    of = scene({"count": 1}, 0.5, outlet=[{"region": region | {"centre": [0.0, 0.0, -0.8]}, "to": "out"}])
    there = [frame.position[0, 2] for frame in steps(of) if not waits(frame)[0]]
    step = (SPEED + G * 0.2) * 0.02
    assert -0.5 - step < min(there) <= -0.5


def test_a_steady_stream_leaves_as_it_enters_and_contacts_end_with_it() -> None:
    frames = steps(slope())
    late = [frame for frame in frames if frame.time > 0.9]
    begin, end = late[0], late[-1]
    left = release(end).totals[0, 0] - release(begin).totals[0, 0]
    present = np.count_nonzero(~waits(end)) - np.count_nonzero(~waits(begin))
    entered = round(left) + present
    assert entered == pytest.approx(80.0 * (end.time - begin.time), abs=1.0)
    for frame in frames:
        ends = frame.contacts.pairs
        assert not waits(frame)[ends[ends < len(waits(frame))]].any()
        assert abs(frame.energy.integration_error) < 1e-12 * frame.energy.scale + 1e-15
    assert max(len(frame.contacts) for frame in frames) > 3


def test_a_run_goes_on_from_any_checkpoint_with_the_same_bits() -> None:
    of = slope(duration=0.9)
    frames = steps(of)
    for at in (3, len(frames) // 3, len(frames) // 2, 4 * len(frames) // 5):
        space = Space(of, 1)
        space.restore(frames[at].checkpoint)
        again = list(space.run(schedule=every(0.0)))[1:]
        assert [frame.fingerprint for frame in again] == [frame.fingerprint for frame in frames[at + 1 :]]
        assert np.array_equal(release(again[-1]).totals, release(frames[-1]).totals)
        assert again[-1].energy == frames[-1].energy


def test_runs_of_other_steps_and_other_engines_are_not_compared(tmp_path: Path) -> None:
    """Bodies enter and leave as a step begins, and other engines have them all from the start."""
    poured = slope(count=4)
    with pytest.raises(SceneError, match=r"a refined run of a scene with \[group.release\] or \[\[outlet\]\]"):
        refine(poured)
    with pytest.raises(SceneError, match="cannot be measured; remove these sections"):
        Study(poured, tmp_path / "study")
    with pytest.raises(ExperimentError, match="mujoco cannot represent this scene: bodies that enter or leave"):
        problem_of("mujoco", poured)


def test_a_checkpoint_of_other_inlets_or_outlets_is_refused() -> None:
    of = slope(duration=0.2)
    checkpoint = steps(of)[-1].checkpoint
    contacts, state = checkpoint.contacts, checkpoint.contacts.release  # type: ignore[union-attr]
    assert contacts is not None and state is not None
    for wrong in (None, replace(state, slots=state.slots[:1]), replace(state, totals=np.zeros((2, 2)))):
        with pytest.raises(PhysicsError, match="does not state how the bodies of the scene enter and leave"):
            Space(of, 1).restore(replace(checkpoint, contacts=replace(contacts, release=wrong)))


def test_the_bits_do_not_depend_on_the_threads() -> None:
    one, two = steps(slope(duration=0.6)), steps(slope(duration=0.6), threads=2)
    assert [frame.fingerprint for frame in one] == [frame.fingerprint for frame in two]


def test_bodies_enter_a_box_that_is_periodic_along_two_axes() -> None:
    region = {"shape": "box", "size": [0.36, 0.36, 0.1], "centre": [0.0, 0.0, 0.5]}
    box = {"boundary": ["periodic", "periodic", "open"], "size": [0.4, 0.4, 2.0]}
    of = scene({"count": 60, "region": region, "release": {"rate": 100.0}}, 1.0, domain=box, plane=[{}])
    last = steps(of)[-1]
    assert not waits(last).any() and last.position[:, 2].min() > 0.9 * r
    assert abs(last.energy.integration_error) < 1e-9 * last.energy.scale


def test_an_explanation_lists_the_part_only_where_bodies_pass() -> None:
    parts = {part.name: part.why for part in require(slope()).parts}
    assert parts["release"] == "40 bodies enter later; bodies leave by edge"
    assert "release" not in {part.name for part in require(scene({"count": 1})).parts}


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return carom.run(slope(), tmp_path_factory.mktemp("slope") / "slope.rrd").path


def test_a_recording_does_not_draw_bodies_that_wait(recorded: Path) -> None:
    recording, drawn = Recording.open(recorded), []
    for step in recording.fingerprints()["step"].to_pylist()[::10]:
        position = recording.drawn_positions(step)
        assert position is not None
        assert np.array_equal(np.isfinite(position).all(axis=1), recording.present(step))
        drawn.append(int(recording.present(step).sum()))
    assert drawn[0] == 0 and max(drawn) > 10
    at = recording.checkpoint_steps[0]
    assert recording.checkpoint(at).contacts.release is not None  # type: ignore[union-attr]


def test_a_close_up_is_not_of_bodies_that_wait(recorded: Path) -> None:
    """At the start all bodies wait, among them the two of the run's hardest impact, which are there in its step."""
    recording = Recording.open(recorded)
    hardest = pair_of_extreme(recording, "impact")
    assert hardest is not None
    for moment, shown in ((0.0, False), (recording.moment(), True)):
        drawn = {rows.path for rows in presentation(recording, moment).supplement.rows}
        assert (close_up.BODIES in drawn) == shown
    with pytest.raises(RecordingError, match="of bodies that are there then; name two bodies, or another time"):
        presentation(recording, 0.0, only=CLOSE_UP)


def test_tables_and_exports_leave_out_bodies_that_wait(recorded: Path, tmp_path: Path) -> None:
    recording = Recording.open(recorded)
    assert recording.bodies(0.0).num_rows == 0
    step = recording.checkpoint_steps[-1]
    there = recording.present_in(recording.checkpoint(step))
    assert recording.bodies(1.5)["body"].to_pylist() == np.flatnonzero(there).tolist()
    path = recording.trajectory(0)
    known = np.isfinite(path["x"].to_numpy())
    assert known.any() and not known.all()
    (snapshot,) = snapshots(recording, 1.5, everything=False)
    assert snapshot.body.tolist() == np.flatnonzero(there).tolist() and np.abs(snapshot.vectors["position"]).max() < 1.0


@pytest.mark.slow
@pytest.mark.nightly
def test_a_hopper_whose_balls_come_back_flows_steadily() -> None:
    """A closed form: as many leave as enter, and the flow does not change while the level does not."""
    document = tomllib.loads(bundled_scenes()["hopper"].read_text(encoding="utf-8"))
    del document["expect"]
    document["time"]["duration"] = 5.0
    document["outlet"] = [{"name": "drop", "point": [0.0, 0.0, 0.15]}]
    frames = list(Space(Scene.from_dict(document)).run(schedule=every(0.5)))
    left = np.array([release(frame).totals[0, 0] for frame in frames])
    time = np.array([frame.time for frame in frames])
    begin, middle, end = (int(np.searchsorted(time, at)) for at in (1.0, 3.0, 5.0))
    first = (left[middle] - left[begin]) / (time[middle] - time[begin])
    second = (left[end] - left[middle]) / (time[end] - time[middle])
    # 190 to 265 balls a second; over seven seeds, the second half differs from the first by up to 20 %
    assert second == pytest.approx(first, rel=0.3)
    for frame in frames:
        assert len(frame.position) == 300
        assert abs(frame.energy.integration_error) < 1e-12 * frame.energy.scale


def test_the_rates_through_outlets_are_series(recorded: Path) -> None:
    recording = Recording.open(recorded)
    table = recording.steps()
    time, rate, mass = (table[name].to_numpy() for name in ("time", "outlet_0", "outlet_0_mass"))
    totals = recording.checkpoint(recording.checkpoint_steps[-1]).contacts.release.totals  # type: ignore[union-attr]
    assert (rate[1:] * np.diff(time)).sum() == pytest.approx(totals[0, 0])
    assert (mass[1:] * np.diff(time)).sum() == pytest.approx(totals[0, 1])
    assert totals[0, 0] > 20


def test_replay_clip_and_resume_have_the_same_bits(recorded: Path, tmp_path: Path) -> None:
    assert carom.replay(recorded).same
    cut = tmp_path / "clip.rrd"
    clip(recorded, cut, 0.8, 1.0)
    assert carom.replay(cut).same
    half = carom.run(slope(duration=0.7), tmp_path / "half.rrd").path
    longer = Recording.open(resume(half, until=1.5).path)
    whole = Recording.open(recorded)
    assert longer.fingerprints()["fingerprint"].to_pylist()[-1] == whole.fingerprints()["fingerprint"].to_pylist()[-1]


@pytest.mark.parametrize(
    ("group", "others", "said"),
    [
        ({"release": {"rate": 4e4}}, {}, "group.0.release.rate = 4e+04 1/s: its region empties too slowly for more"),
        ({"release": {"rate": 1.0}, "velocity": {}}, {"gravity": {"constant": 0.0}}, "enter at rest, and no field"),
        ({"release": {"until": 2.0}}, {}, "release needs the key at or rate"),
        ({"release": {"at": 2.0, "until": 1.0}}, {}, "until = 1 is not after at = 2"),
        (
            {"release": {"rate": 1.0, "at": 1.0}},
            {},
            "group.0.release.at = 1 s: the run ends at 1 s, before a body enters",
        ),
        ({"release": {"rate": 1.0, "each": 1.0}}, {}, "unknown key group.0.release.each"),
        ({"release": {"at": 0.1}}, {"gravity": {"constant": 1.0}}, "set gravity.constant = 0"),
        (
            {"release": {"at": 0.1}},
            {"contact": {"sleep": {"speed": 0.1}}},
            "with contact.sleep, which does not support it",
        ),
        ({"release": {"at": 0.1}}, {"contact": {"enabled": False}}, "with contact.enabled = false"),
        ({"release": {"at": 0.1}}, {"contact": {"solver": "staged"}}, 'with contact.solver = "staged"'),
        ({"release": {"at": 0.1}}, {"time": {"duration": 1.0, "accuracy": 1e-3}}, "with time.accuracy, which"),
        ({"release": {"at": 0.1}}, {"time": {"duration": 1.0, "integrator": "yoshida4"}}, 'set "leapfrog"'),
        ({"release": {"at": 0.1}}, {"drag": {"relaxation_time": 1.0}}, "with a [drag], which does not support it"),
        ({}, {"domain": {"boundary": "periodic", "size": [1.0, 1.0, 1.0], "shear": {"rate": 1.0}}}, "domain.shear"),
        ({}, {"outlet": [{}]}, "outlet.0: an outlet needs either a region or a point of a plane"),
        ({}, {"outlet": [EDGE | {"normal": [0.0, 0.0, 0.0]}]}, "normal = [0, 0, 0] has no direction"),
        ({}, {"outlet": [EDGE | {"to": "sea"}]}, "outlet.0.to = 'sea': must be 'inlet' or 'out'"),
        ({}, {"outlet": [EDGE], "plane": [{"point": [0.0, 0.0, -0.9]}]}, "edge lies behind plane 0, where no body"),
        (
            {},
            {"outlet": [{"region": {"radius": 0.1, "centre": [0.0, 0.0, -2.0]}}], "plane": [{"point": [0, 0, -1.0]}]},
            "outlet 0 lies behind plane 0",
        ),
        ({}, {"outlet": [EDGE | {"point": [0.0, 0.0, 1.0]}]}, "enters in edge, and would leave at once"),
        ({}, {"outlet": [{"region": {"shape": "plummer", "scale": 1.0}}]}, "has no border"),
    ],
)
def test_what_cannot_work_is_refused_in_one_sentence(group: dict[str, Any], others: dict[str, Any], said: str) -> None:
    with pytest.raises(SceneError) as error:
        if "shear" in said:
            others = others | {"gravity": {"constant": 0.0}}
            group = {"release": {"at": 0.1}}
        Space(scene({"count": 3} | group if "release" in group else {"count": 1} | group, 1.0, **others), 1)
    assert said in str(error.value)
    assert "\n" not in str(error.value)
