"""The spins of a run's contacts: a few that differ, another inertia, another frame, and a resistance to rolling."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from carom.engines.contact_torques import FEWEST, ContactTorque, ContactTorques
from carom.engines.faults import BrokenThen

RNG = np.random.default_rng(5)
COUNT = 3 * FEWEST
TORQUES = RNG.normal(size=(COUNT, 3))
SCATTER = 1.0 + 0.003 * RNG.normal(size=(COUNT, 1))


def torques(scale: np.ndarray, *, rolls: bool = False, turned: bool = False) -> ContactTorques:
    """Return the torques of bodies 0 to 5, of which an engine has applied a part; by the second way, they are exact."""
    found = ContactTorques()
    for k, torque in enumerate(TORQUES):
        change = scale[k] * SCATTER[k] * torque
        other = np.roll(torque, 1)  # in another frame, another torque
        ways = np.array([1.1 * torque + 0.1 * other, torque])
        seen = np.array([*other]) if turned else change
        sample = ContactTorque(k, 0.1 * k, k % 6, seen, change, ways, rolls)
        found.add(sample, largest=1.0, noise=1e-3)
    return found


def named(found: ContactTorques) -> list[BrokenThen]:
    return list(found.concluded())


def test_torques_as_their_contacts_tell_break_no_law() -> None:
    assert named(torques(np.ones(COUNT))) == []
    assert named(ContactTorques(torques(np.full(COUNT, 0.8)).samples[: FEWEST - 1])) == []  # too few to know


@pytest.mark.parametrize("part", [0.8, 1.2, -1.0])
def test_a_torque_that_differs_from_the_others_is_named(part: float) -> None:
    scale = np.ones(COUNT)
    scale[7] = part
    ((step, _, broken),) = named(torques(scale))
    assert (step, broken.ends) == (7, (1,)) and broken.excess > 1.0


def test_an_engine_with_another_inertia_is_named_from_its_first_contact_on() -> None:
    found = named(torques(np.full(COUNT, 0.8)))
    assert [step for step, *_ in found] == list(range(COUNT)) and "like other bodies, by 0." in found[0][2].what


def test_spins_in_the_frame_of_the_body_are_named_once_they_differ() -> None:
    found = named(torques(np.ones(COUNT), turned=True))
    assert found[0][0] == 0 and "in the frame of the body" in found[0][2].what


def test_a_body_that_resists_rolling_in_all_its_contacts_is_not_accused() -> None:
    scale = np.where(np.arange(COUNT) % 6 == 2, 0.7, 1.0)  # all contacts of one body
    assert named(torques(scale, rolls=True)) == []
    assert {broken.ends for *_, broken in named(torques(scale))} == {(2,)}
    one = torques(scale, rolls=True)
    one.samples[2] = replace(one.samples[2], change=one.samples[2].ways[1])
    assert {broken.ends for *_, broken in named(one)} == {(2,)}  # its other contacts do not resist


def test_small_torques_are_not_compared() -> None:
    found = ContactTorques()
    for torque in TORQUES:
        found.add(ContactTorque(0, 0.0, 0, torque, None, torque[None], False), largest=1e3, noise=0.0)
        found.add(ContactTorque(0, 0.0, 0, torque, None, torque[None], False), largest=0.0, noise=1.0)
    assert found.samples == []
