"""A study measures each setting once, can be resumed, and names missing measurements."""

from __future__ import annotations

import json
import warnings
from pathlib import Path

import numpy as np
import pytest

from carom.errors import ExperimentError, PhysicsError, RecordingError, SceneError
from carom.lab import compared_run as trajectory
from carom.lab.compared_run import Setting
from carom.lab.tradeoff import _legend, notes_on_rows, setting_runs, table_of, tradeoff
from carom.lab.tradeoff.setting_runs import SettingRuns
from carom.lab.tradeoff.settings_grid import SettingResult, default_settings, vary
from carom.lab.tradeoff.tradeoff import Study
from carom.lab.tradeoff.tradeoff_figure import draw, record
from carom.recording.read.recording import Recording
from carom.scene.load import Scene
from carom.terminal.answers import print_parts
from small_scenes import cloud, pair


def eight() -> Scene:
    return Scene.load("figure-eight", ["time.duration=1.0", "time.fixed_dt=0.01"])


def measured(scene: Scene, folder: Path, *choices: str, repeats: int = 1) -> tuple[Study, list[str]]:
    said: list[str] = []
    study = Study(scene, folder, threads=1)
    study.measure(vary(scene, list(choices)), repeats, said.append)
    return study, said


def test_every_setting_gets_its_errors_and_as_many_costs_as_asked_for(tmp_path: Path) -> None:
    study, _ = measured(eight(), tmp_path, "time.integrator=leapfrog,yoshida4", "step=2,1", repeats=2)
    assert [result.setting.name for result in study.results] == [
        "integrator = leapfrog, steps 2 times as long",
        "integrator = leapfrog",
        "integrator = yoshida4, steps 2 times as long",
        "integrator = yoshida4",
    ]
    assert all(len(result.costs) == 2 and result.complete for result in study.results)
    errors = [result.errors.position for result in study.results if result.errors]
    assert errors == sorted(errors, reverse=True)
    document = json.loads((tmp_path / "tradeoff.json").read_text(encoding="utf-8"))
    assert document["reference"]["kind"] == "exact" and len(document["settings"]) == 4
    assert document["settings"][0]["errors"]["overlap"] is None, "no contact is possible"
    assert set(study.marks("position").values()) <= {"front", "near", ""}
    assert "front" in study.marks("position").values()


def test_a_setting_is_measured_once(tmp_path: Path) -> None:
    first, _ = measured(eight(), tmp_path, "step=2,1")
    again, said = measured(eight(), tmp_path, "step=2,1")
    assert said == []
    assert [r.costs for r in again.results] == [r.costs for r in first.results]
    assert repr([r.errors for r in again.results]) == repr([r.errors for r in first.results]), "NaN is not NaN"
    more, said = measured(eight(), tmp_path, "step=2,1,0.5", repeats=2)
    assert said[0] == "3/3  steps 2 times as short: errors" and sum("errors" in text for text in said) == 1
    assert [len(r.costs) for r in more.results] == [2, 2, 2]
    assert more.results[0].costs[0] == first.results[0].costs[0]


def test_a_study_that_was_stopped_keeps_what_is_done(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    follow = trajectory.follow
    followed = []

    def stopped(*arguments: object) -> object:
        followed.append(1)
        if len(followed) == 3:
            raise KeyboardInterrupt
        return follow(*arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(setting_runs, "follow", stopped)
    with pytest.raises(KeyboardInterrupt):
        measured(eight(), tmp_path, "step=8,4,2,1")
    monkeypatch.undo()
    _, said = measured(eight(), tmp_path, "step=8,4,2,1")
    assert [text for text in said if text.endswith("errors")] == [
        "3/4  steps 2 times as long: errors",
        "4/4  as written: errors",
    ]
    assert not any("reference" in text for text in said)


def test_another_scene_in_the_folder_is_refused_unless_forced(tmp_path: Path) -> None:
    measured(eight(), tmp_path, "step=2")
    changed = Scene.load("figure-eight", ["time.duration=0.5"])
    with pytest.raises(ExperimentError, match="a study of another scene or of an earlier version of this scene"):
        Study(changed, tmp_path)
    assert Study(changed, tmp_path, force=True).results == []


def test_a_study_of_a_sheared_box_is_refused(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match=r"domain\.shear: .* cannot be measured yet; remove it"):
        Study(Scene.load("shear-cell"), tmp_path / "study")
    assert not (tmp_path / "study").exists()


@pytest.mark.parametrize("name", ["tradeoff.png", "tradeoff.rrd", "reference.npz"])
def test_a_file_in_the_folder_that_no_study_made_is_not_replaced(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_bytes(b"mine")
    with pytest.raises(ExperimentError, match=rf"{name}: exists, and no study in .* made it"):
        Study(eight(), tmp_path)
    assert (tmp_path / name).read_bytes() == b"mine"


@pytest.mark.parametrize("text", ["", "{}", "[]", '{"version": 1, "scene": {"toml": ""}}'])
def test_a_document_that_is_not_one_is_a_message(tmp_path: Path, text: str) -> None:
    (tmp_path / "tradeoff.json").write_text(text, encoding="utf-8")
    with pytest.raises(ExperimentError, match=r"tradeoff\.json: cannot be resumed"):
        Study(eight(), tmp_path)


def test_a_refused_setting_is_kept_with_the_reason_and_tried_again_next_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(scene: Scene) -> None:
        raise SceneError("not in this version")

    with monkeypatch.context() as patch:
        patch.setattr(setting_runs, "Space", refuse)
        study, _ = measured(eight(), tmp_path, "step=2")
    assert (study.results[0].status, study.results[0].reason) == ("refused", "not in this version")
    study, _ = measured(eight(), tmp_path, "step=2")
    assert study.results[0].complete


def test_a_run_that_fails_is_kept_with_the_reason(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*arguments: object) -> None:
        raise PhysicsError("the state is no longer finite")

    monkeypatch.setattr(setting_runs, "follow", fail)
    study, _ = measured(eight(), tmp_path, "step=2")
    assert (study.results[0].status, study.results[0].reason) == ("failed", "the state is no longer finite")
    assert not study.results[0].costs


def test_a_bounded_setting_stops_at_a_number_of_steps_and_the_scene_as_written_does_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def outcomes() -> list[tuple[str, str, int, bool]]:
        study = Study(eight(), tmp_path, threads=1, bounded=True)
        study.measure(vary(eight(), ["step=1,0.5"]), 1, lambda text: None)
        return [(r.status, r.reason, r.steps, r.complete) for r in study.results]

    monkeypatch.setattr(tradeoff, "WORK", 33.0 * 75.0)
    monkeypatch.setattr(tradeoff, "DEARER", 1.0)
    written = ("measured", "", 100, True)
    stopped = ("stopped", "stopped after 100 steps, at t = 0.5 s", 100, False)
    assert outcomes() == [written, stopped]
    entry = json.loads((tmp_path / "tradeoff.json").read_text(encoding="utf-8"))["settings"][1]
    assert (entry["status"], entry["reason"], entry["steps"]) == stopped[:3]
    monkeypatch.setattr(tradeoff, "DEARER", 3.0)
    assert outcomes() == [written, ("measured", "", 200, True)]


def test_a_run_that_takes_longer_than_the_limit_says_so(tmp_path: Path) -> None:
    study = Study(eight(), tmp_path, threads=1)
    study.limit = 0.0
    study.measure(vary(eight(), ["step=1"]), 1, lambda text: None)
    assert study.results[0].status == "stopped" and "s of CPU time (--limit), at t = 0.01 s" in study.results[0].reason


def test_what_the_budget_cannot_pay_is_left_out_and_measured_by_the_next_command(tmp_path: Path) -> None:
    settings, said = vary(eight(), ["step=1,2,4"]), list[str]()
    study = Study(eight(), tmp_path, threads=1, budget=0.0)
    study.measure(settings, None, said.append)
    assert [result.complete for result in study.results] == [True, False, False], "the first is always measured"
    assert study.left_out == dict.fromkeys(
        ["steps 2 times as long", "steps 4 times as long"], "the budget of 0 s was spent"
    )
    document = json.loads((tmp_path / "tradeoff.json").read_text(encoding="utf-8"))
    assert document["left_out"] == study.left_out and document["budget"] == 0.0
    assert len(table_of(study).cells()) == 1
    later = Study(eight(), tmp_path, threads=1)
    later.measure(settings, None, said.append)
    assert all(result.complete for result in later.results) and not later.left_out


@pytest.mark.slow
def test_the_default_budget_is_thirty_times_the_run_and_at_least_five_seconds(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for cost, seconds in ((0.01, 5.0), (2.0, 60.0)):
        monkeypatch.setattr(SettingRuns, "cost", lambda runs, result, cost=cost: cost)
        said: list[str] = []
        study = Study(eight(), tmp_path / f"{cost}", threads=1, budget=None)
        study.measure(vary(eight(), ["step=1,2"]), None, said.append)
        assert study.budget.seconds == seconds
        assert any(f" s of {seconds:g} s left" in text for text in said), "what is left is told for each setting"


@pytest.mark.slow
def test_shorter_steps_than_those_of_an_exact_setting_are_not_measured(tmp_path: Path) -> None:
    scene = pair(time={"duration": 3.0, "fixed_dt": 0.02})  # no force: flights and the impact are exact
    settings = vary(scene, ["step=1,2,0.5"])
    study = Study(scene, tmp_path, threads=1)
    study.measure(settings, None, lambda text: None, chooses=True)
    (reason,) = study.left_out.values()
    assert list(study.left_out) == ["steps 2 times as short"]
    assert reason.endswith("errs by rounding alone, and shorter steps cost more")
    study.measure(settings, None, lambda text: None)
    assert not study.left_out, "a setting that was chosen by hand is measured"


@pytest.mark.slow
def test_a_setting_that_another_one_beats_clearly_is_not_timed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    price = {"integrator = yoshida4, steps 2 times as long": 0.01}
    monkeypatch.setattr(SettingRuns, "cost", lambda runs, result: price.get(result.setting.name, 1.0))
    scene = eight()
    settings = [*vary(scene, ["step=1"]), *vary(scene, ["time.integrator=yoshida4", "step=2"])]
    settings += vary(scene, ["time.integrator=leapfrog", "step=4,1"])
    assert settings[0].apply(scene).time.integrator != "leapfrog"
    study = Study(scene, tmp_path, threads=1)
    study.measure(settings, None, lambda text: None, chooses=True)
    # leapfrog has more error of every kind than yoshida4 with twice the step, and by its steps takes 25 times its time
    assert study.left_out["integrator = leapfrog"].endswith("is as accurate and clearly cheaper")


def test_short_runs_are_timed_until_their_time_is_known_and_long_ones_three_times(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    noise = np.random.default_rng(1)
    price = {"as written": 0.02, "steps 2 times as long": 0.06}
    monkeypatch.setattr(SettingRuns, "cost", lambda runs, result: price[result.setting.name] * noise.uniform(0.8, 1.25))
    study = Study(eight(), tmp_path, threads=1)
    short, long = study.measure(vary(eight(), ["step=1,2"]), None, lambda text: None)
    assert len(short.costs) > 3 and short.spread <= 0.05 and len(long.costs) <= 3


def test_the_spread_is_the_interval_of_the_median_and_shrinks_with_the_number_of_runs() -> None:
    noise = np.random.default_rng(2)
    missed = 0
    for _ in range(200):
        result = SettingResult(Setting("", ()), costs=noise.exponential(1.0, 40).tolist())
        missed += abs(result.cost - np.log(2.0)) > 2.0 * result.spread * result.cost
        assert 2.0 * result.spread * result.cost < max(result.costs) - min(result.costs)
    assert missed <= 20, "the median of the distribution is in its 95 % interval, or near"
    assert SettingResult(Setting("", ()), costs=[1.0, 1.2, 1.1]).spread == pytest.approx(0.1 / 1.1)


def test_a_refined_reference_is_finer_than_the_finest_setting(tmp_path: Path) -> None:
    scene = cloud(time={"duration": 0.2})
    study, _ = measured(scene, tmp_path, "step=1")
    assert study.reference and study.reference.fineness >= 4.0
    study, said = measured(scene, tmp_path, "step=1,0.125")
    assert study.reference and study.reference.fineness >= 16.0 and said[0].startswith("reference")
    assert repr(study.results[0].errors) == repr(study.reference.errors(study.trajectory(study.results[0])))


def test_the_recording_of_a_study_holds_every_trajectory(tmp_path: Path) -> None:
    study, _ = measured(eight(), tmp_path, "step=4,1")
    record(study, tmp_path / "tradeoff.rrd")
    shown = Recording.open(tmp_path / "tradeoff.rrd")
    assert shown.finished and shown.is_overlay and shown.frames == 600 and shown.layout()
    drawn = {entry.entity_path for entry in shown.store.entries}
    for course in ("00-reference-exact", "01-steps-4-times-as-long", "02-as-written"):
        assert {f"world/{course}/bodies", f"world/{course}/paths"} <= drawn
    assert {
        "distance/01-steps-4-times-as-long",
        "distance/02-as-written",
    } <= drawn and "distance/00-reference-exact" not in drawn
    assert shown.moment() == pytest.approx(1.0)
    for ask in (shown.summary, lambda: shown.scene_toml):
        with pytest.raises(RecordingError, match="contains several runs"):
            ask()


@pytest.mark.parametrize(
    ("choice", "message"),
    [
        ("time.integrator", "expected key=a,b,c"),
        ("time.integrator=", "expected a list such as 0.2,0.6"),
        ("time.cfl=0.1:0.5:1", "a range has two values or more"),
        ("step=0", "expected numbers above 0"),
        ("step=two", "expected numbers above 0"),
        ("threads=0", "expected numbers of threads"),
        ("threads=all", "expected numbers of threads"),
        (
            "time.integrator=rk4",
            "the override time.integrator=rk4: .* must be 'auto', 'euler', .*, 'gauss-radau15' or 'wisdom-holman'",
        ),
        ("contact.bounce=1", "the override contact.bounce=1: unknown key"),
    ],
)
def test_a_choice_that_is_none_is_one_message(choice: str, message: str) -> None:
    with pytest.raises(SceneError, match=message):
        vary(eight(), [choice])


KNOBS = (
    "time.integrator=euler,leapfrog,leapfrog-dkd,yoshida4",
    "time.max_dt=1,2",
    "time.target_dx='auto',0.01",
    "time.cfl=0.1,0.5",
    "time.smoothing=0.2,1",
    "time.velocity_limit=every-body,fastest-body",
    "time.fixed_dt=0.1,0.2",
    "gravity.method=direct,tree",
    "gravity.opening_angle=0.3,0.5",
    "gravity.quadrupoles=true,false",
    "contact.sweeps=2,8",
    "contact.colouring=contacts,bodies",
    "contact.stabilisation=split,baumgarte,none",
    "contact.solver=lasting,staged",
    "threads=1,2",
    "step=2,1",
)


@pytest.mark.parametrize("knob", KNOBS)
def test_every_knob_that_trades_speed_for_accuracy_is_taken(knob: str) -> None:
    settings = vary(cloud(), [knob])
    assert len({(setting.overrides, setting.threads) for setting in settings}) == len(settings) > 1


def test_threads_change_the_cost_and_no_bit(tmp_path: Path) -> None:
    scene = cloud(time={"duration": 0.2})
    study, _ = measured(scene, tmp_path, "threads=1,2")
    one, two = study.results
    assert one.complete and two.complete and one.setting.threads == 1 and two.setting.threads == 2
    assert np.array_equal(study.trajectory(one).position, study.trajectory(two).position)
    again, said = measured(scene, tmp_path, "threads=1,2")
    assert said == [] and [result.setting.threads for result in again.results] == [1, 2]


@pytest.mark.needs("matplotlib")
def test_a_figure_of_settings_with_the_same_error_is_drawn_without_a_warning(tmp_path: Path) -> None:
    measured(eight(), tmp_path, "step=8,4,2,1")
    document = json.loads((tmp_path / "tradeoff.json").read_text(encoding="utf-8"))
    for entry in document["settings"]:
        entry["errors"]["position"], entry["spread"] = 1.0489772850920652e-08, 0.1  # of which matplotlib warned
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        draw(document, tmp_path / "same.png", tmp_path / "same.pdf")
    assert (tmp_path / "same.png").read_bytes().startswith(b"\x89PNG")
    assert (tmp_path / "same.pdf").read_bytes().startswith(b"%PDF")


@pytest.mark.needs("matplotlib")
def test_a_study_whose_errors_are_all_rounding_says_so_in_place_of_a_figure(tmp_path: Path) -> None:
    measured(eight(), tmp_path, "step=4")
    document = json.loads((tmp_path / "tradeoff.json").read_text(encoding="utf-8"))
    for entry in document["settings"]:
        entry["errors"] = dict.fromkeys(entry["errors"], 1e-15)
    with pytest.raises(ExperimentError, match="no error exceeds 1e-14, rounding"):
        draw(document, tmp_path / "none.png")


def test_a_step_is_a_multiple_of_what_it_is_with_the_other_choices() -> None:
    scene = cloud(4)
    auto, double, second, both = (
        setting.apply(scene).time for setting in vary(scene, ["time.integrator=auto,euler", "step=1,2"])
    )
    assert (auto.cfl, double.cfl, both.cfl) == (0.1, 0.2, 0.2) and both.integrator == "euler"
    assert double.target_dx == both.target_dx == pytest.approx(4.0 * 0.004**2 * 0.2, rel=1e-15)
    assert auto.target_dx == second.target_dx == "auto"
    points = cloud(4, contact={"enabled": False}, time={"cfl": "auto", "integrator": "yoshida4"})
    (double,) = (setting.apply(points).time for setting in vary(points, ["step=2"]))
    assert (double.cfl, double.target_dx, double.pull_fraction) == ("auto", "auto", 0.02)
    (longest,) = vary(scene, ["time.max_dt=3", "step=2"])
    assert longest.apply(scene).time.max_dt == 6.0


def test_a_factor_on_the_step_names_the_limits_where_it_is_not_one_on_every_step() -> None:
    held = {"position": [0.0, 0.0, 1.0]}
    scene = Scene.from_dict(
        {"body": [held], "plane": [{}], "gravity": {"uniform": [0, 0, -9.81]}, "time": {"duration": 1.0}}
    )
    assert [setting.name for setting in vary(scene, ["step=1,2"])] == [
        "as written",
        "max_dt × 2, cfl × 2, target_dx × 4",
    ]
    (fixed,) = vary(scene.changed(["time.fixed_dt=0.01"]), ["step=2"])
    assert fixed.name == "steps 2 times as long"
    (adaptive,) = vary(Scene.load("figure-eight", ["time.fixed_dt=", "time.integrator=gauss-radau15"]), ["step=2"])
    assert adaptive.name == "max_dt × 2"


@pytest.mark.parametrize("narrow", [False, True])
def test_a_terminal_of_any_width_shows_every_error_in_whole_cells(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, narrow: bool
) -> None:
    study, _ = measured(eight(), tmp_path, "step=1,2")
    capsys.readouterr()
    for name, value in (("TTY_COMPATIBLE", str(int(narrow))), ("TERM", "dumb")):  # 80 characters, without colours
        monkeypatch.setenv(name, value)
    print_parts([table_of(study)])
    shown = capsys.readouterr().out
    assert "…" not in shown and not (narrow and max(map(len, shown.splitlines())) > 80)
    assert (shown.count("steps 2 times as long") > 1) == narrow, "further tables"
    assert study.results[1].errors is not None
    assert all(f"{getattr(study.results[1].errors, name):.1e}" in shown for name in ("position", "velocity", "energy"))


def test_settings_with_the_same_run_are_timed_once_and_share_a_row(tmp_path: Path) -> None:
    # a fixed step is not averaged
    study, said = measured(eight(), tmp_path, "time.smoothing=0.5,1", "step=1,2", repeats=2)
    assert [result.same_as for result in study.results] == [
        "",
        "",
        "smoothing = 0.5",
        "smoothing = 0.5, steps 2 times as long",
    ]
    assert sum("cost" in text for text in said) == 2 * 2
    assert [len(result.costs) for result in study.results] == [2] * 4
    assert list(study.marks("energy")) == ["smoothing = 0.5", "smoothing = 0.5, steps 2 times as long"]
    assert len(table_of(study).cells()) == 2
    assert "The same run as smoothing = 0.5: smoothing = 1." in notes_on_rows(study)
    again, _ = measured(eight(), tmp_path, "time.smoothing=0.5,1", "step=1,2", repeats=3)
    assert [len(result.costs) for result in again.results] == [3] * 4
    assert again.results[3].costs is again.results[1].costs


@pytest.mark.parametrize("choice", ["body.0.radius=1,2", "time.duration=1,2", "contact.restitution=0,1", "title='a'"])
def test_a_key_that_makes_another_scene_cannot_vary(choice: str) -> None:
    with pytest.raises(SceneError, match="changes the scene instead of its computation"):
        vary(pair(), [choice])


def test_tradeoff_reads_ranges_as_a_sweep_does() -> None:
    settings = vary(pair(), ["time.cfl=0.1:0.4:3log"])
    assert [setting.apply(pair()).time.cfl for setting in settings] == [0.1, 0.2, 0.4]
    assert [setting.name for setting in vary(pair(), ["contact.sweeps=2:4:3"])] == [
        "sweeps = 2",
        "sweeps = 3",
        "sweeps = 4",
    ]


@pytest.mark.parametrize("name", ["kepler-orbits", "newtons-cradle", "elastic-gas", "cloud-collapse"])
def test_the_default_settings_are_about_a_dozen_and_all_different(name: str) -> None:
    scene = Scene.load(name)
    settings = default_settings(scene)
    assert 10 <= len(settings) <= 17, "two of them are accuracies"
    assert len({setting.overrides for setting in settings}) == len(settings)


def test_the_legend_of_a_table_states_the_noise_of_the_costs() -> None:
    assert "or to 5% where that is more" in _legend(0.05)


def test_default_settings_of_a_piston_leave_out_what_it_refuses() -> None:
    falling, piston = {"position": [0.0, 0.0, 1.0]}, {"point": [0, 0, 5], "normal": [0, 0, -1], "piston": {"mass": 1.0}}
    scene = Scene.from_dict(
        {"body": [falling], "plane": [{}, piston], "gravity": {"uniform": [0, 0, -9.81]}, "time": {"duration": 1.0}}
    )
    settings = default_settings(scene)
    assert len(settings) > 4
    for setting in settings:
        assert scene.changed(list(setting.overrides)).has_piston


def test_a_scene_whose_accuracy_chooses_the_step_has_no_default_settings() -> None:
    with pytest.raises(SceneError, match=r"time\.accuracy = 1e-08 chooses the step.*--set time\.accuracy="):
        default_settings(Scene.load("kepler-orbits", ["time.accuracy=1e-8", "time.fixed_dt="]))
