"""Optional parts can be removed: delete the folder and its row, and everything else works.

Each test removes a part from a copy of the package. What does not need the part works as before; what needs it says in
one sentence what is missing, and ends with exit code 2.
"""

from __future__ import annotations

import ast
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

import carom
import carom.record
from carom import registry
from carom_command import carom_together, with_paths

pytestmark = pytest.mark.slow

HOUSE = Path(carom.__file__).parent
ROWS = ("cli/main.py", "registry.py")  # where an optional part may have its rows
ENGINES = ("rebound", "mujoco", "box3d", "pybullet", "newton")
TOOLS = ("diff", "fields", "fork", "hunt", "shrink", "sweep", "tradeoff", "why")


class Carom:
    """Runs `carom` in a copy of the package."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def __call__(self, *arguments: str, script: str = "") -> subprocess.CompletedProcess[str]:
        """Run a command, or a script with arguments, in a process of its own."""
        return subprocess.run(
            [sys.executable, *(("-c", script) if script else ("-m", "carom")), *arguments],
            cwd=self._folder,
            env=with_paths(self._folder / "src"),
            capture_output=True,
            text=True,
            check=False,
        )

    def together(self, *commands: str) -> list[subprocess.CompletedProcess[str]]:
        """Run commands one after the other in one process."""
        return carom_together(*commands, cwd=self._folder, environment=with_paths(self._folder / "src"))


def remove(folder: Path, parts: tuple[str, ...]) -> Carom:
    """Copy the package into a folder, delete files or folders of it with their rows; return what runs `carom` there."""
    copy = folder / "src" / "carom"
    try:
        shutil.copytree(HOUSE, copy, copy_function=os.link)  # with the compiled kernels
    except shutil.Error:  # the temporary folder lies on another disk
        shutil.copytree(HOUSE, copy, dirs_exist_ok=True)
    (folder / "configs").symlink_to(HOUSE.parents[1] / "configs")
    for part in parts:
        path = copy / part
        shutil.rmtree(path) if path.is_dir() else path.unlink()
    modules = [f"carom.{part.removesuffix('.py').replace('/', '.')}" for part in parts]
    for name in filter(lambda name: (copy / name).exists(), ROWS):
        lines = (copy / name).read_text(encoding="utf-8").splitlines(keepends=True)
        (copy / name).unlink()  # the link, not the file of the house
        kept = [line for line in lines if not any(f'"{module}' in line for module in modules)]
        (copy / name).write_text("".join(kept), encoding="utf-8")

    return Carom(folder)


@pytest.fixture
def without(tmp_path: Path) -> Callable[..., Carom]:
    """Return a function that removes parts from a copy, and returns what runs `carom` in it."""
    return lambda *parts: remove(tmp_path, parts)


@pytest.fixture(scope="module")
def bare_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("bare")


@pytest.fixture(scope="module")
def bare(bare_folder: Path) -> Carom:
    """Remove all formats, placements and optional physics at once: the kernels of a changed copy take a minute."""
    return remove(bare_folder, (*OPTIONAL, *PHYSICS))


def refusal(done: subprocess.CompletedProcess[str]) -> str:
    """Return the sentence of a command that ended with exit code 2."""
    assert done.returncode == 2, done.stderr
    assert "Traceback" not in done.stderr
    return done.stderr


@pytest.mark.parametrize("tool", TOOLS)
def test_a_tool_can_be_removed(tool: str, without: Callable[..., Carom]) -> None:
    help_text, called = without(f"lab/{tool}").together("--help", tool)  # the help imports every other command
    assert help_text.returncode == 0 and f" {tool} " not in help_text.stdout
    assert f"no such command '{tool}'" in refusal(called)


def test_a_tool_that_is_built_on_a_missing_one_names_it(without: Callable[..., Carom]) -> None:
    commands = "hunt --scenes 1 -o misses", "crosscheck two-spheres --engine rebound"
    hunt, crosscheck = without("lab/shrink", "lab/tradeoff").together(*commands)
    assert "carom.lab.shrink" in refusal(hunt)
    assert "carom.lab.tradeoff" in refusal(crosscheck)


OPTIONAL = {  # module → its names in scenes and commands
    "scene/data/arrow_tables.py": ("csv",),
    "scene/data/array_tables.py": ("npz", "h5", "gsd"),
    "scene/data/mercury_table.py": ("data",),
    "scene/data/orbit_tables.py": ("horizons", "mpcorb"),
    "scene/data/particle_text.py": ("dump", "xyz"),
    "scene/data/rebound_archive.py": ("bin",),
    "scene/data/vtk_tables.py": ("vtk", "vtp"),
    "recording/export/table_files.py": ("csv",),
    "recording/export/npz.py": ("npz",),
    "recording/export/extended_xyz.py": ("extxyz",),
    "recording/export/vtk.py": ("vtk",),
    "physics/placement/lattice.py": ("cubic",),
    "physics/placement/growth.py": ("compressed",),
    "physics/placement/plummer.py": ("plummer",),
}
GROUP = """
contact = {{ timing = "end-of-step" }}
time = {{ duration = 0.01, fixed_dt = 0.01 }}
[[group]]
count = 2
radius = 0.1
{group}
"""
ARRANGED = 'arrangement = "{name}"\nregion = {{ shape = "ball", radius = 1.0 }}'


READ = """
import sys, carom
from carom.errors import SceneError
for name in sys.argv[1:]:
    try:
        carom.Space(carom.Scene.load(name))
    except SceneError as error:
        print(error)
"""


@pytest.mark.nightly
def test_formats_and_placements_can_be_removed(bare: Carom, bare_folder: Path) -> None:
    run, folder = bare, bare_folder
    (folder / "random.toml").write_text(GROUP.format(group=ARRANGED.format(name="random")), encoding="utf-8")
    ended = run("run", "random.toml", "-o", "random.rrd")
    assert ended.returncode == 0, ended.stderr
    scenes = dict[str, str]()  # file → what its message says
    for part, name in ((part, name) for part, names in OPTIONAL.items() for name in names):
        if part.startswith("scene/"):
            (folder / f"bodies.{name}").write_text("", encoding="utf-8")
            text, missing = f'[[bodies]]\nfile = "bodies.{name}"\n', f'no format has the suffix ".{name}"'
        else:
            region = 'region = { shape = "plummer", scale = 1.0 }'
            text = GROUP.format(group=region if name == "plummer" else ARRANGED.format(name=name))
            missing = f'no placement of bodies "{name}"'
        if not part.startswith("recording/"):
            (folder / f"{name}.toml").write_text(text, encoding="utf-8")
            scenes[f"{name}.toml"] = missing
    messages = run(*scenes, script=READ).stdout.splitlines()
    for message, (scene, missing) in zip(messages, scenes.items(), strict=True):
        assert missing in message, scene
    for scene in ("npz.toml", "cubic.toml"):  # the message of a command, and its exit code
        assert "there " in refusal(run("run", scene, "-o", "needs.rrd"))
    assert 'the format ".vtk" is unknown' in refusal(run("export", "random.rrd", "-o", "run.vtk"))


def test_nothing_imports_a_format_or_a_placement_but_the_registry() -> None:
    """With the test above, in which all are missing, it follows that each can be removed alone."""
    modules = [part.removesuffix(".py").replace("/", ".") for part in OPTIONAL]
    modules += [f"engines.adapters.{engine}" for engine in registry.HOUSE["engines"]]
    for path in HOUSE.rglob("*.py"):
        if path == HOUSE / "extend.py":  # it imports names at their first use
            continue
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.ImportFrom):
                named = {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
                assert not named & {f"carom.{module}" for module in modules}, path


@pytest.mark.parametrize("engine", ENGINES)
def test_the_recorder_of_an_engine_can_be_removed(engine: str, monkeypatch: pytest.MonkeyPatch) -> None:
    rows = {name: row for name, row in registry.HOUSE["engine_records"].items() if name != engine}
    monkeypatch.setattr(registry, "HOUSE", {**registry.HOUSE, "engine_records": rows})
    with pytest.raises(AttributeError, match=f'no engine that is recorded "{engine}"'):
        getattr(carom.record, engine)
    assert all(callable(getattr(carom.record, other)) for other in rows)


def test_tools_statistics_movies_the_web_viewer_laws_and_walls_can_be_removed(without: Callable[..., Carom]) -> None:
    tools = (f"lab/{tool}" for tool in TOOLS)
    run = without(*tools, "lab/statistics", "display/movie.py", "display/movie_file.py", "display/web", "laws", "walls")
    works = (
        *("--help", "run two-spheres -o run.rrd", "inspect run.rrd", "contacts run.rrd --impacts"),
        "explain two-spheres",
    )
    needs = {
        "movie run.rrd -o run.mp4": "carom.display.movie",
        "view run.rrd --web": "carom.display.web",
        "publish run.rrd": "carom.display.web",
        "contacts run.rrd --statistics": "carom.lab.statistics",
        "explain two-spheres --set contact.law=walton": 'no contact law "walton"',
        "explain two-spheres --set 'wall=[{cylinder={radius=5}}]'": "cylinder",
    }
    ended = run.together(*works, *needs)
    for command in ended[: len(works)]:
        assert command.returncode == 0, command.stderr
    for command, missing in zip(ended[len(works) :], needs.values(), strict=True):
        assert missing in refusal(command)


def test_nothing_is_built_on_a_tool_but_what_is_named_here() -> None:
    built_on = {"fork": {"diff"}, "hunt": {"shrink"}}
    for tool in (path for path in (HOUSE / "lab").iterdir() if path.is_dir() and path.name != "__pycache__"):
        text = "".join(path.read_text(encoding="utf-8") for path in tool.glob("*.py"))
        others = {other for other in TOOLS if re.search(rf"carom\.lab\.{other}\b", text)} - {tool.name}
        assert others == built_on.get(tool.name, set()), tool.name


def test_engines_can_be_removed(without: Callable[..., Carom]) -> None:
    run = without(*(f"engines/adapters/{engine}.py" for engine in ENGINES))
    help_text, *asked = run.together("--help", *(f"crosscheck two-spheres --engine {engine}" for engine in ENGINES))
    assert help_text.returncode == 0
    for engine, ended in zip(ENGINES, asked, strict=True):
        assert f"--engine {engine}: unknown" in refusal(ended)


def test_the_engines_are_one_folder_that_can_be_removed(without: Callable[..., Carom]) -> None:
    run = without("engines")
    works = "run two-spheres -o run.rrd", "inspect run.rrd", "replay run.rrd", "repair run.rrd -o again.rrd"
    help_text, crosscheck, tradeoff, *worked = run.together(
        *("--help", "crosscheck two-spheres --engine rebound", "tradeoff two-spheres --engine rebound", *works)
    )
    assert help_text.returncode == 0 and " crosscheck " not in help_text.stdout
    assert "no such command 'crosscheck'" in refusal(crosscheck)
    assert "needs carom.engines, which was removed" in refusal(tradeoff)
    assert [ended.returncode for ended in worked] == [0] * len(works), worked
    for name, missing in (("Recorder", "needs carom.engines, which was removed"), ("rebound", "no engine that is rec")):
        said = run(name, missing, script="import sys, carom; getattr(carom.record, sys.argv[1])").stderr
        assert f"AttributeError: carom.record.{name}: " in said and missing in said


SHORT = ("--set", "time.duration=0.05", "--set", "gravity.constant=1e-9")
LATE = ("--set", "contact.timing=end-of-step")
APART = ("--set", "contact.enabled=false")  # an accuracy needs exact times of impact
PHYSICS = {  # part → a scene that needs it, and what the refusal names
    "physics/integrators/gauss_radau": ("time.integrator=gauss-radau15", 'integrator "gauss-radau15"'),
    "physics/integrators/wisdom_holman": ("time.integrator=wisdom-holman", 'integrator "wisdom-holman"'),
    "physics/forces/gravity/tree.py": ("gravity.method=tree", 'gravity method "tree"'),
    "physics/forces/gravity/fast_multipole": ("gravity.method=fast-multipole", 'gravity method "fast-multipole"'),
    "physics/forces/drag.py": ("drag.relaxation_time=1.0", 'force "drag"'),
    "physics/contact/sleep": ("contact.sleep.speed=0.01", 'part of the model "sleep"'),
    "physics/contact/release": (
        "gravity.constant=0.0 --set 'outlet=[{point=[0,0,-50]}]'",
        'part of the model "release"',
    ),
    "physics/contact/piston_motion.py": ("'plane=[{piston={mass=1}}]'", 'part of the model "piston"'),
    "physics/contact/wall_motion.py": ("'wall=[{cylinder={radius=5}}]'", 'part of the model "walls"'),
    "physics/contact/plane_guard.py": ("'plane=[{point=[0,0,-9]}]'", 'part of the model "plane-guard"'),
    "physics/contact/events": ("contact.timing=auto", 'part of the model "time-of-impact"'),
}


def test_scenes_that_need_a_removed_part_of_the_physics_name_it(bare: Carom) -> None:
    runs = (" ".join(("run two-spheres -o needs.rrd", *SHORT, *LATE, "--set", needs)) for needs, _ in PHYSICS.values())
    for ended, (_, named) in zip(bare.together(*runs), PHYSICS.values(), strict=True):
        said = refusal(ended)
        assert named in said and "this installation" in said


def test_scenes_run_and_replay_without_the_optional_physics(bare: Carom) -> None:
    ended = bare("run", "two-spheres", *SHORT, *LATE, "-o", "run.rrd")
    assert ended.returncode == 0, ended.stderr
    assert bare("replay", "run.rrd").returncode == 0
    ahead = bare("run", "two-spheres", *SHORT[:2], *APART, "--set", "time.accuracy=1e-4", "-o", "accurate.rrd")
    assert ahead.returncode == 0, ahead.stderr


def test_nothing_imports_exact_times_of_impact_but_the_growth_of_packings(
    without: Callable[..., Carom], tmp_path: Path
) -> None:
    """The pipeline gets them from a row of `plan/step_parts.py`; spheres that grow meet at exact times, too."""
    events, users = HOUSE / "physics" / "contact" / "events", set[str]()
    for path in (path for path in HOUSE.rglob("*.py") if path.parent != events):
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.ImportFrom) and "carom.physics.contact.events" in (node.module or ""):
                users.add(path.name)
    assert users == {"growth.py"}
    run = without("physics/contact/events")
    (tmp_path / "packed.toml").write_text(GROUP.format(group=ARRANGED.format(name="compressed")), encoding="utf-8")
    assert "growth needs carom.physics.contact.events" in refusal(run("run", "packed.toml", "-o", "packed.rrd"))


def test_wisdom_holman_names_the_integrator_of_its_close_encounters(without: Callable[..., Carom]) -> None:
    run = without("physics/integrators/gauss_radau")
    said = refusal(run("run", "two-spheres", "--set", "time.integrator=wisdom-holman", "-o", "run.rrd"))
    assert 'integrator "gauss-radau15"' in said
