"""A clip of selected bodies contains only these, whether their data are recorded or replayed."""

from __future__ import annotations

from pathlib import Path

import pytest

import carom
from carom.errors import RecordingError
from carom.lab.fork.branch import Branch, start_of
from carom.lab.why.history import question_of
from carom.recording.edit.clip import clip
from carom.recording.edit.repair import repair
from carom.recording.read.recording import Recording
from carom.runs.recomputed import contacts_of, impacts_of
from carom.scene.load import Scene

TWO_PAIRS = {
    "time": {"duration": 1.0},
    "gravity": {"constant": 0.0},
    "body": [
        {"name": "A"},
        {"name": "B", "position": [3, 0, 0], "velocity": [-2, 0, 0]},
        {"name": "C", "position": [0, 9, 0]},
        {"name": "D", "position": [0, 12, 0], "velocity": [0, -3, 0]},  # meets C first, and harder than B meets A
    ],
}


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return carom.run(Scene.from_dict(TWO_PAIRS), tmp_path_factory.mktemp("pairs") / "pairs.rrd").path


@pytest.fixture
def struck(whole: Path, tmp_path: Path) -> Path:
    return clip(whole, tmp_path / "struck.rrd", bodies=[0, 1]).path


@pytest.fixture
def apart(whole: Path, tmp_path: Path) -> Path:
    return clip(whole, tmp_path / "apart.rrd", bodies=[0, 2]).path


def test_a_clip_of_bodies_that_did_not_meet_has_no_impacts(apart: Path) -> None:
    recording = Recording.open(apart)
    assert recording.impacts().num_rows == impacts_of(recording, replay=True).num_rows == 0
    assert recording.contacts().num_rows == 0
    assert recording.moment() == 1.0  # the last frame


def test_a_replay_of_a_clip_is_asked_about_its_bodies_only(struck: Path) -> None:
    recording = Recording.open(struck)
    for replay in (False, True):
        pairs = impacts_of(recording, replay=replay).select(["i", "j"]).to_pylist()
        assert pairs == [{"i": 0, "j": 1}]
        at = contacts_of(recording, 0.3, replay=replay).select(["i", "j"]).to_pylist()
        assert {(row["i"], row["j"]) for row in at} <= {(0, 1)}


def test_a_clip_is_refused_questions_about_bodies_that_it_does_not_show(struck: Path) -> None:
    with pytest.raises(RecordingError, match='does not contain body 2 "C": it is a clip of'):
        Recording.open(struck).impacts(body="C")


def test_a_clip_says_that_it_does_not_show_the_bodies_of_an_event(struck: Path) -> None:
    with pytest.raises(RecordingError, match='"impact" names no two bodies of this clip'):
        question_of(Recording.open(struck), None, None, "impact")


def test_a_clip_opens_at_the_impact_of_its_own_bodies(struck: Path) -> None:
    recording = Recording.open(struck)
    assert recording.impacts()["time"].to_pylist() == [recording.moment()]
    assert all(set(moment["bodies"]) <= {0, 1} for moment in recording.summary()["moments"].values())


def test_a_clip_of_some_bodies_cannot_be_forked(struck: Path) -> None:
    with pytest.raises(RecordingError, match="is a clip of selected bodies; use the whole recording"):
        start_of(Branch(struck, 0.1, ()))


def test_a_torn_clip_with_its_exact_start_is_repaired(struck: Path, tmp_path: Path) -> None:
    content = struck.read_bytes()
    torn, out = tmp_path / "torn.rrd", tmp_path / "repaired.rrd"
    torn.write_bytes(content[: len(content) - 100])  # inside the footer
    repair(torn, out)
    assert Recording.open(out).frames == Recording.open(struck).frames
