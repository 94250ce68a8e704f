"""A key that has a new name is read by its old one, too, with a note."""

from __future__ import annotations

import warnings
from pathlib import Path

import pytest

import carom
from carom.errors import SceneError
from carom.runs.replay import replay
from carom.scene.load import Scene
from carom.scene.overrides import OldNameWarning
from carom_command import carom as command

BODY = "[[body]]\nradius = 1.0\n"
OLD, NEW = f"{BODY}[record]\nlog_freq = 7\n", f"{BODY}[record]\ncheck_every = 7\n"


def write(folder: Path, text: str) -> Path:
    path = folder / "scene.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_a_file_with_the_old_name_is_the_same_scene_and_says_where_it_stands(tmp_path: Path) -> None:
    with pytest.warns(OldNameWarning, match=r"scene\.toml:4: record\.log_freq is now called record\.check_every"):
        old = Scene.load(write(tmp_path, OLD))
    assert old.record == Scene.load(write(tmp_path, NEW)).record and old.record.check_every == 7


@pytest.mark.parametrize("text", [BODY, OLD.replace("7", "9"), NEW.replace("7", "9")])
@pytest.mark.parametrize("name", ["log_freq", "check_every"])
@pytest.mark.filterwarnings("ignore::carom.scene.overrides.OldNameWarning")
def test_an_override_by_either_name_replaces_what_the_file_says_by_either(name: str, text: str, tmp_path: Path) -> None:
    scene = Scene.load(write(tmp_path, text), [f"record.{name}=7"])
    assert scene.record.check_every == 7
    assert Scene.load(write(tmp_path, scene.toml)) == scene


def test_an_override_by_the_old_name_is_warned_of(tmp_path: Path) -> None:
    with pytest.warns(OldNameWarning, match=r"the override record\.log_freq=7: record\.log_freq is now called"):
        Scene.load(write(tmp_path, BODY), ["record.log_freq=7"])


def test_an_old_and_a_new_name_of_one_key_together_are_refused(tmp_path: Path) -> None:
    path = write(tmp_path, f"{OLD}check_every = 7\n")
    with pytest.raises(SceneError) as raised:
        Scene.load(path)
    assert str(raised.value) == f"{path}:3: record: log_freq is the old name of check_every: give only one of them"
    with pytest.raises(SceneError, match=r"the overrides record\.check_every=1 and record\.log_freq=2 are two names"):
        Scene.load(write(tmp_path, BODY), ["record.check_every=1", "record.log_freq=2"])


def test_a_wrong_value_is_reported_by_the_name_that_was_written(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match=r"scene\.toml:4: record\.log_freq = 0: must be at least 1"):
        Scene.load(write(tmp_path, OLD.replace("7", "0")))


def test_a_recording_with_the_old_name_is_replayed_without_a_note(tmp_path: Path) -> None:
    scene = Scene.from_dict({"body": [{"velocity": [1, 0, 0]}], "time": {"duration": 3.0}, "record": {"log_freq": 2}})
    assert "log_freq" in scene.toml
    recording = carom.run(scene, tmp_path / "old.rrd")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert replay(recording).same


def test_the_command_says_it_once(tmp_path: Path) -> None:
    write(tmp_path, OLD)
    done = command("explain", "scene.toml", "--model", "spin", cwd=tmp_path)  # loads the scene twice
    assert done.returncode == 0, done.stderr
    notes = [line for line in done.stderr.splitlines() if "log_freq" in line]
    assert notes == ["carom: scene.toml:4: record.log_freq is now called record.check_every; the old name still works"]
