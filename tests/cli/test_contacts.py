"""`carom contacts`: what it prints, writes and refuses."""

from __future__ import annotations

import csv
import io
import json
import subprocess
import sys
from pathlib import Path

import pyarrow.parquet as pq
import pytest

import carom as library
from carom_command import carom
from scripted_run import RUN_ID
from small_scenes import scene_of


def test_impacts_are_printed_with_the_names_of_the_bodies(folder: Path) -> None:
    done = carom("contacts", "run.rrd", "--impacts", cwd=folder)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("1 impact, recorded\n")
    assert "body 0 and body 1" in done.stdout


def test_recorded_contacts_are_printed_without_the_compiler_and_the_viewer(folder: Path) -> None:
    code = (
        "import sys, carom.cli.main as m\n"
        "try: m.app(['contacts', 'run.rrd', '--impacts'])\n"
        "except SystemExit: pass\n"
        "print([name for name in ('numba', 'rerun') if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=folder, capture_output=True, text=True, check=True)
    assert done.stdout.startswith("1 impact, recorded\n")
    assert done.stdout.endswith("[]\n")


def test_friction_and_losses_that_are_rounding_are_printed_as_0(tmp_path: Path) -> None:
    line = (1.0, 0.3, 0.2)  # inclined, so that neither is exactly 0
    bodies = [
        {"position": [x * k for k in line], "velocity": [-x * k for k in line], "radius": 0.3, "mass": 0.7}
        for x in (-1.0, 1.1)
    ]
    scene = scene_of(bodies, time={"duration": 2.0}, contact={"restitution": 1.0}, gravity={"constant": 0})
    library.run(scene, tmp_path / "run.rrd")
    *_, friction, lost = carom("contacts", "run.rrd", cwd=tmp_path).stdout.splitlines()[-1].split()
    assert (friction, lost) == ("0", "0")


def test_a_step_without_contacts_is_told_with_its_time(folder: Path) -> None:
    assert carom("contacts", "run.rrd", "--at", "0.5", cwd=folder).stdout == "0 contacts at t = 0.5 s, recorded\n"


def test_empty_cells_of_recorded_contacts_are_explained_and_a_replay_fills_them(tmp_path: Path) -> None:
    scene = scene_of(
        [{"position": [0, 0, 1.0], "radius": 1.0}],
        time={"duration": 0.2, "fixed_dt": 0.01},
        gravity={"constant": 0.0, "uniform": [0.0, 0.0, -1.0]},
        plane=[{}],
    )
    library.run(scene, tmp_path / "run.rrd")
    said = carom("contacts", "run.rrd", "--at", "0.15", cwd=tmp_path).stdout.splitlines()[0]
    assert said.endswith(", recorded; empty cells were not recorded, compute them with --replay")
    said = carom("contacts", "run.rrd", "--at", "0.15", "--replay", cwd=tmp_path).stdout
    assert "empty cells" not in said and said.startswith("1 contact in step 15, replayed")


def test_an_impact_as_a_step_ends_is_named_where_that_step_has_no_contacts(tmp_path: Path) -> None:
    bodies = [{"position": [x, 0, 0], "velocity": [-x / 1.5, 0, 0], "radius": 0.5, "mass": 1} for x in (-1.5, 1.5)]
    scene = scene_of(bodies, time={"duration": 1.5, "fixed_dt": 1e-3}, gravity={"constant": 0})
    library.run(scene, tmp_path / "run.rrd")
    said = carom("contacts", "run.rrd", "--at", "1", cwd=tmp_path).stdout
    command = "--impacts --from 1 --to 1"
    assert said == f"0 contacts at t = 1 s, recorded; 1 impact at this time in step 1001: see {command}\n"
    assert carom("contacts", "run.rrd", *command.split(), cwd=tmp_path).stdout.startswith("1 impact, recorded\n")


def test_a_wide_table_has_its_steps_and_modes_whole(tmp_path: Path) -> None:
    units = "au, day, solar mass"
    bodies = [
        {"name": "a planet with a long name " + side, "position": [x, 0, 0], "velocity": [-x, 0, 0], "mass": 1.0}
        for side, x in (("on the left", -2.0), ("on the right", 2.0))
    ]
    time = {"duration": 2.0, "fixed_dt": 1e-3}
    scene = scene_of(bodies, units=units, time=time, gravity={"constant": 0}, contact={"timing": "end-of-step"})
    library.run(scene, tmp_path / "run.rrd")
    line = carom("contacts", "run.rrd", cwd=tmp_path).stdout.splitlines()[-1]
    assert " 500 " in line and " impact " in line and "…" not in line, line


def test_json_csv_and_parquet_have_the_same_rows(folder: Path) -> None:
    told = json.loads(carom("contacts", "run.rrd", "--json", cwd=folder).stdout)
    (row,) = told["contacts"]
    assert row.pop("between") == ["body 0", "body 1"]
    (line,) = csv.DictReader(io.StringIO(carom("contacts", "run.rrd", "--csv", cwd=folder).stdout))
    units = {"time": "s", "approach_speed": "m/s", "normal_impulse": "N s", "energy_lost": "J", "x": "m"}
    assert {name: float(line[f"{name} [{unit}]"]) for name, unit in units.items()} == {
        name: row[name] for name in units
    }
    assert carom("contacts", "run.rrd", "-o", "c.parquet", cwd=folder).returncode == 0
    table = pq.read_table(folder / "c.parquet")
    assert table.to_pylist() == [row | {"name_i": "body 0", "name_j": "body 1"}]
    assert {name: table.schema.field(name).metadata[b"unit"].decode() for name in units} == units
    assert carom("contacts", "run.rrd", "-o", "c.csv", cwd=folder).stdout == "c.csv written: 1 row, recorded.\n"
    assert list(csv.DictReader((folder / "c.csv").open(encoding="utf-8"))) == [line]


def test_statistics_are_printed_as_json_and_as_rows(folder: Path) -> None:
    said = carom("contacts", "run.rrd", "--statistics", cwd=folder).stdout
    assert "2 bodies, 0 to 2 s, 21 frames" in said and " collisions of a body  0.5 " in said  # one each in 2 s
    told = json.loads(carom("contacts", "run.rrd", "--statistics", "--json", cwd=folder).stdout)
    rate = told["statistics"]["free_paths"]["collision_rate"]
    assert (rate["value"], rate["unit"]) == (0.5, "1/s")
    rows = csv.DictReader(io.StringIO(carom("contacts", "run.rrd", "--statistics", "--csv", cwd=folder).stdout))
    assert [row["value"] for row in rows if row["quantity"] == "collision_rate"] == ["0.5"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("-o", "c.txt"), 'c.txt: the format ".txt" is unknown; there are .parquet, .csv'),
        (("--at", "7"), "covers 0 to 2 s; 7 s is outside"),
        (("--body", "9"), 'has no body "9"; its bodies are 0 to 1'),
        (("--body", "0", "--body", "1", "--at", "0.5"), "body 0 and body 1 do not touch at t = 0.5 s"),
        (("--body", "1", "--body", "1"), "a body has no contact with itself"),
        (("--json", "--csv"), "give only one of --json, --csv and -o"),
        (("--from", "1"), "add --impacts"),
        (("--impacts", "-o", "s.png"), 'the format ".png" is unknown; there are .parquet, .csv'),
        (("--statistics", "--at", "1"), "with --statistics, use --from and --to"),
        (("--statistics", "--impacts"), "give only one of --impacts and --statistics"),
        (("--statistics", "--body", "1"), "--statistics cover all bodies; leave --body out"),
        (("--statistics", "--from", "8"), "has no frame from 8 to inf s"),
        (("--impacts", "--from", "8"), "covers 0 to 2 s; 8 to inf s is outside"),
        (("-o", "nowhere/c.parquet"), "there is no folder nowhere"),
    ],
)
def test_a_mistake_is_one_sentence_and_exit_code_2(folder: Path, options: tuple[str, ...], message: str) -> None:
    done = carom("contacts", "run.rrd", *options, cwd=folder)
    assert done.returncode == 2
    assert message in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1


def test_a_file_of_another_program_is_refused(tmp_path: Path) -> None:
    (tmp_path / "x.rrd").write_text(RUN_ID)
    done = carom("contacts", "x.rrd", cwd=tmp_path)
    assert done.returncode == 2
    assert "is not a recording" in done.stderr
