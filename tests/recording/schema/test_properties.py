"""The table of properties has every key that a recording may have."""

from __future__ import annotations

from fnmatch import fnmatchcase
from pathlib import Path

from carom import run
from carom.lab.diff.diff import diff, overlay
from carom.recording.edit.clip import clip
from carom.recording.edit.repair import repair
from carom.recording.read.recording import Recording
from carom.recording.schema.properties import PROPERTIES
from small_scenes import pair

PREFIX = "__properties/"


def test_every_key_of_a_property_is_accepted_by_a_row(tmp_path: Path) -> None:
    promises = {"max_overlap": 1.0, "energy_error": 1.0, "momentum_error": 1.0}
    whole, cut, both, torn, mended = (tmp_path / f"{name}.rrd" for name in ("run", "clip", "both", "torn", "mended"))
    recording = Recording.open(run(pair(expect=promises), whole).path)
    clip(whole, cut, 0.0, 0.5, bodies=[0], exact=False)
    overlay(recording, recording, diff(recording, recording), both)
    torn.write_bytes(whole.read_bytes()[:-1000])
    repair(torn, mended)
    seen = set()
    for path in (whole, cut, both, mended):
        found = Recording.open(path)
        names = {entry.entity_path for entry in found.store.entries if entry.entity_path.startswith(PREFIX)}
        for name in (path.removeprefix(PREFIX) for path in names):
            keys = found._entities.properties(name)
            assert not [key for key in keys if not any(fnmatchcase(key, row.key) for row in PROPERTIES[name])], name
            seen.add(name)
    assert set(PROPERTIES) - seen == {"sweep", "tradeoff"}, "nothing here writes them"
