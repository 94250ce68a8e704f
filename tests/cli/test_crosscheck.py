"""`carom crosscheck`, run as a person runs it."""

from __future__ import annotations

import json
import sys
from contextlib import nullcontext
from pathlib import Path

import pytest

from carom.engines.crosscheck.crosscheck import Crosscheck, CrosscheckTask, Followed, Runs
from carom.engines.engine import engines_called
from carom.recording.read.recording import Recording
from carom.scene.load import Scene
from carom.scene.scene_file import crosscheck_scenes
from carom_command import carom

pytestmark = [
    pytest.mark.slow,
    pytest.mark.needs("rebound", "mujoco"),
]  # each engine and the reference run once for all of them, some six seconds

SCENE = """
title = "Light on heavy"

[time]
duration = 1.0
max_dt = 0.01

[gravity]
constant = 0.0

[contact]
restitution = 1.0
static_friction = 0.0

[[body]]
name = "light"
position = [-0.5, 0.0, 0.0]
velocity = [1.0, 0.0, 0.0]
radius = 0.1
mass = 1.0

[[body]]
name = "heavy"
position = [0.0, 0.05, 0.0]
radius = 0.1
mass = 3.0

[expect]
energy_error = 1e-3
momentum_error = 1e-9
max_overlap = 1e-3
"""


@pytest.fixture(scope="module")
def checked(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("crosscheck")
    (folder / "pair.toml").write_text(SCENE, encoding="utf-8")
    done = carom("crosscheck", "pair.toml", "--engine", "rebound,mujoco", "--repeats", "1", "-o", "out", cwd=folder)
    assert done.returncode == 0, done.stderr
    (folder / "printed.txt").write_text(done.stdout, encoding="utf-8")
    return folder


def test_each_engine_is_judged_by_the_criteria_and_by_the_reference(checked: Path) -> None:
    document = json.loads((checked / "out" / "crosscheck.json").read_text(encoding="utf-8"))
    runs = {run["name"].split(",")[0].split(" ")[0]: run for run in document["runs"]}
    assert all(criterion["met"] for criterion in runs["carom"]["criteria"]) and runs["carom"]["parting"] is None
    missed = [each["name"] for each in runs["mujoco"]["criteria"] if each["judged"] and not each["met"]]
    assert missed == ["max_overlap"]  # its contacts are springs
    parting = next(run["parting"] for run in document["runs"] if run["engine"] == "mujoco" and "0.01 s" in run["name"])
    assert parting["impact"] == 1 and parting["between"] == 'body 0 "light" and body 1 "heavy"'
    assert parting["laws"] == ["overlap"]
    assert runs["rebound"]["laws"] == {} and runs["rebound"]["errors"]["momentum"] < 1e-12  # a few roundings
    assert all(len(run["costs"]) == 1 for run in document["runs"])


def test_there_are_a_table_a_figure_and_a_recording_of_all_and_of_each(checked: Path) -> None:
    printed = (checked / "printed.txt").read_text(encoding="utf-8")
    for part in ("criteria", "not max_overlap", "impact 1, body 0", "contacts are springs", "Reference, exact"):
        assert part in printed
    folder = checked / "out"
    assert (folder / "crosscheck.png").read_bytes().startswith(b"\x89PNG")
    assert Recording.open(folder / "crosscheck.rrd").is_overlay
    assert Recording.open(folder / "mujoco-dt-0.01-s.rrd").engine.startswith("mujoco ")
    assert Recording.open(folder / "carom.rrd").outcome == "completed"


def test_the_same_command_measures_nothing_twice(checked: Path) -> None:
    before = {path.name: path.stat().st_mtime_ns for path in (checked / "out").glob("mujoco*.rrd")}
    words = ("crosscheck", "pair.toml", "--engine", "rebound,mujoco", "--repeats", "1", "-o", "out", "--json")
    done = carom(*words, cwd=checked)
    assert done.returncode == 0, done.stderr
    assert [len(run["costs"]) for run in json.loads(done.stdout)["runs"]] == [1] * 5
    assert before == {path.name: path.stat().st_mtime_ns for path in (checked / "out").glob("mujoco*.rrd")}


def test_the_document_names_the_units_of_its_numbers(tmp_path: Path) -> None:
    for units, first in (("SI", ""), ("cm, ms, g", 'units = "cm, ms, g"')):
        (tmp_path / "pair.toml").write_text(first + SCENE, encoding="utf-8")
        check = Crosscheck(Scene.load(tmp_path / "pair.toml"), engines_called(["rebound"]), tmp_path / units)
        assert check.document()["units"] == units


def test_a_plastic_impact_is_compared_after_it(checked: Path) -> None:
    # MuJoCo's contact springs do not stop at e = 0; the pair must go on together, which the reference knows
    plastic = SCENE.replace("restitution = 1.0", "restitution = 0.0").replace("0.05, 0.0]", "0.0, 0.0]")
    (checked / "plastic.toml").write_text(plastic, encoding="utf-8")
    done = carom("crosscheck", "plastic.toml", "--engine", "mujoco", "--repeats", "1", "-o", "plastic", cwd=checked)
    assert done.returncode == 0, done.stderr
    document = json.loads((checked / "plastic" / "crosscheck.json").read_text(encoding="utf-8"))
    assert document["reference"]["complete"]
    own, *others = document["runs"]
    assert own["parting"] is None and own["errors"]["position"] < 1e-13
    assert any(run["parting"] is not None and run["errors"]["position"] > 0.1 for run in others)


@pytest.mark.nightly
def test_where_the_reference_ends_no_run_is_said_to_stay_with_it(checked: Path) -> None:
    # head-on, and with gravity that holds them together
    pressed = SCENE.replace("restitution = 1.0", "restitution = 0.0").replace("0.05, 0.0]", "0.0, 0.0]")
    pressed = pressed.replace("constant = 0.0", "constant = 1e-3")
    (checked / "pressed.toml").write_text(pressed, encoding="utf-8")
    words = ("--engine", "rebound", "--repeats", "1", "--workers", "1")
    done = carom("crosscheck", "pressed.toml", *words, "-o", "pressed", cwd=checked)
    assert done.returncode == 0, done.stderr
    assert "nowhere" not in done.stdout
    assert "not compared after 0.29" in done.stdout and "position up to t = 0.29" in done.stdout  # they meet at 0.298 s
    several = carom("crosscheck", "pressed.toml", "pair.toml", *words, "-o", "both", cwd=checked)
    assert "not compared after 0.29" in several.stdout


def test_criteria_that_a_run_could_not_show_are_neither_met_nor_missed(checked: Path) -> None:
    document = json.loads((checked / "out" / "crosscheck.json").read_text(encoding="utf-8"))
    criteria = {run["name"]: {each["name"]: each for each in run["criteria"]} for run in document["runs"]}
    assert criteria["carom"]["energy_error"]["met"] is True
    others = [each["energy_error"] for name, each in criteria.items() if name != "carom"]
    assert {(each["judged"], each["met"]) for each in others} == {(False, None)}, "contacts take energy, too"
    assert "not judged: energy_error" in (checked / "printed.txt").read_text(encoding="utf-8")


class InterruptedRuns(Runs):
    """Follows a number of runs in this process; the next one is interrupted."""

    def __init__(self, allowed: int) -> None:
        super().__init__(1)
        self.allowed, self.followed = allowed, list[str]()

    def result(self, task: CrosscheckTask) -> Followed:
        if len(self.followed) == self.allowed:
            raise KeyboardInterrupt
        self.followed.append(task.setting.name)
        return super().result(task)


def test_an_interruption_loses_only_the_run_that_is_being_followed(tmp_path: Path) -> None:
    scene = tmp_path / "pair.toml"
    scene.write_text(SCENE, encoding="utf-8")
    engines = engines_called(["rebound", "mujoco"])
    followed = []
    for allowed in (1, 2, 9):
        runs = InterruptedRuns(allowed)
        check = Crosscheck(Scene.load(scene), engines, tmp_path / "out", runs=runs)
        with nullcontext() if allowed == 9 else pytest.raises(KeyboardInterrupt):
            check.follow(lambda text: None)
        followed.append(runs.followed)
    assert [len(names) for names in followed] == [1, 2, 1]
    assert len({name for names in followed for name in names}) == 4  # of each engine the two steps


def test_parts_of_a_scene_that_an_engine_cannot_represent_are_named_before_anything_runs(tmp_path: Path) -> None:
    done = carom("crosscheck", "kepler-orbits", "--engine", "mujoco", "-o", "out", cwd=tmp_path)
    assert done.returncode == 2 and done.stderr.count("\n") == 1
    assert "mujoco cannot represent this scene: the bodies' own gravity" in done.stderr
    assert not (tmp_path / "out").exists()


def test_several_scenes_make_one_table_and_one_folder_each_and_name_what_no_engine_can_represent(checked: Path) -> None:
    words = ("crosscheck", "pair.toml", "crosscheck/cannon-fast-ball", "extremes/dense-gas", "--engine", "mujoco")
    done = carom(*words, "--repeats", "1", "--limit", "20", "-o", "several", "--workers", "2", cwd=checked)
    assert done.returncode == 0, done.stderr
    assert "2/3  crosscheck/cannon-fast-ball: " in done.stderr
    assert "extremes/dense-gas: mujoco cannot represent this scene: a periodic box" in done.stdout
    report = "a ball that passes through its target (https://github.com/schteppe/cannon.js/issues/202)"
    assert report in done.stdout and "2 scenes; 1 cannot be represented by any of the engines" in done.stdout
    kept = {path.parent.name for path in (checked / "several").glob("*/crosscheck.json")}
    assert kept == {"pair", "cannon-fast-ball"}


def test_a_run_that_takes_longer_than_the_limit_is_stopped_and_says_so(checked: Path) -> None:
    words = ("crosscheck", "pair.toml", "--engine", "mujoco", "--repeats", "1", "--limit", "1e-9", "-o", "short")
    done = carom(*words, "--json", cwd=checked)
    assert done.returncode == 0, done.stderr
    runs = [run for run in json.loads(done.stdout)["runs"] if run["engine"]]
    assert {run["status"] for run in runs} == {"failed"}
    assert all("it took more than 1e-09 s of CPU time (--limit)" in run["reason"] for run in runs)


def test_an_engine_that_is_not_installed_is_named_with_the_line_that_installs_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pybullet", None)
    done = carom("crosscheck", "two-spheres", "--engine", "pybullet", "-o", "out", cwd=tmp_path)
    assert done.returncode == 2
    assert done.stderr == "carom: --engine pybullet: the engine pybullet is not installed: pip install pybullet\n"
    unknown = carom("crosscheck", "two-spheres", "--engine", "bullet", cwd=tmp_path)
    assert unknown.returncode == 2 and '--engine bullet: unknown; did you mean "pybullet"' in unknown.stderr
    for none in ((), ("--engine", " ,")):
        done = carom("crosscheck", "two-spheres", *none, cwd=tmp_path)
        assert done.returncode == 2 and "--engine: names no engine; expected some of rebound" in done.stderr


@pytest.mark.parametrize("name", crosscheck_scenes())
def test_a_scene_of_a_bug_report_names_the_report_and_promises_what_is_right(name: str) -> None:
    path = crosscheck_scenes()[name]
    first = path.read_text(encoding="utf-8").splitlines()[0]
    assert first.startswith("# From https://github.com/") and "/issues/" in first
    assert Scene.load(path).expect.max_overlap is not None
