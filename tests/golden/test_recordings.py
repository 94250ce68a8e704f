"""Recordings of golden scenes, and clips of them, replay with the same bits; other threads change none of them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from carom_command import carom

SCENES = Path(__file__).parent / "scenes"
SHORT = {  # overrides for a short run of few bodies: with impacts at their own times, or with contacts at rest
    "cloud": ("contact.timing=time-of-impact", "record.every=0.1", "time.duration=0.5", "group.0.count=24"),
    "tray": ("record.every=0.2", "time.duration=0.8", "group.0.count=12"),
}


def told(folder: Path, *arguments: str) -> dict[str, Any]:
    """What a command that succeeds prints as JSON."""
    done = carom(*arguments, "--json", cwd=folder)
    assert done.returncode == 0, done.stdout + done.stderr
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def replay(folder: Path, path: str, *options: str) -> int:
    """Replay a recording, which must have the same bits; return how many frames were compared."""
    replayed = told(folder, "replay", path, *options)
    assert replayed["same"] and replayed["compared"] == replayed["frames"]
    return int(replayed["frames"])


@pytest.mark.parametrize("name", sorted(SHORT))
def test_a_recording_and_a_clip_of_it_replay_on_another_number_of_threads(name: str, tmp_path: Path) -> None:
    overrides = [word for override in SHORT[name] for word in ("--set", override)]
    path = str(SCENES / f"{name}.toml")
    recorded = told(tmp_path, "run", path, "-o", f"{name}.rrd", "--threads", "1", *overrides)
    assert replay(tmp_path, f"{name}.rrd", "--threads", "2") == recorded["frames"]
    clipped = told(tmp_path, "clip", f"{name}.rrd", "--from", "0.15", "--to", "0.45", "-o", "clip.rrd")
    assert replay(tmp_path, "clip.rrd") == clipped["frames"] > 1
