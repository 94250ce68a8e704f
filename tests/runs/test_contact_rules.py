"""The meaning of `contact.sweeps = "auto"` has a version: recordings of the first one run again with their bits."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import carom
from carom.recording.read.recorded_scene import recorded_scene
from carom.recording.read.recording import Recording
from carom.runs.replay import replay
from carom.runs.resume import resume
from carom.scene.schema import Scene
from small_scenes import scene_of

# Balls in a crystal on a floor that begin to press on each other without impulses. They are an island with 1408
# contacts, 2.75 a ball, so that the rules differ.
SIDE = 8
BALLS = [{"position": [2.0 * i, 2.0 * j, 1.0 + 2.0 * k]} for i, j, k in np.ndindex(SIDE, SIDE, SIDE)]


def crystal(duration: float, **contact: str) -> Scene:
    return scene_of(
        BALLS,
        plane=[{}],
        gravity={"constant": 0.0, "uniform": [4.0, 1.0, -9.81]},  # across, too: balls slide, and searches are long
        contact={"restitution": 0.0, **contact},
        time={"duration": duration, "max_dt": 0.02},
    )


def bits(recording: Recording) -> list[int]:
    found: list[int] = recording.fingerprints()["fingerprint"].to_pylist()
    return found


@pytest.fixture(scope="module")
def old(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    """A recording as the first versions wrote it."""
    return carom.run(crystal(0.1).by_contact_rules(1), tmp_path_factory.mktemp("old") / "old.rrd")


@pytest.fixture(scope="module")
def later(tmp_path_factory: pytest.TempPathFactory) -> dict[int, Recording]:
    """Recordings by the later versions of the rules, but the present one."""
    folder = tmp_path_factory.mktemp("later")
    return {rules: carom.run(crystal(0.1).by_contact_rules(rules), folder / f"{rules}.rrd") for rules in (2, 3)}


def test_a_recording_of_today_names_its_rules_and_one_that_does_not_has_the_first_ones(
    old: Recording, later: dict[int, Recording], tmp_path: Path
) -> None:
    new = carom.run(crystal(0.1), tmp_path / "new.rrd")
    for rules, recording in (*later.items(), (4, new)):
        assert (recording.info["contact_rules"], recorded_scene(recording).contact_rules) == (rules, rules)
    assert "contact_rules" not in old.info
    assert recorded_scene(old).contact_rules == 1
    assert new.scene_toml == old.scene_toml
    assert len({tuple(bits(recording)) for recording in (old, *later.values(), new)}) == 4


def test_an_older_recording_replays_with_its_bits_which_sweeps_converged_asks_for(
    old: Recording, tmp_path: Path
) -> None:
    result = replay(old)
    assert result.same and result.not_compared == []
    assert bits(carom.run(crystal(0.1, sweeps="converged"), tmp_path / "converged.rrd")) == bits(old)


def test_an_older_recording_is_continued_by_its_rules(
    old: Recording, later: dict[int, Recording], tmp_path: Path
) -> None:
    for rules, begun in ((1, old), *later.items()):
        whole = carom.run(crystal(0.2).by_contact_rules(rules), tmp_path / f"whole_{rules}.rrd")
        longer = resume(begun, 0.2, tmp_path / f"longer_{rules}.rrd")
        assert longer.info.get("contact_rules", 1) == rules
        assert bits(longer) == bits(whole)


@pytest.mark.parametrize("rules", [2, 3])
def test_a_recording_of_later_rules_replays_with_its_bits(later: dict[int, Recording], rules: int) -> None:
    assert replay(later[rules]).same


def test_a_scene_of_earlier_rules_keeps_them_if_other_keys_change(old: Recording) -> None:
    changed = recorded_scene(old).changed(["time.duration=0.02"])
    assert (changed.contact_rules, changed.contact.sweeps) == (1, "converged")
    assert changed.toml.count("sweeps") == 0
