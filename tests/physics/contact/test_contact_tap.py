"""The contacts of frames: impulses, modes, energies and places against those of mechanics."""

from __future__ import annotations

from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from carom.contact_table import CONTACT_ROW, MODES
from carom.physics.contact import contact_tap as impact_store
from carom.physics.frame_store import FrameStore
from carom.physics.schedule import every
from carom.physics.space import Space
from carom.scene.load import Scene
from carom.state.frame import Frame
from small_scenes import cloud, pair, scene_of

Records = NDArray[np.void]

TIMINGS = ("end-of-step", "time-of-impact")
G = 9.81


def frames_of(scene: Scene, interval: float = 0.0) -> list[Frame]:
    return list(Space(scene, 1, record_contacts=True).run(schedule=every(interval)))


def collapse(timing: str) -> Scene:
    return cloud(20, contact={"timing": timing}, time={"duration": 2.0})


@cache
def collapsing(timing: str) -> list[Frame]:
    """The frames of all steps of a cloud that collapses: impacts, then piles."""
    return frames_of(collapse(timing))


def rows_of(frame: Frame) -> Records:
    assert frame.contact_rows is not None
    return frame.contact_rows


def impacts_of(frames: list[Frame]) -> Records:
    return np.concatenate([frame.impacts for frame in frames if frame.impacts is not None])


def modes_of(rows: Records) -> list[str]:
    return [MODES[mode] for mode in rows["mode"]]


def ball_on_floor(
    velocity: list[float], friction: float, contact: dict[str, Any] | None = None, **sections: Any
) -> Scene:
    """A ball of 2 kg and 0.5 m that touches a plane."""
    ball = {"position": [0.0, 0.0, 0.5], "velocity": velocity, "radius": 0.5, "mass": 2.0}
    law = {"restitution": 0.0, "static_friction": friction, "kinetic_friction": friction}
    return scene_of(
        [ball],
        plane=[{}],
        gravity={"constant": 0.0, "uniform": [0.0, 0.0, -G]},
        contact=law | (contact or {}),
        time={"duration": 1.0, "fixed_dt": 0.01},
        **sections,
    )


@pytest.mark.parametrize("timing", TIMINGS)
def test_a_head_on_impact_has_the_impulse_and_the_loss_of_newtons_law(timing: str) -> None:
    e, speed, mu = 0.6, 1.5, 0.5  # reduced mass of two times 1 kg
    law = {"restitution": e, "static_friction": 0.0, "kinetic_friction": 0.0, "timing": timing}
    frames = frames_of(pair(speed=speed, contact=law, time={"duration": 1.0, "fixed_dt": 0.01}))
    (impact,) = impacts_of(frames)
    assert (impact["i"], impact["j"]) == (0, 1)
    assert impact["approach_speed"] == pytest.approx(2 * speed, rel=1e-15)
    assert impact["normal_impulse"] == pytest.approx((1 + e) * mu * 2 * speed, rel=1e-15)
    assert impact["restitution_loss"] == pytest.approx(0.5 * mu * (1 - e * e) * (2 * speed) ** 2, rel=1e-14)
    assert impact["friction_loss"] == impact["stabilisation_gain"] == 0.0
    assert [impact[name] for name in ("nx", "ny", "nz")] == [1.0, 0.0, 0.0]
    assert [impact[name] for name in ("x", "y", "z")] == pytest.approx([0.0, 0.0, 0.0], abs=1e-12)
    touch = 2.0 / (2 * speed)
    late = 0.0 if timing == "time-of-impact" else 0.01
    assert touch - 1e-12 <= impact["time"] <= touch + late + 1e-12


def test_an_impact_at_its_own_time_lies_within_its_step() -> None:
    frames = collapsing("time-of-impact")
    for before, after in pairwise(frames):
        assert after.impacts is not None
        assert (after.impacts["step"] == after.step).all()
        assert (after.impacts["time"] >= before.time).all() and (after.impacts["time"] <= after.time).all()
        assert (np.diff(after.impacts["time"]) >= 0.0).all()
    assert len(impacts_of(frames)) > 100


@pytest.mark.parametrize("timing", TIMINGS)
def test_frames_far_apart_carry_all_impacts_since_the_one_before(timing: str) -> None:
    each, few = collapsing(timing), frames_of(collapse(timing), interval=0.7)
    assert len(few) < len(each) / 10
    assert np.array_equal(impacts_of(each), impacts_of(few))
    assert all(frame.impacts_left_out == 0 for frame in few)


@pytest.mark.parametrize("timing", TIMINGS)
def test_every_impact_that_the_run_counts_is_in_a_frame(timing: str) -> None:
    space = Space(cloud(gravity={"constant": 0.0}, contact={"timing": timing}), 1, record_contacts=True)
    impacts = impacts_of(list(space.run()))
    assert len(impacts) == space.extremes.impacts > 10
    assert set(modes_of(impacts)) == {"impact"}


@pytest.mark.parametrize("solver", ["lasting", "staged"])
def test_the_impulse_on_a_ball_on_a_plane_is_its_weight_times_the_step(solver: str) -> None:
    frames = frames_of(ball_on_floor([0.0, 0.0, 0.0], 0.5, {"solver": solver}))
    for frame in frames[2:]:
        rows = frame.contact_rows
        assert rows is not None and len(rows) == 1
        assert (rows[0]["i"], rows[0]["j"]) == (0, 1)
        assert rows[0]["normal_impulse"] == pytest.approx(2.0 * G * 0.01, rel=1e-9)  # kept to 1e-13, staged to 1e-10
        assert [rows[0][name] for name in ("nx", "ny", "nz")] == [0.0, 0.0, -1.0]
        assert rows[0]["z"] == pytest.approx(0.0, abs=2e-3)  # staged sinks by ½ g dt² before it is pushed back
        assert modes_of(rows) == ["sticking"]
        assert frame.impacts is not None and len(frame.impacts) == 0


def test_a_ball_that_slides_takes_kinetic_friction_until_it_rolls_and_then_none() -> None:
    friction, speed = 0.2, 1.0
    frames = frames_of(ball_on_floor([speed, 0.0, 0.0], friction))
    rolls = speed * 2 / 7 / (friction * G)  # s, when 5/7 of the speed are left
    for frame in frames[1:]:
        assert frame.contact_rows is not None
        (row,) = frame.contact_rows
        if frame.time < rolls:
            assert modes_of(frame.contact_rows) == ["sliding"]
            # the plane is j: friction drags it along with the ball
            assert row["friction_x"] == pytest.approx(friction * row["normal_impulse"], rel=1e-9)
            assert row["friction_loss"] > 0.0
        elif frame.time > rolls + 0.01:
            assert modes_of(frame.contact_rows) == ["sticking"]
            assert abs(row["friction_x"]) < 1e-9 * row["normal_impulse"]


def test_where_static_friction_is_stronger_what_sticks_may_exceed_kinetic_friction() -> None:
    ball = {"position": [0.0, 0.0, 0.5], "radius": 0.5, "mass": 1.0}
    tilted = {"uniform": [0.28 * G, 0.0, -0.96 * G], "constant": 0.0}  # the slope takes 2/7 of 0.29 as friction, 0.083
    law = {"restitution": 0.0, "static_friction": 0.1, "kinetic_friction": 0.05}
    time = {"duration": 0.2, "fixed_dt": 0.01}
    rows = [f.contact_rows for f in frames_of(scene_of([ball], plane=[{}], gravity=tilted, contact=law, time=time))]
    for found in rows[1:]:
        assert found is not None and modes_of(found) == ["sticking"]
        assert abs(found["friction_x"][0]) / found["normal_impulse"][0] == pytest.approx(2 / 7 * 0.28 / 0.96, rel=1e-6)


def test_without_friction_what_lies_is_resting_and_has_no_tangential_impulse() -> None:
    rows = frames_of(ball_on_floor([1.0, 0.0, 0.0], 0.0))[-1].contact_rows
    assert rows is not None and modes_of(rows) == ["resting"]
    assert [rows[0][name] for name in ("friction_x", "friction_y", "friction_z")] == [0.0, 0.0, 0.0]


def test_a_contact_that_separates_is_open_and_has_no_impulse() -> None:
    left = {"position": [-1.0, 0.0, 0.0], "velocity": [-1e-3, 0.0, 0.0], "radius": 1.01}
    right = {"position": [1.0, 0.0, 0.0], "velocity": [1e-3, 0.0, 0.0], "radius": 1.01}
    time = {"duration": 0.01, "fixed_dt": 0.01}
    law = {"allow_overlap": True, "stabilisation": "none"}
    rows = frames_of(scene_of([left, right], gravity={"constant": 0.0}, contact=law, time=time))[-1].contact_rows
    assert rows is not None and modes_of(rows) == ["open"]
    assert rows[0]["normal_impulse"] == rows[0]["approach_speed"] == 0.0


@pytest.mark.parametrize("timing", TIMINGS)
def test_the_rows_have_every_contact_of_the_frames_graph_once_and_in_its_order(timing: str) -> None:
    more = 0
    for frame in collapsing(timing):
        rows, graph = rows_of(frame), frame.contacts
        keys = rows["i"] * 1000 + rows["j"]
        assert (np.diff(keys) > 0).all()
        shown = graph.pairs[:, 0] * 1000 + graph.pairs[:, 1]
        assert np.isin(shown, keys).all()
        assert np.array_equal(keys[np.isin(keys, shown)], shown)
        more += len(rows) - len(shown)
        # the others were held after the first kick and are open at the end, or were pushed into each other and apart
        others = rows[~np.isin(keys, shown)]
        assert ((others["normal_impulse"] > 0.0) | (others["stabilisation_gain"] != 0.0)).all()
    assert more > 0


def test_contact_points_lie_inside_the_periodic_box_and_on_both_bodies() -> None:
    group = {
        "count": 40,
        "radius": 0.4,
        "region": {"shape": "box", "size": [5.2, 5.2, 5.2]},
        "velocity": {"dispersion": 3.0},
    }
    box, still = {"boundary": "periodic", "size": [6.0, 6.0, 6.0]}, {"constant": 0.0}
    gas = {"group": [group], "domain": box, "gravity": still, "contact": {"timing": "time-of-impact"}}
    impacts = impacts_of(frames_of(Scene.from_dict({**gas, "time": {"duration": 1.0}})))
    points = np.stack([impacts[name] for name in "xyz"], axis=1)
    assert len(points) > 20 and (np.abs(points) <= 3.0 + 1e-12).all()
    rows = frames_of(
        pair(
            domain={"boundary": "periodic", "size": [7.0, 7.0, 7.0]},
            time={"duration": 2.0, "fixed_dt": 0.01},
            contact={"timing": "time-of-impact"},
            speed=-1.0,
        )
    )
    (across,) = impacts_of(rows)[:1]
    assert abs(across["x"]) == pytest.approx(3.5)  # they meet through the boundary
    assert across["nx"] == pytest.approx(-1.0)


def test_a_run_that_does_not_ask_has_no_rows_and_no_room_for_them() -> None:
    smooth = {"static_friction": 0.0, "kinetic_friction": 0.0}  # friction has torques, which leave out impacts
    space = Space(cloud(contact=smooth), 1)
    frames = list(space.run())
    assert all(frame.impacts is None and frame.contact_rows is None for frame in frames)
    contact = space._contact
    assert contact is not None and contact.part(impact_store.ContactTap) is None
    assert len(frames[-1].contacts) > 0 and len(contact.solver.recorded) == 0


def test_a_scene_without_contacts_has_empty_tables() -> None:
    for frame in frames_of(Scene.load("kepler-orbits"), interval=1e9)[:1]:
        assert frame.impacts is not None and frame.impacts.dtype == CONTACT_ROW and len(frame.impacts) == 0
        assert frame.contact_rows is not None and len(frame.contact_rows) == 0


def test_tables_are_copies_that_later_steps_do_not_change() -> None:
    space = Space(collapse("end-of-step"), 1, record_contacts=True)
    kept = [(frame, rows_of(frame).copy(), impacts_of([frame]).copy()) for frame in space.run()]
    for frame, rows, impacts in kept:
        assert np.array_equal(rows_of(frame), rows) and np.array_equal(impacts_of([frame]), impacts)


def test_frames_in_a_store_have_the_same_tables() -> None:
    space = Space(collapse("time-of-impact"), 1, record_contacts=True)
    store = FrameStore(3, space.state)
    for own, kept in zip(collapsing("time-of-impact"), space.run(store=store, schedule=every(0.0)), strict=True):
        assert np.array_equal(rows_of(own), rows_of(kept))


def test_a_restored_run_has_the_contacts_of_the_one_that_went_on() -> None:
    frames = collapsing("end-of-step")
    middle = frames[len(frames) // 2]
    again = Space(collapse("end-of-step"), 1, record_contacts=True)
    again.restore(middle.checkpoint)
    first, *rest = again.run()
    assert first.impacts is not None and len(first.impacts) == 0
    for there, here in zip(frames[len(frames) // 2 + 1 :], rest, strict=True):
        assert np.array_equal(rows_of(there), rows_of(here))
        assert np.array_equal(impacts_of([there]), impacts_of([here]))


def test_of_too_many_impacts_the_largest_are_kept_in_order_of_time_and_the_others_counted(
    monkeypatch: pytest.MonkeyPatch, seed: int
) -> None:
    monkeypatch.setattr(impact_store, "MOST_IMPACTS", 50)
    rng = np.random.default_rng(seed)
    rows = np.zeros(1000, CONTACT_ROW)
    rows["time"] = np.arange(1000.0)
    rows["normal_impulse"] = rng.integers(0, 200, 1000)  # ties, too
    store = impact_store.ImpactStore()
    for part in np.array_split(rows, rng.integers(1, 60)):
        store.add(part)
    kept = store.rows()
    best = np.sort(np.argsort(-rows["normal_impulse"], kind="stable")[:50])
    assert np.array_equal(kept, rows[best]) and store.left_out == 950


def test_the_room_of_a_new_slot_holds_the_most_contacts_so_far() -> None:
    """Rows that do not fit are written twice, so the buffer is enlarged before a frame is written."""
    space = Space(collapse("end-of-step"), 1, record_contacts=True)
    store = FrameStore(40, space.state)
    most = 0
    for frame in space.run(store=store, schedule=every(0.0)):
        assert frame.slot is not None
        room = store.contact_rows[frame.slot]
        assert len(room.whole) > most
        most = max(most, len(rows_of(frame)))
    assert most > 10
