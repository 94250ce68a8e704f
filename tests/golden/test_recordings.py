"""Two recordings of schema 2 that every later version must read, replay, and clip.

`tray.rrd` has spins, friction, contacts at rest, planes and walls; `cloud.rrd` has gravity and impacts resolved at
their own times. Never record them again for a change of the format. Where a change of the physics is meant to move
bits, record them again with a version that writes schema 2, in this folder's `scenes`:

    carom run tray.toml -o tray.rrd --threads 1 --set record.every=0.2 --set time.duration=0.8 --set group.0.count=12
    carom run cloud.toml -o cloud.rrd --threads 1 --set contact.timing=time-of-impact --set record.every=0.1 \
        --set time.duration=0.5 --set group.0.count=24

Both were last recorded by commit 509dd12 with the later changes of the physics applied to it, and without the series of
`ADDED_SINCE`, which recordings of that time lacked. Since then, impacts in a field happen on parabolas, and slow ones
in free space at the end of the step. That is in no version that writes schema 2, so both replay with other bits from
the first impacts on (`SAME`); the fingerprints of this folder watch the bits of the physics.
"""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest

from carom.recording.read.recording import Recording
from carom_command import carom

RECORDINGS = Path(__file__).parent / "recordings"
NAMES = ("cloud", "tray")

INSPECTED: dict[str, dict[str, Any]] = {
    "cloud": {
        "scene": {"title": "Golden: a cloud that presses itself together"},
        "bodies": 24,
        "frames": 6,
        "steps": 163,
        "sim_time": 0.5,
        "outcome": "completed",
    },
    "tray": {
        "scene": {"title": "Golden: spheres thrown into a tray"},
        "bodies": 13,
        "frames": 5,
        "steps": 40,
        "sim_time": 0.8,
        "outcome": "completed",
    },
}
CONTACTS = {
    "cloud": {"total": 462, "max_overlap": 0.00029253232637681075, "impacts": 278, "impacts_counted": "each"},
    "tray": {"total": 88, "max_overlap": 5.430910332685188e-05, "impacts": 60, "impacts_counted": "each"},
}
CLIPPED = {  # frames and steps between 0.15 and 0.45 s
    "cloud": {"frames": 3, "first_step": 56, "last_step": 126, "replays_from": 0},
    "tray": {"frames": 2, "first_step": 10, "last_step": 20, "replays_from": 0},
}


ADDED_SINCE = ("step/impact_rate",)  # series that these recordings lack
SAME = False  # whether the physics is still that of the recordings


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with copies of the recordings."""
    for name in NAMES:
        shutil.copy(RECORDINGS / f"{name}.rrd", tmp_path)
    return tmp_path


def told(folder: Path, *arguments: str) -> dict[str, Any]:
    """What a command that succeeds prints as JSON."""
    done = carom(*arguments, "--json", cwd=folder)
    assert done.returncode == 0, done.stdout + done.stderr
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def replay(folder: Path, path: str, *options: str) -> dict[str, Any]:
    """Replay a recording; it must end with the same bits, or with a named difference."""
    done = carom("replay", path, *options, "--yes", "--json", cwd=folder)
    replayed: dict[str, Any] = json.loads(done.stdout)
    assert (done.returncode, replayed["same"], replayed["difference"] is None) == (0 if SAME else 1, SAME, SAME)
    assert not SAME or replayed["compared"] == replayed["frames"]
    return replayed


@pytest.mark.parametrize("name", NAMES)
def test_a_recording_of_schema_2_is_stored(name: str) -> None:
    assert Recording.open(RECORDINGS / f"{name}.rrd").info["schema_version"] == 2


@pytest.mark.parametrize("name", NAMES)
def test_a_recording_of_schema_2_inspects_as_on_the_day_it_was_made(name: str, folder: Path) -> None:
    inspected = told(folder, "inspect", f"{name}.rrd")
    assert inspected.items() >= INSPECTED[name].items()
    assert inspected["contacts"] == {**CONTACTS[name], "summed_over": "steps"}
    assert inspected["warnings"] == []
    assert inspected["moments"].keys() == {"contacts", "energy_error", "impact", "overlap"}


@pytest.mark.parametrize("name", NAMES)
def test_a_recording_of_schema_2_replays(name: str, folder: Path) -> None:
    replayed = replay(folder, f"{name}.rrd", "--threads", "2")
    assert replayed["frames"] == INSPECTED[name]["frames"]
    if SAME:
        assert replayed["not_compared"] == [f"/{series}, which the recording lacks" for series in ADDED_SINCE]


@pytest.mark.parametrize("name", NAMES)
def test_a_clip_of_a_recording_of_schema_2_replays(name: str, folder: Path) -> None:
    clipped = told(folder, "clip", f"{name}.rrd", "--from", "0.15", "--to", "0.45", "-o", "clip.rrd")
    assert clipped.items() >= CLIPPED[name].items()
    replayed = replay(folder, "clip.rrd")
    assert replayed["frames"] == CLIPPED[name]["frames"]
