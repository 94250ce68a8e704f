"""`carom sweep`, run as a person runs it."""

from __future__ import annotations

import csv
import json
import shutil
import subprocess
from pathlib import Path

import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet as pq
import pytest

from carom.cli.main import run_command
from carom.physics.space import Space
from carom.recording.read.recording import Recording
from carom.runs.run import simulate
from carom.scene.load import Scene, scene_from_text
from carom_command import carom, carom_process
from sweep_runs import fingerprints, manifest, write_scene

VARY = ("--vary", "contact.restitution=0.2,0.8,2", "--seeds", "2")  # 2 is more than a restitution can be
BOUNCY = "restitution=0.8,seed=6"


@pytest.fixture(scope="module")
def first(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, subprocess.CompletedProcess[str]]:
    """Make a sweep in the folder `out`, in which a third of the runs fail; return the folder and the output."""
    folder = tmp_path_factory.mktemp("sweep")
    write_scene(folder)
    return folder, carom_process("sweep", "spheres.toml", *VARY, "--workers", "1", "-o", "out", cwd=folder)


@pytest.fixture
def swept(first: tuple[Path, subprocess.CompletedProcess[str]], tmp_path: Path) -> Path:
    """Copy the sweep for a test of its own."""
    shutil.copytree(first[0], tmp_path, dirs_exist_ok=True)
    return tmp_path


@pytest.mark.slow
def test_runs_that_cannot_run_are_told_and_the_others_finish(
    first: tuple[Path, subprocess.CompletedProcess[str]],
) -> None:
    folder, done = first
    assert done.returncode == 1 and "Traceback" not in done.stderr
    refused = [line for line in done.stderr.splitlines() if "refused" in line]
    assert len(refused) == 2 and all("restitution = 2.0: must be at most 1" in line for line in refused)
    assert "4 of 6 runs done" in done.stdout and "2 failed" in done.stdout
    runs = {run["name"]: run for run in manifest(folder / "out")["runs"]}
    assert len(runs) == 6
    assert runs["restitution=2.0,seed=5"]["status"] == "failed" and not runs["restitution=2.0,seed=5"]["file"]
    run = runs[BOUNCY]
    assert run["status"] == "done" and run["outcome"] == "completed" and run["wall_time"] > 0
    assert run["parameters"] == {"contact.restitution": 0.8} and run["seed"] == 6
    assert run["results"]["contacts.total"] == 1 and run["results"]["steps"] == 200


def test_a_run_of_a_sweep_is_the_run_that_carom_run_makes(
    first: tuple[Path, subprocess.CompletedProcess[str]], tmp_path: Path
) -> None:
    out = first[0] / "out"
    alone = Scene.load(first[0] / "spheres.toml", ["contact.restitution=0.8", "seed=6"])
    simulate(Space(alone, threads=2), tmp_path / "alone.rrd")
    prints = Recording.open(tmp_path / "alone.rrd").fingerprints()["fingerprint"]
    recording = Recording.open(out / "runs" / f"{BOUNCY}.rrd")
    assert recording.fingerprints()["fingerprint"] == prints
    assert fingerprints(out)[BOUNCY] == f"{prints[-1].as_py():016x}"
    assert recording.properties["command"].startswith("carom sweep spheres.toml --vary")
    assert recording.parameters == {"name": BOUNCY, "contact.restitution": 0.8, "seed": 6}
    assert scene_from_text(recording.scene_toml, "the recording") == alone


def test_the_table_has_a_row_a_run_as_parquet_and_as_csv(
    first: tuple[Path, subprocess.CompletedProcess[str]],
) -> None:
    out = first[0] / "out"
    table = pq.read_table(out / "table.parquet")
    assert table.num_rows == 6
    rows = {row["name"]: row for row in table.to_pylist()}
    assert rows[BOUNCY]["contact.restitution"] == 0.8 and rows[BOUNCY]["energy.final"] > 0
    assert rows["restitution=2.0,seed=5"]["energy.final"] is None
    with (out / "table.csv").open(encoding="utf-8") as file:
        assert [row["fingerprint"] for row in csv.DictReader(file)] == table["fingerprint"].to_pylist()


@pytest.mark.slow
def test_running_again_tries_only_what_failed(swept: Path) -> None:
    kept = {path: path.stat().st_ino for path in (swept / "out" / "runs").iterdir()}
    lost = swept / "out" / "runs" / f"{BOUNCY}.rrd"
    lost.unlink()
    before = fingerprints(swept / "out")
    again = carom_process("sweep", "spheres.toml", *VARY, "-o", "out", "--json", "--workers", "1", cwd=swept)
    assert again.returncode == 1 and again.stderr == ""
    ending = json.loads(again.stdout)
    assert ending["found"] == 3 and len(ending["failed"]) == 2 and ending["left"] == 0 and not ending["ok"]
    after = {path: path.stat().st_ino for path in (swept / "out" / "runs").iterdir()}
    assert {path for path in kept if after[path] != kept[path]} <= {lost}
    assert fingerprints(swept / "out") == before  # on one worker as on two


def test_a_sweep_is_widened_by_more_values_and_needs_no_workers_when_nothing_is_missing(swept: Path) -> None:
    less = ("--vary", "contact.restitution=0.2,0.8", "--seeds", "1")
    done = carom("sweep", "spheres.toml", *less, "-o", "out", cwd=swept)
    assert done.returncode == 0, done.stderr
    assert "2 of 2 runs done, 2 of them before" in done.stdout
    assert len(manifest(swept / "out")["runs"]) == 6  # the larger sweep loses nothing


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["spheres.toml", "--vary", "contact.restitution=0.2", "-o", "out"], "varies contact.restitution, seed"),
        (["spheres.toml", *VARY, "-o", "out", "--set", "title=other"], "another scene"),
        (["spheres.toml", "--vary", "contact.restituton=0.2", "-o", "new"], 'did you mean "restitution"'),
        (["spheres.toml", "--vary", "contact.restitution", "-o", "new"], "expected key=values"),
        (["spheres.toml", "--vary", "contact.restitution=0:1:1", "-o", "new"], "two values or more"),
        (["spheres.toml", "--vary", "seed=1,2", "--seeds", "2", "-o", "new"], "given twice"),
        (["spheres.toml", "-o", "new"], "nothing varies"),
        (
            ["spheres.toml", "--seeds", "1000000000000", "-o", "new"],
            "give fewer values, or fewer seeds",
        ),
        (["spheres.toml", *VARY, "-o", "spheres.toml"], "is not a folder"),
        pytest.param(
            ["spheres.toml", *VARY, "-o", "new", "--cluster", "nonsense"],
            "expected the address of a Dask scheduler",
            marks=pytest.mark.needs("distributed"),
        ),
        pytest.param(
            ["spheres.toml", *VARY, "-o", "new", "--cluster", "tcp://127.0.0.1:9"],
            "no Dask scheduler answers",
            marks=pytest.mark.needs("distributed"),
        ),
        (["spheres.toml", *VARY, "--plot", "x=a", "z=b"], "expected x=KEY y=KEY"),
        ([], "give one of SCENE, --table DIR and --catalog DIR"),
        (["--table", "nowhere"], "not a sweep"),
        (["--table", "out", "--sort", "energy.finl"], 'did you mean "energy.final"'),
        (["--table", "out", "--filter", "energy.final"], "expected a comparison"),
        (["--table", "out", "--filter", "energy.final<few"], 'column energy.final is numeric; got "few"'),
        pytest.param(
            ["--table", "out", "--plot", "x=name", "y=seed"], "is not a number", marks=pytest.mark.needs("matplotlib")
        ),
    ],
)
def test_a_mistake_is_one_message_and_exit_code_2(
    first: tuple[Path, subprocess.CompletedProcess[str]],
    arguments: list[str],
    said: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(first[0])
    monkeypatch.setattr("sys.argv", ["carom", "sweep", *arguments])
    with pytest.raises(SystemExit) as ended:
        run_command()
    assert ended.value.code == 2
    assert said in capsys.readouterr().err
    assert not (first[0] / "new").exists()


def test_a_sweep_into_the_folder_of_its_scene_leaves_the_scene_alone(tmp_path: Path) -> None:
    scene = write_scene(tmp_path)
    own = f"{scene.read_text(encoding='utf-8')}\n[sweep]\nseeds = 2\n"
    (tmp_path / "scene.toml").write_text(own, encoding="utf-8")
    for force in ((), ("--force",)):
        done = carom("sweep", "scene.toml", "-o", ".", *force, cwd=tmp_path)
        assert done.returncode == 2 and "the sweep would replace it" in done.stderr
        assert (tmp_path / "scene.toml").read_text(encoding="utf-8") == own


def test_the_table_is_shown_sorted_and_filtered(first: tuple[Path, subprocess.CompletedProcess[str]]) -> None:
    shown = carom("sweep", "--table", "out", "--sort=-energy.final", "--filter", "outcome=completed", cwd=first[0])
    assert shown.returncode == 0, shown.stderr
    assert "4 of 6 runs; units of the results: SI, wall_time in s; " in shown.stdout
    assert "energy.max_error" in shown.stdout
    values = [line.split()[0] for line in shown.stdout.splitlines() if line.strip().endswith("completed")]
    assert values == ["0.8", "0.8", "0.2", "0.2"]
    document = carom("sweep", "--table", "out", "--filter", "contact.restitution>=0.8", "--json", cwd=first[0])
    rows = json.loads(document.stdout)["rows"]
    assert {row["contact.restitution"] for row in rows} == {0.8, 2.0}
    few = carom("sweep", "--table", "out", "--columns", "energy.final", "--json", cwd=first[0])
    keys = {key for row in json.loads(few.stdout)["rows"] for key in row}
    assert keys == {"contact.restitution", "seed", "energy.final", "outcome"}


@pytest.mark.needs("matplotlib")
def test_a_figure_is_drawn_of_one_column_over_another(swept: Path) -> None:
    drawn = carom("sweep", "--table", "out", "--plot", "x=contact.restitution", "y=energy.final", cwd=swept)
    assert drawn.returncode == 0, drawn.stderr
    path = swept / "out" / "energy.final-over-contact.restitution.png"
    assert str(path.relative_to(swept)) in drawn.stdout and path.read_bytes().startswith(b"\x89PNG")
    assert (swept / "out" / f"{path.stem}.pdf").read_bytes().startswith(b"%PDF")
    points = pa.csv.read_csv(swept / "out" / f"{path.stem}.csv")
    assert points.column_names == ["contact.restitution", "energy.final", "least", "largest", "runs"]
    rows = [tuple(row.values()) for row in points.to_pylist()]
    assert [(x, runs) for x, *_, runs in rows] == [(0.2, 2), (0.8, 2)]
    assert all(least <= mean <= largest for _, mean, least, largest, _ in rows)


@pytest.mark.slow
def test_a_table_that_cannot_be_written_is_one_sentence_and_exit_code_1(
    first: tuple[Path, subprocess.CompletedProcess[str]],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(first[0])
    monkeypatch.setattr("sys.argv", ["carom", "sweep", "spheres.toml", *VARY, "-o", "out"])
    table = first[0] / "out" / "table.parquet"
    kept = table.rename(first[0] / "kept.parquet")
    table.mkdir()
    try:
        with pytest.raises(SystemExit) as ended:
            run_command()
    finally:
        table.rmdir()
        kept.rename(table)
    said = capsys.readouterr().err.splitlines()[-1]
    assert ended.value.code == 1 and "table.parquet: cannot be written: Is a directory" in said
