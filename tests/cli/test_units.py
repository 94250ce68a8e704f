"""What carom prints is in the units of the scene; a scene without units is in SI, as ever."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from carom.recording.read.recorded_scene import header_of_recording
from carom.recording.read.recording import Recording
from carom.recording.schema import paths
from carom.recording.schema.series import IMPULSES, IN_PLOT, PLOTS
from carom.scene.load import scene_from_text
from carom.scene.units.system import SI, UnitSystem
from carom.terminal.printing import count_text
from carom_command import carom

DROPPED = """
title = "Two balls"
{units}
[time]
duration = {duration}
fixed_dt = {step}
[gravity]
constant = 0
[[body]]
radius = {radius}
mass = {mass}
velocity = [{speed}, 0, 0]
[[body]]
radius = {radius}
mass = {mass}
position = [{apart}, 0, 0]
"""
IN_CM = DROPPED.format(
    units='[units]\nlength = "cm"\ntime = "ms"\nmass = "g"\nenergy = "mJ"\n',
    duration=400,
    step=10,
    radius=10,
    mass=500,
    speed=0.5,
    apart=100,
)
IN_SI = DROPPED.format(units="", duration=0.4, step=0.01, radius=0.1, mass=0.5, speed=5, apart=1)
ONCE = ("--vary", "step=1", "--repeats", "1")
OWN = IN_CM.replace('[units]\nlength = "cm"\ntime = "ms"\nmass = "g"\nenergy = "mJ"\n', 'units = "cm, ms, g"\n')


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("units")
    for name, text in (("cm", IN_CM), ("si", IN_SI), ("own", OWN)):
        (folder / f"{name}.toml").write_text(text, encoding="utf-8")
        done = carom("run", f"{name}.toml", "-o", f"{name}.rrd", cwd=folder)
        assert done.returncode == 0, done.stderr
        (folder / f"{name}.txt").write_text(done.stdout + done.stderr, encoding="utf-8")
    return folder


def printed(folder: Path, *arguments: str) -> str:
    done = carom(*arguments, cwd=folder)
    assert done.returncode == 0, done.stderr
    return " ".join(done.stdout.split())


def test_the_same_scene_in_other_units_has_the_same_bits(folder: Path) -> None:
    si, cm = (Recording.open(folder / f"{name}.rrd") for name in ("si", "cm"))
    assert si.fingerprints()["fingerprint"].to_pylist() == cm.fingerprints()["fingerprint"].to_pylist()
    assert cm.energy()["total"][0].as_py() == si.energy()["total"][0].as_py() == 6.25


def test_a_recording_keeps_the_text_and_the_units_of_its_scene(folder: Path) -> None:
    cm, own, si = (Recording.open(folder / f"{name}.rrd") for name in ("cm", "own", "si"))
    assert cm.scene_toml == IN_CM
    assert cm.units == scene_from_text(IN_CM, "").unit_system
    assert own.units == scene_from_text(OWN, "").unit_system
    assert si.units == SI and not [key for key in si.info if key.startswith("units")]


@pytest.mark.parametrize("name", ["cm", "own"])
def test_times_and_energies_are_printed_in_the_units_of_the_scene(folder: Path, name: str) -> None:
    energy = "6250 mJ" if name == "cm" else "62.5 g cm²/ms²"
    run, inspected = (folder / f"{name}.txt").read_text(encoding="utf-8"), printed(folder, "inspect", f"{name}.rrd")
    assert "2 bodies, 400 ms" in run and "400 ms simulated" in run
    assert f"{energy} at first" in inspected and "400 ms simulated" in inspected and "t = 160 ms" in inspected
    assert "ms --" not in inspected and "--at 160" in inspected


def test_a_scene_in_si_prints_si(folder: Path) -> None:
    inspected = printed(folder, "inspect", "si.rrd")
    assert "0.4 s simulated" in inspected and "energy 6.25 J at first" in inspected and "--at 0.16" in inspected


@pytest.mark.parametrize("time", ["160", "0.16 s", "1.6e-4 ks"])
@pytest.mark.parametrize("name", ["cm", "own"])
def test_a_plain_time_is_in_the_units_of_the_scene_and_a_text_in_its_own(folder: Path, name: str, time: str) -> None:
    shown = printed(folder, "contacts", f"{name}.rrd", "--at", time)
    assert "1 contact in step" in shown and " 160 " in shown and "approach (cm/ms)" in shown and " 0.5 " in shown


def test_json_is_in_the_units_of_the_recording(folder: Path) -> None:
    in_si, own = (json.loads(carom("inspect", f"{name}.rrd", "--json", cwd=folder).stdout) for name in ("cm", "own"))
    assert in_si["sim_time"] == 0.4 and in_si["energy"]["initial"] == 6.25
    assert own["sim_time"] == 400.0 and own["energy"]["initial"] == 62.5


@pytest.mark.parametrize(
    "command",
    [
        ("inspect",),
        ("contacts", "--at", "0.16 s"),
        ("why", "--event", "impact"),
        ("replay",),
        ("clip", "--from", "0.1 s", "-o", "clipped.rrd", "--force"),
        ("resume", "--until", "0.5 s", "-o", "resumed.rrd", "--force"),
        ("report", "-o", "report.zip", "--force"),
        ("repair",),
    ],
    ids=lambda given: given[0],
)
def test_json_names_the_units_of_its_numbers(
    folder: Path, command: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("carom.sharing.report.try_to_render", lambda *_: "not now")  # takes seconds
    told = {name: json.loads(printed(folder, *command, f"{name}.rrd", "--json")) for name in ("si", "cm", "own")}
    assert {name: document["units"] for name, document in told.items()} == {"si": "SI", "cm": "SI", "own": "cm, ms, g"}


@pytest.mark.parametrize(
    "command",
    [
        ("run", "-o", "x.rrd", "--force"),
        ("explain",),
        pytest.param(("tradeoff", *ONCE, "-o", "new", "--force"), marks=pytest.mark.slow),
        pytest.param(
            ("tune", *ONCE, "--study", "new", "--new-study", "--error", "energy=1", "-o", "tuned.toml", "--force"),
            marks=pytest.mark.slow,
        ),
    ],
    ids=lambda given: given[0],
)
def test_json_about_a_scene_names_the_units_of_its_numbers(folder: Path, command: tuple[str, ...]) -> None:
    for name, units in (("cm", "SI"), ("own", "cm, ms, g")):
        assert json.loads(printed(folder, command[0], f"{name}.toml", *command[1:], "--json"))["units"] == units


@pytest.mark.slow
def test_json_of_a_sweep_and_of_its_table_names_the_units_of_its_numbers(folder: Path) -> None:
    swept = json.loads(printed(folder, "sweep", "own.toml", "--seeds", "1", "-o", "sweep", "--workers", "1", "--json"))
    assert swept["units"] == "cm, ms, g" == json.loads(printed(folder, "sweep", "--table", "sweep", "--json"))["units"]
    assert "units of the results: cm, ms, g, wall_time in s; " in printed(folder, "sweep", "--table", "sweep")


def test_json_of_the_extremes_names_the_units_of_each(tmp_path: Path) -> None:
    (extreme,) = json.loads(printed(tmp_path, "stress", "one-body", "--json"))["extremes"]
    assert extreme["units"] == "SI"


def test_json_of_a_fork_and_of_a_comparison_names_the_units_of_its_numbers(folder: Path) -> None:
    change = ("--at", "0.1 s", "--set", "contact.restitution=0.9", "--json")
    for name, units in (("cm", "SI"), ("own", "cm, ms, g")):
        forked = json.loads(printed(folder, "fork", f"{name}.rrd", *change, "-o", f"{name}-forked.rrd"))
        compared = json.loads(printed(folder, "diff", f"{name}.rrd", f"{name}.rrd", "--json"))
        assert forked["units"] == compared["units"] == units


@pytest.mark.parametrize("name", ["cm", "own"])
def test_clip_replay_and_resume_take_times_with_units_and_keep_the_bits(folder: Path, name: str) -> None:
    run, clipped, longer = f"{name}.rrd", f"{name}-clip.rrd", f"{name}-longer.rrd"
    assert "100 to 200 ms" in printed(folder, "clip", run, "--from", "0.1 s", "--to", "200", "-o", clipped)
    assert "same bits" in printed(folder, "replay", clipped)
    assert "same bits" in printed(folder, "replay", run, "--from", "0.2 s")
    printed(folder, "resume", run, "--until", "0.5 s", "-o", longer)
    assert "500 ms simulated" in printed(folder, "inspect", longer)
    assert "same bits" in printed(folder, "replay", longer)


@pytest.mark.parametrize(
    ("time", "said"), [("3 kg", "is a mass, not a time"), ("3 hous", "no unit"), ("5e2", "500 ms is")]
)
def test_a_wrong_time_is_refused(folder: Path, time: str, said: str) -> None:
    done = carom("contacts", "cm.rrd", "--at", time, cwd=folder)
    assert done.returncode == 2 and said in " ".join(done.stderr.replace("│", "").split())


@pytest.mark.parametrize("name", ["cm", "own"])
def test_a_fork_takes_and_prints_the_units_of_the_scene(folder: Path, name: str) -> None:
    text = printed(
        folder, "fork", f"{name}.rrd", "--at", "100", "--set", "contact.restitution=1", "-o", f"{name}-f.rrd"
    )
    assert "Forked at step 10, t = 100 ms with" in text and "differs is step 16, t = 160 ms" in text
    assert "in a system of" in text and "cm apart (rms)" in text and " m " not in text
    assert Recording.open(folder / f"{name}-f.rrd").units == Recording.open(folder / f"{name}.rrd").units


@pytest.mark.parametrize("name", ["cm", "own"])
def test_a_question_about_the_beginning_is_refused_in_the_units_of_the_scene(folder: Path, name: str) -> None:
    said = carom("why", f"{name}.rrd", "--body", "0", "--at", "0 s", cwd=folder).stderr
    assert "t = 0 ms is not after the beginning" in said


@pytest.mark.slow
def test_times_of_impacts_in_a_study_are_in_the_units_of_the_scene(folder: Path) -> None:
    table = printed(folder, "tradeoff", "cm.toml", "--vary", "step=1,2", "--repeats", "1", "-o", "study")
    settings = json.loads((folder / "study" / "tradeoff.json").read_text(encoding="utf-8"))["settings"]
    late = max(each["errors"]["impact"] for each in settings)  # s
    assert late > 0.0 and "contact / ms" in table and f" {1000.0 * late:.1e} " in table


def test_a_description_in_a_refusal_is_in_the_units_of_the_scene(folder: Path) -> None:
    for name, unit in (("cm", "ms"), ("si", "s")):
        said = carom("run", f"{name}.toml", "--set", "time.fixed_dt=-1", cwd=folder).stderr
        assert f"(fixed_dt: {unit}, constant step instead of the adaptive one)" in said
    density = carom("run", "cm.toml", "--set", "body.0.density=-1", cwd=folder).stderr
    assert "kg/m³, density; 1000 unless" in density  # a default is in SI


@pytest.mark.parametrize(
    ("group", "said"),
    [
        ("radius = 1\nregion = { shape = 'box', size = [1, 99, 99] }", "a body of radius 1 cm does not fit"),
        (
            "radius = 1\narrangement = 'cubic'\nspacing = 1.5\nregion = { radius = 9 }",
            "spacing = 1.5 cm is less than a diameter, 2 cm",
        ),
        (
            "radius = 1\narrangement = 'cubic'\nspacing = 8\nregion = { radius = 9 }",
            "bodies at spacing = 8 cm",
        ),
    ],
)
def test_a_group_that_does_not_fit_is_refused_in_the_units_of_the_scene(tmp_path: Path, group: str, said: str) -> None:
    text = f"[units]\nlength = 'cm'\n[[group]]\ncount = 50\n{group}\n"
    (tmp_path / "scene.toml").write_text(text, encoding="utf-8")
    assert said in carom("run", "scene.toml", cwd=tmp_path).stderr


def test_recordings_in_different_units_are_not_compared(folder: Path) -> None:
    done = carom("diff", "cm.rrd", "own.rrd", cwd=folder)
    assert done.returncode == 2 and "cm.rrd is in SI and own.rrd in cm, ms, g" in done.stderr


def test_plots_are_in_the_units_of_the_scene(folder: Path) -> None:
    recording = Recording.open(folder / "cm.rrd")
    header, energy = header_of_recording(recording), PLOTS[0][0]
    assert energy.name_in(header) == "Energy (mJ)"
    assert energy.name_in(replace(header, units=SI)) == "Energy (J)"
    assert energy.name_in(replace(header, units=UnitSystem.of_text("au, day, solar mass"))) == (
        "Energy (solar mass au²/day²)"
    )
    assert energy.name_in(replace(header, units=UnitSystem.of_text("dimensionless"))) == "Energy"
    assert IMPULSES.name_in(header) == "Impulse of impacts (g cm/ms)"


def test_a_recording_has_the_values_of_its_plots_in_the_units_of_the_scene(folder: Path) -> None:
    """Rerun cannot scale a curve. In these scenes 1 J is 1000 mJ, 1 s is 1000 ms and 1 N s is 100 g cm/ms."""
    sizes = {"energy/translational": 1e3, "step/dt": 1e3, "energy/ledger/restitution": 1e3, "step/impact_rate": 1e-3}
    in_cm, in_si = Recording.open(folder / "cm.rrd"), Recording.open(folder / "si.rrd")
    for recording, are_there in ((in_cm, True), (in_si, False)):
        for chunk in recording.chunks(entry for entry in recording.store.entries if not entry.is_static):
            size = {**sizes, paths.IMPACTS: 100.0}.get(chunk.entity_path)
            if size is None:
                continue
            assert (IN_PLOT in chunk.components) is are_there
            if are_there:
                name = "normal_impulse" if chunk.entity_path == paths.IMPACTS else "Scalars:scalars"
                recorded, plotted = (chunk.batch[each].flatten().to_numpy() for each in (name, IN_PLOT))
                np.testing.assert_allclose(plotted, size * recorded, rtol=1e-6)  # of float32
    assert carom("replay", "cm.rrd", cwd=folder).returncode == 0


@pytest.mark.parametrize(
    ("count", "text"), [(0, "0"), (999, "999"), (5334, "5330"), (999_999, "1 million"), (1_893_428, "1.89 million")]
)
def test_an_estimated_number_has_three_digits(count: int, text: str) -> None:
    assert count_text(count) == text
