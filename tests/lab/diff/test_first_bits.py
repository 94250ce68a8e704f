"""`carom diff` of two runs of one engine names the first frame and the bodies whose bits differ, and their contact."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import carom
from carom.lab.diff.diff import Diff, diff
from carom.recording.read.recording import Recording
from carom_command import carom as command


class Balls:
    """Three balls at rest, of which the first two touch, and a change of their state from a step on."""

    def __init__(self, at: int, change: Any) -> None:
        self.model = carom.record.Model(engine="balls 1", mass=np.ones(3), radius=np.full(3, 0.5))
        self.step, self._at, self._change = 0, at, change

    def state(self) -> carom.record.State:
        contact = np.zeros(1, carom.record.CONTACT)
        contact["j"], contact["point"], contact["normal"], contact["force"] = 1, [0.5, 0, 0], [1, 0, 0], 3.0
        position = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [9.0, 0.0, 0.0]])
        velocity, spin = np.zeros((3, 3)), np.ones((3, 3))
        state = carom.record.State(0.5 * self.step, position, velocity, None, spin, contact)
        if self.step >= self._at:
            self._change(state)
        return state


def run(path: Path, change: Any = lambda state: None, at: int = 5) -> Recording:
    balls = Balls(at, change)
    with carom.record.Recorder(balls, path) as recorder:
        for balls.step in range(1, 10):
            recorder.frame()
    return Recording.open(path)


def one_bit(state: carom.record.State) -> None:
    state.angular_velocity[1, 2] = np.nextafter(1.0, 2.0)


def minus_zero(state: carom.record.State) -> None:
    state.velocity[2, 0] = -0.0


def force(state: carom.record.State) -> None:
    one_bit(state)
    state.contacts["force"] = 4.0


def no_contact(state: carom.record.State) -> None:
    one_bit(state)
    state.contacts = state.contacts[:0]


@pytest.fixture(scope="module")
def same(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return run(tmp_path_factory.mktemp("same") / "a.rrd")


def test_one_bit_in_the_last_place_is_found_in_its_frame_and_body(same: Recording, tmp_path: Path) -> None:
    for change, bodies, arrays in ((one_bit, [1], ["angular velocity"]), (minus_zero, [2], ["velocity"])):
        found = diff(same, run(tmp_path / f"{change.__name__}.rrd", change)).first_bits
        assert found is not None and (found.step, found.time) == (5, 2.5)
        assert (found.bodies, found.arrays) == (bodies, arrays)
    assert diff(same, run(tmp_path / "again.rrd")).first_bits is None


def test_the_contact_whose_force_differs_is_named(same: Recording, tmp_path: Path) -> None:
    def contact(found: Diff) -> Any:
        assert found.first_bits is not None and found.first_bits.contact is not None
        return found.first_bits.contact.ends, found.first_bits.contact.forces

    assert contact(diff(same, run(tmp_path / "force.rrd", force))) == ((0, 1), (3.0, 4.0))
    assert contact(diff(same, run(tmp_path / "none.rrd", no_contact))) == ((0, 1), (3.0, None))


def test_the_command_says_where_the_first_bits_differ(same: Recording, tmp_path: Path) -> None:
    run(tmp_path / "b.rrd", force)
    done = command("diff", str(same.path), "b.rrd", cwd=tmp_path)
    text = " ".join(done.stdout.split())
    assert done.returncode == 1 and "first bits step 5, t = 2.5 s: angular velocity of body 1" in text
    assert "contact of body 0 and body 1: normal force 3 N in A, 4 N in B" in text
    assert "impacts not compared" in text
    document = json.loads(command("diff", str(same.path), "b.rrd", "--json", cwd=tmp_path).stdout)
    assert document["first_bits"]["names"] == ["body 1"] and document["first_bits"]["contact"]["forces"] == [3.0, 4.0]
