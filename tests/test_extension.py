"""examples/extension: a package outside of carom, installed into a folder of its own, whose parts are first class."""

from __future__ import annotations

import importlib.util
import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from carom_command import TOGETHER, carom_together, with_paths

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "examples" / "extension"

pytestmark = pytest.mark.slow  # installs a package, and compiles kernels with its forces

FORCES = """
[gravity]
constant = 0
[forces.trap]
frequency = "1 rad/s"
[forces.repulsion]
strength = "1e-3 N m^4"
"""
BODIES = """
[contact]
restitution = 1.0
static_friction = 0.0
[[body]]
position = [1.0, 0.02, 0.0]
radius = 0.1
mass = 1.0
[[body]]
position = [-1.0, 0.0, 0.0]
radius = 0.1
mass = 2.0
"""
SCENE = f'title = "Two bodies bounce in a trap"\ntime.duration = 3.0\nrecord.series = ["fastest"]\n{FORCES}{BODIES}'
HEAP = """
title = "Unequal balls fall into a heap that resists rolling"
seed = 3
time.duration = 1.0
time.fixed_dt = 0.005
record.every = 0.25
expect.contact_audit = 1e-12
[gravity]
constant = 0
uniform = [0, 0, -10]
[contact]
law = "rolling"
[contact.rolling]
rolling_friction = 0.1
[[material]]
name = "rough"
[material.rolling]
rolling_friction = 0.3
[[plane]]
[[group]]
count = 20
material = "rough"
radius = { min = 0.08, max = 0.12 }
density = 1000.0
region = { shape = "ball", radius = 0.5, centre = [0, 0, 0.6] }
[[body]]
position = [0, 0, 0.05]
radius = 0.05
mass = 1.0
velocity = [0, 0, -2]
"""
PERIODIC = ("domain.boundary=periodic", "domain.size=[4,4,4]", "time.fixed_dt=0.002")


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the installed package: nothing of it is in the sources or the environment of carom."""
    folder = tmp_path_factory.mktemp("extension")
    shutil.copytree(PACKAGE, folder / "source", ignore=shutil.ignore_patterns("__pycache__"))
    offline = ["--no-build-isolation", "--no-index"] if importlib.util.find_spec("hatchling") else []
    pip = [sys.executable, "-m", "pip", "install", "-q", "--no-deps", *offline]
    subprocess.run([*pip, "--target", folder / "site", folder / "source"], check=True, capture_output=True)
    return folder / "site"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("runs")
    (folder / "scene.toml").write_text(SCENE, encoding="utf-8")
    return folder


def environment(site: Path | None) -> dict[str, str]:
    return with_paths(*([site] if site else []))


def carom(folder: Path, site: Path | None, *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "carom", *arguments]
    return subprocess.run(command, cwd=folder, env=environment(site), capture_output=True, text=True, check=False)


def ended(folder: Path, site: Path | None, *commands: str) -> list[tuple[int, str, str]]:
    """Run commands one after the other; return the exit code of each, and what it said."""
    done = carom_together(*commands, cwd=folder, environment=environment(site))
    return [(command.returncode, command.stdout, command.stderr) for command in done]


def said(folder: Path, site: Path, *commands: str) -> list[str]:
    """Run commands that succeed; return what each said."""
    ends = ended(folder, site, *commands)
    for command, (code, stdout, stderr) in zip(commands, ends, strict=True):
        assert code == 0, f"{command}: {stderr}{stdout}"
    return [stdout for _, stdout, _ in ends]


def run(folder: Path, site: Path, name: str, *overrides: str, then: str = "") -> tuple[dict[str, Any], str]:
    """Record the scene; return the summary of the recording, and what a further command said."""
    sets = " ".join(f"--set {override}" for override in overrides)
    commands = [f"run scene.toml -o {name} --force {sets}", f"inspect {name} --json", *([then] if then else [])]
    _, summary, *further = said(folder, site, *commands)
    return json.loads(summary), "".join(further)


@pytest.mark.parametrize(
    ("name", "overrides", "error"),
    [
        ("leapfrog.rrd", ("time.integrator=leapfrog", "time.fixed_dt=0.002"), 1e-4),  # of second order: (ω dt)² / 24
        ("radau.rrd", ("time.integrator=gauss-radau15",), 1e-13),  # rounding
        ("periodic.rrd", ("time.integrator=leapfrog", *PERIODIC), 1e-4),
        ("promised.rrd", ("time.accuracy=1e-8",), 1e-8),
    ],
)
def test_forces_of_a_package_keep_the_energy_bounce_and_replay(
    folder: Path, site: Path, name: str, overrides: tuple[str, ...], error: float
) -> None:
    summary, replayed = run(folder, site, name, *overrides, then=f"replay {name}")
    assert summary["energy"]["max_error"] < error
    assert summary["contacts"]["impacts"] >= 1
    assert "same bits" in replayed


def test_a_resumed_run_has_the_bits_of_one_that_was_not_interrupted(folder: Path, site: Path) -> None:
    run(folder, site, "half.rrd", "time.integrator=gauss-radau15", "time.duration=1.5")
    resumed = said(folder, site, "resume half.rrd --until 3 -o resumed.rrd --force", "replay resumed.rrd")
    assert "same bits" in resumed[-1]


def test_gauss_radau_agrees_with_the_exact_reference_to_rounding(folder: Path, site: Path) -> None:
    said(folder, site, "tradeoff scene.toml --set time.integrator=gauss-radau15 --vary step=1 --repeats 1 -o study")
    study = json.loads((folder / "study" / "tradeoff.json").read_text(encoding="utf-8"))
    assert study["reference"]["kind"] == "exact"
    assert max(setting["errors"]["position"] for setting in study["settings"]) < 1e-12  # DOP853's tolerance is 1e-13


SWIRL = """
title = "Two bodies collide in a swirl"
time.duration = 3.0
[gravity]
constant = 0
[forces.trap]
frequency = "1 rad/s"
[forces.swirl]
strength = 0.5
[contact]
restitution = 1.0
static_friction = 0.0
[[body]]
position = [0.5, 0.02, 0.0]
velocity = [-1.0, 0.0, 0.0]
radius = 0.1
mass = 1.0
[[body]]
position = [-0.5, 0.0, 0.0]
velocity = [1.0, 0.0, 0.0]
radius = 0.1
mass = 2.0
"""


@pytest.mark.parametrize(
    ("integrator", "error"),
    [
        ("time.integrator=leapfrog --set time.fixed_dt=0.002", 1e-5),  # of second order: some (ω dt)²
        ("time.integrator=gauss-radau15", 1e-14),  # rounding
    ],
)
def test_the_work_of_a_force_without_a_potential_explains_the_energy_that_it_adds(
    folder: Path, site: Path, integrator: str, error: float
) -> None:
    (folder / "swirl.toml").write_text(SWIRL, encoding="utf-8")
    recorded = f"run swirl.toml -o swirl.rrd --force --set {integrator}"
    _, summary, replayed = said(folder, site, recorded, "inspect swirl.rrd --json", "replay swirl.rrd")
    energy = json.loads(summary)["energy"]
    assert json.loads(summary)["contacts"]["impacts"] == 1
    assert energy["final"] > 1.5 * energy["initial"]  # the swirl accelerates both bodies along their paths
    assert energy["max_error"] < error
    assert "same bits" in replayed


def test_an_integrator_of_a_package_has_its_order_and_replays(folder: Path, site: Path) -> None:
    (folder / "orbit.toml").write_text(
        'time = { duration = 12.6, integrator = "pefrl" }\n[forces.trap]\nfrequency = 1.0\n'
        "[[body]]\nposition = [1.0, 0, 0]\nvelocity = [0, 0.5, 0]\nradius = 0.1\nmass = 1.0\n",
        encoding="utf-8",
    )
    runs = [f"run orbit.toml --set time.fixed_dt={dt} -o pefrl.rrd --force" for dt in ("0.4", "0.2")]
    inspect = "inspect pefrl.rrd --json"
    _, coarse, _, fine, replayed = said(folder, site, runs[0], inspect, runs[1], inspect, "replay pefrl.rrd")
    errors = [json.loads(summary)["energy"]["max_error"] for summary in (coarse, fine)]
    assert errors[0] / errors[1] == pytest.approx(2.0**4, rel=0.2)  # the next order adds (ω dt)², 0.16
    assert "same bits" in replayed
    without = carom(folder, None, "replay", "pefrl.rrd")
    assert without.returncode == 2 and 'the integrator "pefrl" of the package carom-example 0.1.0' in without.stderr


@pytest.fixture(scope="module")
def recorded(folder: Path, site: Path) -> str:
    """A recording of the scene, which tests read."""
    run(folder, site, "recorded.rrd")
    return "recorded.rrd"


def test_the_series_of_a_package_is_recorded_where_the_scene_asks_for_it(
    folder: Path, site: Path, recorded: str
) -> None:
    script = f"import carom; print(max(carom.Recording.open('{recorded}').steps()['fastest'].to_pylist()))"
    done = subprocess.run([sys.executable, "-c", script], cwd=folder, capture_output=True, text=True, check=True)
    # they meet at up to ω times 1 m, and the lighter one of masses 1 and 2 leaves an elastic impact with 5/3 of that
    assert 1.0 < float(done.stdout) < 5.0 / 3.0


def test_formats_and_commands_of_a_package_work_like_those_of_carom(folder: Path, site: Path) -> None:
    (folder / "three.atoms").write_text("3\nwater\nO 0 0 0\nH 3 0 0\nH 0 3 0\n", encoding="utf-8")
    (folder / "atoms.toml").write_text(
        'time.duration = 1.0\n[[bodies]]\nfile = "three.atoms"\nradius = 1.0\ndensity = 1.0\n'
    )
    commands = ("centre atoms.rrd --json", "export atoms.rrd -o atoms.positions --force", "--help")
    _, centre, _, help_text = said(folder, site, "run atoms.toml -o atoms.rrd --force", *commands)
    assert json.loads(centre)["start"] == [1.0, 1.0, 0.0]
    assert len((folder / "atoms.positions").read_text().splitlines()) == 4
    assert "centre" in help_text


ROLLING = """
title = "A ball rolls and spins until it stops"
time.duration = 2.0
time.fixed_dt = 0.01
record.every = "step"
expect.contact_audit = 1e-12
[gravity]
constant = 0
uniform = [0, 0, -10]
[contact]
law = "rolling"
[contact.rolling]
rolling_friction = 0.1
twisting_friction = 0.05
[[plane]]
[[body]]
position = [0, 0, 0.5]
radius = 0.5
mass = 2.0
velocity = [1, 0, 0]
angular_velocity = [0, 2, 3]
"""


@pytest.fixture(scope="module")
def rolling(folder: Path) -> Path:
    (folder / "rolling.toml").write_text(ROLLING, encoding="utf-8")
    return folder


@pytest.mark.nightly
@pytest.mark.parametrize("timing", ["time-of-impact", "end-of-step"])
def test_a_ball_that_rolls_and_spins_slows_down_as_in_closed_form_and_stops(
    rolling: Path, site: Path, timing: str
) -> None:
    """With torques τ = μ_r m g r and τ_t = μ_t m g r, and I = 2/5 m r²: m a = F and I a/r = τ - F r, so a = 5/7 μ_r g;
    and dω/dt = 5/2 μ_t g/r. The impulses are those of whole steps, so both hold to rounding until the ball stops.
    """
    script = (
        f"{TOGETHER}import carom; "
        f"space = carom.Space(carom.Scene.load('rolling.toml', ['contact.timing={timing}']), threads=1); "
        "moments = [(f.time, f.velocity[0, 0], *f.angular_velocity[0, 1:], *f.torque[0, 1:]) for f in space.run()]; "
        "print(json.dumps([*zip(*moments), space.energy().ledger.friction]))"
    )
    recorded = f"run rolling.toml -o ball.rrd --force --set contact.timing={timing}"
    commands = json.dumps([command.split() for command in (recorded, "inspect ball.rrd --json", "replay ball.rrd")])
    done = subprocess.run(
        [sys.executable, "-c", script, commands],
        cwd=rolling,
        env=environment(site),
        capture_output=True,
        text=True,
        check=True,
    )
    ends, computed = done.stdout.splitlines()
    _, (_, summary, _), (_, replayed, _) = json.loads(ends)
    assert json.loads(summary)["energy"]["max_error"] < 1e-13
    assert "same bits" in replayed
    *moments, lost = json.loads(computed)
    time, velocity, spin, twist, torque, twisting = map(np.array, moments)
    a, rate = 5 / 7 * 0.1 * 10.0, 5 / 2 * 0.05 * 10.0 / 0.5
    np.testing.assert_allclose(velocity, np.maximum(0.0, 1.0 - a * time), atol=1e-12)
    np.testing.assert_allclose(spin, np.maximum(0.0, 1.0 - a * time) / 0.5, atol=1e-12)
    np.testing.assert_allclose(twist, np.maximum(0.0, 3.0 - rate * time), atol=1e-12)
    np.testing.assert_allclose(torque[1:100], -0.4 * 2.0 * 0.5 * a, rtol=1e-9)  # I a/r, from differences of spins
    np.testing.assert_allclose(twisting[1:100], -0.05 * 2.0 * 10.0 * 0.5, rtol=1e-9)
    assert lost == pytest.approx(0.5 * 2.0 + 0.5 * 0.2 * (2.0**2 + 3.0**2), rel=1e-12)  # all: ½ m v² + ½ I ω²


@pytest.mark.nightly
def test_a_heap_under_a_law_of_a_package_rests_and_resumes_with_the_same_bits(rolling: Path, site: Path) -> None:
    (rolling / "heap.toml").write_text(HEAP, encoding="utf-8")
    _, summary, *_, replayed = said(
        rolling,
        site,
        "run heap.toml -o whole.rrd --force",
        "inspect whole.rrd --json",
        "run heap.toml -o half-heap.rrd --force --set time.duration=0.5",
        "resume half-heap.rrd --until 1 -o heap.rrd --force",
        "replay heap.rrd",
    )
    assert json.loads(summary)["energy"]["max_error"] < 1e-12  # rounding
    assert "same bits" in replayed


def test_what_knows_coulombs_law_only_refuses_another(rolling: Path, site: Path) -> None:
    wrong = {
        "explain rolling.toml --set contact.law=roling": 'no contact law "roling"; did you mean "rolling"?',
        "explain rolling.toml --set contact.law=coulomb": 'needs contact.law = "rolling"',
        "crosscheck rolling.toml --engine mujoco -o crosscheck": 'contact.law = "rolling"',
    }
    for (code, _, message), expected in zip(ended(rolling, site, *wrong), wrong.values(), strict=True):
        assert code == 2 and expected in message
    without = carom(rolling, None, "explain", "rolling.toml")
    assert without.returncode == 2 and 'no contact law "rolling"' in without.stderr


RING = """
title = "A ball runs around in a tube that is bent to a ring"
time.duration = 1.0
time.fixed_dt = 0.002
[gravity]
constant = 0
uniform = [0, 0, -10]
[contact]
restitution = 0.0
static_friction = 0.0
[[wall]]
ring = {{ radius = 1.0, tube = "30 cm" }}
[[body]]
position = [{distance}, 0, {height}]
velocity = [0, {speed}, 0]
radius = 0.1
mass = 1.0
"""


@pytest.mark.nightly
def test_a_ball_in_a_wall_of_a_package_runs_around_at_the_slope_that_its_speed_needs(folder: Path, site: Path) -> None:
    """At the slope θ of the wall, v² = g ρ tan θ keeps the ball at ρ = R + (r - a) sin θ, below the middle."""
    slope, distance_to_middle = np.radians(45.0), 0.3 - 0.1
    distance, height = 1.0 + distance_to_middle * np.sin(slope), -distance_to_middle * np.cos(slope)
    speed = np.sqrt(10.0 * distance * np.tan(slope))
    scene = RING.format(distance=distance, height=height, speed=speed)
    (folder / "ring.toml").write_text(scene, encoding="utf-8")
    read = (
        f"{TOGETHER}import carom; path = carom.Recording.open('ring.rrd').trajectory(0); "
        "print(json.dumps([path[name].to_pylist() for name in ('time', 'x', 'y', 'z')]))"
    )
    commands = json.dumps([command.split() for command in ("run ring.toml -o ring.rrd --force", "replay ring.rrd")])
    done = subprocess.run(
        [sys.executable, "-c", read, commands],
        cwd=folder,
        env=environment(site),
        capture_output=True,
        text=True,
        check=True,
    )
    ends, path = map(json.loads, done.stdout.splitlines())
    assert [code for code, *_ in ends] == [0, 0], ends
    time, x, y, z = np.array(path)
    within = 1e-4  # m: (v dt)² / 8 ρ = 5e-6 m of each step's chord, over the turns of a second, and float32
    assert np.abs(np.hypot(x, y) - distance).max() < within and np.abs(z - height).max() < within
    assert np.abs(np.unwrap(np.arctan2(y, x)) - speed / distance * time).max() < within
    assert "same bits" in ends[1][1]


def test_misspelt_keys_and_wrong_units_have_the_usual_messages(folder: Path, site: Path) -> None:
    misspelt = "explain scene.toml --set forces.trap.frequncy=1"
    unit = "explain scene.toml --set 'forces.trap.frequency=3 km'"
    misspelt_end, unit_end, (_, schema, _) = ended(folder, site, misspelt, unit, "scenes --schema")
    assert misspelt_end[0] == 2 and 'unknown key forces.trap.frequncy; did you mean "frequency"?' in misspelt_end[2]
    assert unit_end[0] == 2 and "angular velocity" in unit_end[2]
    assert '"trap"' in schema


def test_without_the_package_every_command_says_what_to_install(folder: Path, recorded: str) -> None:
    for code, _, message in ended(folder, None, *(f"{name} {recorded}" for name in ("replay", "resume", "inspect"))):
        assert code == 2 and len(message.splitlines()) == 1
        assert "pip install carom-example==0.1.0" in message
