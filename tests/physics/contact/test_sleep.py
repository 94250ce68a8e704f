"""Sleep: bodies at rest on something fixed are not computed until something disturbs them."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest

from carom.physics.schedule import every
from carom.physics.space import Space
from carom.recording.schema.checkpoint_columns import decode, encode
from carom.scene.load import Scene
from carom.state.checkpoint import SleepCheckpoint
from carom.state.frame import Frame

PILE = [  # in a shaft with the floor z = 0: four spheres that fill its width, and one in the hollow between them
    *({"position": [x, y, 1.0], "mass": 1.0} for x in (-1.01, 1.01) for y in (-1.01, 1.01)),
    {"position": [0.0, 0.0, 2.45], "mass": 1.0, "angular_velocity": [0.1, 0.0, 0.0]},
]
SHAFT = [
    {"point": [0.0, 0.0, 0.0]},
    *({"point": [2.02 * x, 2.02 * y, 0.0], "normal": [-x, -y, 0]} for x, y in ((1, 0), (-1, 0), (0, 1), (0, -1))),
]
ASLEEP_BY = 120  # steps
STEPS = 240


def pile(*others: dict[str, Any], constant: float = 0.0, sleeps: bool = True, **sections: Any) -> Scene:
    """A pile that falls asleep within two seconds, and other bodies."""
    contact = {"restitution": 0.2, **({"sleep": {"speed": 0.05, "after": 0.2}} if sleeps else {})}
    return Scene.from_dict(
        {
            "body": [*PILE, *others],
            "plane": SHAFT,
            "gravity": {"constant": constant, "uniform": [0.0, 0.0, -9.81]},
            "time": {"duration": 4.0, "fixed_dt": 1.0 / 60.0},
            "contact": contact | sections.pop("contact", {}),
            "record": {"every": "step", "check_every": 1},
            **sections,
        }
    )


def struck(**sections: Any) -> Scene:
    """The same, and a sphere that falls on it after two and a half seconds."""
    return pile({"position": [0.3, 0.2, 34.0], "mass": 1.0}, **sections)


def frames_of(scene: Scene, threads: int = 1, records: bool = True) -> list[Frame]:
    return list(itertools.islice(Space(scene, threads, record_contacts=records).run(schedule=every(0.0)), STEPS + 1))


def sleepers(frame: Frame) -> int:
    return int(np.count_nonzero(sleep_of(frame).calm < 0.0))


def sleep_of(frame: Frame) -> SleepCheckpoint:
    assert frame.memory is not None
    assert frame.memory.sleep is not None
    return frame.memory.sleep


def assert_same(once: list[Frame], again: list[Frame]) -> None:
    for one, other in zip(once, again, strict=True):
        assert one.fingerprint == other.fingerprint, f"step {one.step}"
        assert one.energy == other.energy
    for one, other in zip(once[1:], again[1:], strict=True):  # the frame gone back to shows no contacts
        assert np.array_equal(one.contacts.pairs, other.contacts.pairs)
        assert one.contact_rows is not None
        assert other.contact_rows is not None
        assert np.array_equal(one.contact_rows, other.contact_rows)


def test_sleepers_keep_their_places_orientations_and_contacts_to_the_last_bit() -> None:
    frames = frames_of(pile())
    first, last = frames[ASLEEP_BY], frames[-1]
    assert sleepers(first) == len(PILE)
    assert last.orientation is not None
    for name in ("position", "orientation"):
        assert np.array_equal(getattr(first, name), getattr(last, name))
    assert not last.velocity.any()
    assert len(last.contacts) >= 6  # four with the floor, two with the sphere on top
    assert np.array_equal(first.contacts.pairs, last.contacts.pairs)
    assert last.contact_rows is not None
    rows = last.contact_rows[last.contact_rows["j"] >= len(PILE)]  # those of the floor and of walls that it leans on
    held = -(rows["normal_impulse"] * rows["nz"] + rows["friction_z"]).sum()  # N s upwards, of a step
    assert held == pytest.approx(5.0 * 9.81 / 60.0, rel=1e-3)  # the last kick was solved to 5 × 10⁻⁴


@pytest.mark.parametrize("timing", ["end-of-step", "time-of-impact"])
def test_an_impact_wakes_the_whole_pile(timing: str) -> None:
    frames = frames_of(struck(contact={"timing": timing}))
    asleep = [sleepers(frame) for frame in frames]
    assert asleep[ASLEEP_BY] == len(PILE)
    woken = next(k for k in range(ASLEEP_BY, len(frames)) if asleep[k] == 0)
    moved = np.abs(frames[-1].position - frames[woken - 1].position)[: len(PILE)].max(axis=1)
    assert np.count_nonzero(moved) >= 4  # one that leans on nothing that moves may stay where it is


def test_a_pull_that_changes_wakes_the_pile() -> None:
    coming = {"position": [0.0, 0.0, 60.0], "mass": 1e5}  # pulls by 0.28 m/s² at first, by more than 0.53 at 43 m
    assert sleepers(frames_of(pile(constant=0.01))[-1]) == len(PILE)
    frames = frames_of(pile(coming, constant=0.01))
    asleep = [sleepers(frame) for frame in frames]
    fell = asleep.index(len(PILE))
    woke = fell + asleep[fell:].index(0)
    assert frames[woke].position[-1, 2] > 20.0


@pytest.mark.parametrize("timing", ["end-of-step", "time-of-impact"])
def test_the_ledger_has_what_sleep_takes(timing: str) -> None:
    frames = frames_of(struck(contact={"timing": timing, "sleep": {"speed": 0.3, "after": 0.1}}))
    booked = [frame.energy.total + frame.energy.ledger.balance for frame in frames]
    scale = max(abs(frame.energy.total) for frame in frames)
    # the same as without sleep, rounding and what the held contacts leave: 10⁻⁹ (measured 4 × 10⁻¹⁵)
    assert np.ptp(booked) <= 1e-9 * scale


def test_impulses_explain_the_velocities_of_what_falls_asleep_and_wakes() -> None:
    space = Space(struck(expect={"contact_audit": 1e-12}), 1)
    for _ in space.run():
        pass
    audit = space.extremes.contact_audit
    assert audit is not None
    assert audit.value <= 1e-12


@pytest.mark.parametrize("timing", ["end-of-step", "time-of-impact"])
def test_a_run_with_sleepers_goes_on_from_any_frame_with_the_same_bits(timing: str) -> None:
    scene = struck(contact={"timing": timing})
    frames = frames_of(scene)
    asleep = [sleepers(frame) for frame in frames]
    fell = next(k for k in range(len(frames)) if asleep[k])
    woke = next(k for k in range(ASLEEP_BY, len(frames)) if asleep[k] == 0)
    for step in (fell - 1, fell, fell + 1, woke - 1, woke, woke + 1):
        stored = {name: values for name, (values, _) in encode([frames[step].checkpoint]).items()}
        space = Space(scene, 1, record_contacts=True)
        space.restore(decode(step, stored, len(PILE) + 1))
        again = list(itertools.islice(space.run(schedule=every(0.0)), STEPS + 1 - step))
        assert_same(frames[step:], again)


def test_threads_and_recorded_contacts_change_no_bit() -> None:
    once = frames_of(struck())
    assert_same(once, frames_of(struck(), threads=2))
    assert [frame.fingerprint for frame in once] == [frame.fingerprint for frame in frames_of(struck(), records=False)]


def test_nothing_sleeps_in_free_space() -> None:
    scene = Scene.from_dict(
        {
            "body": [{"position": [x, 0.0, 0.0], "mass": 1.0} for x in (-1.0, 1.0)],
            "gravity": {"constant": 1.0},
            "contact": {"sleep": {"speed": 1.0, "after": 0.1}},
            "time": {"duration": 1.0, "fixed_dt": 0.01},
            "record": {"every": "step"},
        }
    )
    assert sleepers(list(Space(scene).run())[-1]) == 0


@pytest.mark.parametrize(
    ("sections", "told"),
    [({"drag": {"relaxation_time": 1.0}}, r"\[drag\]"), ({"contact": {"solver": "staged"}}, "lasting")],
)
def test_keys_that_contradict_sleep_are_refused(sections: dict[str, Any], told: str) -> None:
    with pytest.raises(ValueError, match=told):
        pile(**sections)
