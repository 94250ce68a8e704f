"""The commands, run as a person runs them."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from carom.recording.read.recorded_impacts import RecordedImpacts
from carom.recording.read.recording import Recording
from carom.scene.load import Scene
from carom.scene.parts import unknown
from carom.sharing.report import worst_moment
from carom.terminal.compilation_progress import POINTS
from carom_command import carom, carom_process

ONE_BODY = "[[body]]\nradius = 1.0\n"


def scene_file(folder: Path, text: str) -> Path:
    path = folder / "scene.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_run_records_a_scene_and_says_what_to_do_next(tmp_path: Path) -> None:
    done = carom("run", "two-spheres", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    for part in ("completed", "recordings/two-spheres.rrd", "carom view", "energy_error"):
        assert part in done.stdout
    assert "Two spheres off centre" in done.stderr
    assert Recording.open(tmp_path / "recordings" / "two-spheres.rrd").frames > 100


def test_a_run_in_which_nothing_touched_says_so(tmp_path: Path) -> None:
    said = carom("run", "two-spheres", "--set", "time.duration=0.1", cwd=tmp_path)
    assert said.returncode == 0 and "none: nothing touched" in said.stderr + said.stdout


def test_run_prints_json_that_a_script_can_use(tmp_path: Path) -> None:
    done = carom("run", "two-spheres", "--json", "-o", "x.rrd", cwd=tmp_path)
    outcome = json.loads(done.stdout)
    assert outcome["ok"] is True and outcome["path"] == "x.rrd" and outcome["moments"]["impacts"] == 1


def test_inspect_prints_the_keys_that_scripts_rely_on(tmp_path: Path) -> None:
    carom("run", "two-spheres", "-o", "x.rrd", cwd=tmp_path)
    summary = json.loads(carom("inspect", "x.rrd", "--json", cwd=tmp_path).stdout)
    assert summary["scene"]["title"] == "Two spheres off centre, with friction"
    assert summary["description"].startswith("Two spheres collide off centre"), "the comment at its head"
    assert summary["bodies"] == 2 and summary["outcome"] == "completed"
    assert summary["sim_time"] == 4.0 and summary["frames"] == summary["steps"] + 1
    assert set(summary["energy"]) >= {"initial", "final", "max_error"}
    assert summary["momentum"]["max_error"] <= 1e-12 and summary["angular_momentum"]["max_error"] <= 1e-12
    assert (summary["contacts"]["impacts"], summary["contacts"]["impacts_counted"]) == (1, "each")
    assert summary["contacts"]["total"] == 1 and summary["contacts"]["max_overlap"] <= 1e-12
    assert summary["versions"]["carom"] and summary["versions"]["rerun-sdk"]
    assert summary["expect"]["max_overlap"]["met"] is True
    assert summary["profile"]["search"] > 0.0
    assert summary["moments"]["impact"]["bodies"] == [0, 1]
    printed = carom("inspect", "x.rrd", cwd=tmp_path).stdout.splitlines()
    heading = next(k for k, line in enumerate(printed) if line.startswith("time of the steps"))
    parts = [line.split()[0] for line in printed[heading + 1 :]]
    assert sorted(parts) == sorted(summary["profile"])


BALL_ON_FLOOR = """
gravity = { constant = 0.0, uniform = [0.0, 0.0, -10.0] }
time = { duration = 0.5 }

[[plane]]
name = "floor [x]"

[[body]]
position = [0.0, 0.0, 9.0]

[[body]]
name = "ball"
position = [9.0, 0.0, 1.2]
"""


def test_a_plane_is_called_by_its_name_and_not_a_body(tmp_path: Path) -> None:
    scene_file(tmp_path, BALL_ON_FLOOR)
    run = json.loads(carom("run", "scene.toml", "--json", "-o", "x.rrd", cwd=tmp_path).stdout)
    inspected = json.loads(carom("inspect", "x.rrd", "--json", cwd=tmp_path).stdout)
    carom("clip", "x.rrd", "--from", "0.1", "--bodies", "1", cwd=tmp_path)
    clipped = json.loads(carom("inspect", "x-clip.rrd", "--json", cwd=tmp_path).stdout)
    for document in (run, inspected, clipped):
        impact = document["moments"]["impact"]
        assert (impact["bodies"], impact["planes"]) == ([1], [0])
        assert impact["between"] == 'body 1 "ball" and floor [x]'
    for file in ("x.rrd", "x-clip.rrd"):
        shown = carom("inspect", file, cwd=tmp_path).stdout
        assert 'J of approach (½ μ v_n²), body 1 "ball" and floor [x], in step' in shown
    assert worst_moment(Recording.open(tmp_path / "x.rrd"))[1].endswith('body 1 "ball" and floor [x]')


def test_inspect_counts_in_the_singular_and_the_plural(tmp_path: Path) -> None:
    scene_file(tmp_path, "time = { duration = 0.5, fixed_dt = 0.5 }\n[[body]]\nposition = [0, 0, 0]\n")
    carom("run", "scene.toml", "-o", "x.rrd", cwd=tmp_path)
    shown = carom("inspect", "x.rrd", cwd=tmp_path).stdout
    assert ", 1 body " in shown and "2 frames, 1 step, 0.5 s simulated" in shown
    assert [RecordedImpacts(count).text(count) for count in (0, 1, 2)] == [
        "none",
        "the only one is recorded",
        "all 2 recorded",
    ]


def test_the_commands_that_inspect_names_take_the_zip_of_a_report(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("carom.sharing.report.try_to_render", lambda *_: "not now")  # takes seconds
    carom("run", "two-spheres", "-o", "x.rrd", cwd=tmp_path)
    assert carom("report", "x.rrd", "-o", "x.zip", cwd=tmp_path).returncode == 0
    for command in ("clip --around 1.6 --window 0.1", "picture --at 99", "view --at 99"):
        name, *options = command.split()
        done = carom(name, "x.zip", *options, cwd=tmp_path)
        assert "is not a recording" not in done.stderr
        assert "99 s is outside" in done.stderr if "99" in options else done.returncode == 0, done.stderr
    assert Recording.open(tmp_path / "x-clip.rrd").frames > 1
    assert carom("diff", "x.zip", "x.rrd", cwd=tmp_path).returncode == 0
    assert carom("contacts", "x.zip", "--at", "99", cwd=tmp_path).stderr.startswith("carom: x.zip covers ")


def test_inspect_shows_where_the_time_of_a_step_went(tmp_path: Path) -> None:
    carom("run", "two-spheres", "-o", "x.rrd", cwd=tmp_path)
    shown = carom("inspect", "x.rrd", cwd=tmp_path).stdout
    assert "search" in shown and "%" in shown and "hardest impact" in shown


def test_a_scene_that_misses_its_promise_exits_1_and_says_which(tmp_path: Path) -> None:
    late = ("--set", "contact.timing=end-of-step")
    done = carom("run", "two-spheres", *late, "--set", "expect.max_overlap=1e-9", "-o", "x.rrd", cwd=tmp_path)
    assert done.returncode == 1
    assert "expectation missed: max_overlap" in done.stderr
    assert Recording.open(tmp_path / "x.rrd").outcome.startswith("expectation missed")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["run", "nothing.toml"], "no such file"),
        (["run", "two-spheres", "--set", "contact.restitution=2"], "must be at most 1"),
        (["run", "two-spheres", "-o", "no/such/folder.rrd"], "there is no folder"),
        (["run", "two-spheres", "-o", "taken.rrd"], "exists; give --force"),
        (["explain", "nothing.toml"], "no such file"),
        (["inspect", "nothing.rrd"], "nothing.rrd"),
        (["inspect", "taken.rrd"], "taken.rrd"),
        (["picture", "nothing.rrd"], "nothing.rrd"),
        (["picture", "taken.rrd", "--size", "big"], "expected WIDTHxHEIGHT"),
        (["picture", "taken.rrd", "--size", "0x600"], "each from 100 to 8192 pixels"),
        (["picture", "taken.rrd", "--size", "99999999999999x600"], "each from 100 to 8192 pixels"),
        (["picture", "taken.rrd", "--view", "front"], "'front' is not one of"),
        (["picture", "taken.rrd", "--theme", "pink"], "'pink' is not one of"),
        (["new", "taken.toml"], "exists; give --force"),
        (["new", "."], ".: a folder; name a file to write, such as mine.toml"),
        (["new", "/"], "/: a folder; name a file to write, such as /mine.toml"),
        (["new", "fresh", "--from", "nothing"], "no such bundled scene"),
    ],
)
def test_a_mistake_is_one_message_and_exit_code_2(arguments: list[str], said: str, tmp_path: Path) -> None:
    (tmp_path / "taken.rrd").write_bytes(b"not a recording")
    scene_file(tmp_path, ONE_BODY).rename(tmp_path / "taken.toml")
    done = carom(*arguments, cwd=tmp_path)
    assert done.returncode == 2, done.stderr
    assert said in done.stderr and "Traceback" not in done.stderr
    assert (tmp_path / "taken.rrd").read_bytes() == b"not a recording"


FOR_A_FOLDER = {
    "clip": ["--around", "0", "--window", "1"],
    "export": ["--all", "-o", "x.csv"],
    "fork": ["--at", "1", "--perturb", "1ulp"],
    "why": ["--event", "impact"],
}


@pytest.mark.parametrize("folder", [".", "/", "runs"])
@pytest.mark.parametrize(
    "command",
    [
        *("clip", "contacts", "export", "fork", "inspect", "movie", "picture"),
        *("publish", "repair", "replay", "report", "resume", "view", "why"),
    ],
)
def test_a_folder_given_as_a_recording_is_one_sentence(command: str, folder: str, tmp_path: Path) -> None:
    (tmp_path / "runs").mkdir()
    done = carom(command, folder, *FOR_A_FOLDER.get(command, []), cwd=tmp_path)
    assert done.returncode == 2
    assert done.stderr == f"carom: {folder}: a folder, not a recording; give an .rrd file\n"


def test_a_folder_that_cannot_be_written_is_one_message(tmp_path: Path) -> None:
    done = carom("run", "two-spheres", "-o", "/proc/x.rrd", cwd=tmp_path)
    assert done.returncode == 2 and "/proc/x.rrd" in done.stderr and "Traceback" not in done.stderr


def test_a_scene_that_cannot_be_placed_leaves_no_file(tmp_path: Path) -> None:
    scene = scene_file(tmp_path, "[[body]]\n[[body]]\nposition = [1.5, 0, 0]\n")
    done = carom("run", str(scene), "-o", "x.rrd", cwd=tmp_path)
    assert done.returncode == 2 and "overlap by 0.5 m" in done.stderr
    assert not (tmp_path / "x.rrd").exists()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[[body]]\n[[plane]]\nnormal = [0, 0, 0]\n", "normal = [0, 0, 0] has no direction"),
        ("[[body]]\n[[plane]]\nstatic_friction = 0.1\nkinetic_friction = 0.5\n", "kinetic_friction = 0.5 is above"),
        ("[[body]]\nfixed = true\nvelocity = [1, 0, 0]\n", "fixed = true with a velocity"),
        ("[[body]]\n[[plane]]\nname = 'floor'\n", "overlaps floor by 1 m"),
        ("[domain]\nboundary = 'walls'\nsize = [3, 3, 3]\n[[body]]\nposition = [9, 0, 0]\n", "overlaps wall at +x"),
        ("[[group]]\nregion = { radius = 9.0, centre = [0, 0, -20] }\n[[plane]]\n", "group.0.region: no space"),
    ],
)
def test_a_mistake_with_planes_or_fixed_bodies_is_one_message_too(text: str, said: str, tmp_path: Path) -> None:
    done = carom("run", str(scene_file(tmp_path, text)), "-o", "x.rrd", cwd=tmp_path)
    assert done.returncode == 2, done.stderr
    assert said in " ".join(done.stderr.split()) and "Traceback" not in done.stderr
    assert not (tmp_path / "x.rrd").exists()


def test_a_full_disk_ends_the_run_with_a_readable_file(tmp_path: Path) -> None:
    done = carom_process("run", "elastic-gas", "-o", "x.rrd", cwd=tmp_path, limit=6_000_000)
    assert done.returncode == 1, done.stderr
    assert "Traceback" not in done.stderr and "disk" in done.stderr
    assert Recording.open(tmp_path / "x.rrd").frames > 0


@pytest.mark.slow
def test_ctrl_c_ends_cleanly_with_a_readable_file(tmp_path: Path) -> None:
    path = tmp_path / "x.rrd"
    run = subprocess.Popen(
        [sys.executable, "-m", "carom", "run", "elastic-gas", "--set", "time.duration=1e5", "-o", str(path)],
        cwd=tmp_path,
        stderr=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    deadline = time.monotonic() + 120
    while (not path.exists() or path.stat().st_size < 100_000) and time.monotonic() < deadline:
        time.sleep(0.1)
    run.send_signal(signal.SIGINT)
    stdout, stderr = run.communicate(timeout=60)
    assert run.returncode == 1
    assert f"carom resume {path}" in " ".join(stdout.split())
    assert "interrupted: stopped by the user" in stderr and "Traceback" not in stderr
    recording = Recording.open(path)
    assert recording.outcome.startswith("interrupted") and recording.frames > 0


def test_explain_says_what_is_modelled_and_what_it_costs(tmp_path: Path) -> None:
    shown = carom("explain", "elastic-gas", cwd=tmp_path).stdout
    for part in ("gravity.constant = 0", "no friction, and nothing spins", "steps in", "of memory", "of recording"):
        assert part in shown
    rows = [line.split() for line in shown.splitlines()]
    assert ["friction", "no", "—", "both", "coefficients", "are", "0"] in rows
    assert ["restitution", "yes", "in", "contact", "e", "=", "1"] in rows
    document = json.loads(carom("explain", "elastic-gas", "--json", cwd=tmp_path).stdout)
    assert {part["name"]: part["modelled"] for part in document["parts"]}["contact"] is True
    assert {entity["path"]: entity["recorded"] for entity in document["entities"]}["world/torque"] is False
    assert document["cost"]["steps"] > 0
    short = carom("explain", "elastic-gas", "--set", "time.duration=0.01", cwd=tmp_path).stdout
    assert "about 1 step in" in short


@pytest.mark.slow
def test_explain_says_that_the_error_sets_the_step_and_offers_no_key_to_raise(tmp_path: Path) -> None:
    keys = ("time.integrator=gauss-radau15", "time.target_dx=auto", "time.cfl=auto", "time.max_dt=1")
    limits = [part for key in keys for part in ("--set", key)]
    shown = carom("explain", "extremes/pythagorean", *limits, cwd=tmp_path)
    assert shown.returncode == 0, shown.stderr
    assert "set by: error 100 %" in shown.stdout and "for fewer steps" not in shown.stdout


def test_explain_forces_parts_besides_those_that_the_scene_forces(tmp_path: Path) -> None:
    command = ("explain", "elastic-gas", "--set", "model.force=potential", "--model", "torque", "--json")
    parts = json.loads(carom(*command, cwd=tmp_path).stdout)["parts"]
    forced = {part["name"] for part in parts if part["why"].startswith("forced")}
    assert forced == {"potential", "gravity", "torque", "spin"}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["explain", "elastic-gas", "--model", "spinn"], f"--model spinn: {unknown('spinn')}"),
        (
            ["explain", "kepler-orbits", "--model", "friction"],
            "model.force: friction cannot be forced on: contact.enabled = false; set it to true",
        ),
        (
            ["run", "kepler-orbits", "--set", "model.force=adaptive-step"],
            "model.force: adaptive-step cannot be forced on: time.fixed_dt sets the step; remove it",
        ),
    ],
)
def test_a_part_that_cannot_be_forced_is_refused_with_one_message(
    tmp_path: Path, arguments: list[str], message: str
) -> None:
    done = carom(*arguments, cwd=tmp_path)
    assert done.returncode == 2
    assert done.stderr == f"carom: {message}\n"


def test_scenes_lists_what_is_bundled(tmp_path: Path) -> None:
    assert "cloud-collapse" in carom("scenes", cwd=tmp_path).stdout
    listed = json.loads(carom("scenes", "--json", cwd=tmp_path).stdout)
    assert {"name", "title", "bodies", "path"} == set(listed[0])
    schema = json.loads(carom("scenes", "--schema", cwd=tmp_path).stdout)
    assert "restitution" in schema["$defs"]["ContactSettings"]["properties"]


def test_a_new_scene_runs_as_it_is(tmp_path: Path) -> None:
    assert carom("new", "mine", cwd=tmp_path).returncode == 0
    done = carom("run", "mine.toml", "--set", "time.duration=20", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "recordings" / "mine.rrd").exists()


def test_a_copy_of_a_bundled_scene_keeps_its_comments(tmp_path: Path) -> None:
    carom("new", "mine.toml", "--from", "cloud-collapse", cwd=tmp_path)
    assert "Look for" in (tmp_path / "mine.toml").read_text(encoding="utf-8")


@pytest.mark.slow
def test_without_a_cache_the_command_says_that_it_compiles(tmp_path: Path) -> None:
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    # a free body needs the fewest kernels
    scene_file(tmp_path, f"contact = {{ enabled = false }}\ngravity = {{ constant = 0.0 }}\n{ONE_BODY}")
    command = [sys.executable, "-m", "carom", "run", "scene.toml", "--set", "time.duration=1", "-o"]
    first, second = (
        subprocess.run([*command, name], cwd=tmp_path, env=environment, capture_output=True, text=True, check=True)
        for name in ("first.rrd", "second.rrd")
    )
    assert first.stderr.count("Compiling kernels") == 1
    assert f"once on this machine: 0 of about {POINTS} …" in first.stderr
    assert "Compiling" not in second.stderr


def test_help_imports_neither_the_compiler_nor_the_viewer(tmp_path: Path) -> None:
    code = (
        "import sys, carom.cli.main as m\n"
        "try: m.app(['--help'])\n"
        "except SystemExit: pass\n"
        "print([name for name in ('numba', 'rerun', 'scipy', 'pydantic') if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert done.stdout.strip().endswith("[]")


def test_a_process_of_carom_imports_pandas_only_where_it_is_asked_for() -> None:
    pytest.importorskip("pandas")
    code = (
        "import sys, pyarrow as pa\n"
        "from carom.runs.environment import leave_pandas_out\n"
        "leave_pandas_out()\n"
        "table = pa.table({'x': [1.0, None]})\n"
        "print('pandas' in sys.modules, table.to_pandas()['x'].isna().sum())"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["False", "1"]


def test_a_recording_given_as_a_scene_is_answered_with_what_can_be_done_with_it(run_file: Path, tmp_path: Path) -> None:
    named = run_file.rename(tmp_path / "my run.rrd")
    done = carom("run", named.name, cwd=tmp_path)
    assert done.returncode == 2 and done.stderr.startswith("carom: my run.rrd: a recording, not a scene; ")
    for name in ("view", "inspect", "replay", "resume"):
        assert f"`carom {name} 'my run.rrd'`" in done.stderr


def test_repair_is_offered_for_a_damaged_recording_and_not_for_what_never_was_one(
    run_file: Path, tmp_path: Path
) -> None:
    torn = tmp_path / "my run.rrd"
    torn.write_bytes(run_file.read_bytes()[:20_000])
    assert "`carom repair 'my run.rrd'` recovers" in carom("inspect", torn.name, cwd=tmp_path).stderr
    (tmp_path / "scene.toml").write_text(ONE_BODY * 20, encoding="utf-8")
    said = carom("inspect", "scene.toml", cwd=tmp_path).stderr
    assert said == "carom: scene.toml is a scene, not a recording; `carom run scene.toml` records it\n"
    (tmp_path / "notes.txt").write_text("bounce", encoding="utf-8")
    said = carom("inspect", "notes.txt", cwd=tmp_path).stderr
    assert said.startswith("carom: notes.txt is not a recording (") and "repair" not in said


def test_a_scene_named_without_its_ending_is_offered(tmp_path: Path) -> None:
    (tmp_path / "bounce.toml").write_text(ONE_BODY, encoding="utf-8")
    done = carom("run", "bounce", cwd=tmp_path)
    assert (done.returncode, done.stderr) == (2, "carom: bounce: no such file; did you mean bounce.toml?\n")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--plot", "body-3.zz"], 'there is no quantity "zz"; there are x, y, z (m)'),
        (["--plot", "nobody.z"], 'has no body "nobody"'),
        (["--plot", "3"], "expected BODY.QUANTITY"),
        (["--view", "plot"], "a view of plots shows the curves named by plot"),
        (["--view", "plot", "--plot", "3.x,3.speed"], "a view of plots shows one unit"),
    ],
)
def test_a_plot_of_nothing_is_one_message(arguments: list[str], said: str, run_file: Path, tmp_path: Path) -> None:
    done = carom("picture", str(run_file), *arguments, cwd=tmp_path)
    assert done.returncode == 2
    assert said in done.stderr and "Traceback" not in done.stderr
    assert not run_file.with_suffix(".png").exists()


def test_a_bundled_scene_with_a_data_file_is_copied_with_it(tmp_path: Path) -> None:
    done = carom("new", "belt", "--from", "asteroid-belt", cwd=tmp_path)
    assert done.returncode == 0 and "belt.toml and asteroid-belt.csv written" in done.stdout
    assert Scene.load(tmp_path / "belt.toml").count == Scene.load("asteroid-belt").count == 595
    assert "asteroid-belt.csv: exists" in carom("new", "more", "--from", "asteroid-belt", cwd=tmp_path).stderr
    assert not (tmp_path / "more.toml").exists()
