"""`carom tradeoff`, run as a person runs it."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from pathlib import Path

import pyarrow as pa
import pyarrow.csv
import pytest

from carom_command import carom

# with the default budget, a busy machine ends the reference early
COARSE = ("--set", "time.duration=1.0", "--set", "time.fixed_dt=0.01", "--budget", "60")
QUICK = (*COARSE, "--vary", "step=2,1", "--repeats", "1")


@pytest.mark.needs("matplotlib")
def test_the_table_the_document_the_figure_and_the_recording_are_there(tmp_path: Path) -> None:
    done = carom("tradeoff", "figure-eight", *QUICK, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    for part in (
        "steps 2 times as long",
        "as written",
        "position",
        "energy",
        "●",
        "Reference, exact: DOP853",
        "compared up to t = 1 s of 1 s",
    ):
        assert part in done.stdout
    folder = tmp_path / "recordings" / "tradeoff" / "figure-eight"
    assert json.loads((folder / "tradeoff.json").read_text(encoding="utf-8"))["reference"]["horizon"] == 1.0
    assert (folder / "tradeoff.png").read_bytes().startswith(b"\x89PNG")
    assert (folder / "tradeoff.svg").read_bytes().startswith(b"<?xml")
    table = pa.csv.read_csv(folder / "tradeoff.csv")
    written = json.loads((folder / "tradeoff.json").read_text(encoding="utf-8"))["settings"]
    assert table["name"].to_pylist() == [entry["name"] for entry in written if entry["errors"]]
    assert table["energy"].to_pylist() == [entry["errors"]["energy"] for entry in written if entry["errors"]]
    assert (folder / "tradeoff.rrd").exists()
    shown = carom("inspect", str(folder / "tradeoff.rrd"), cwd=tmp_path)
    assert shown.returncode == 0 and "reference, exact; steps 2 times as long; as written" in " ".join(
        shown.stdout.split()
    )
    again = carom("tradeoff", "figure-eight", *QUICK, "--json", cwd=tmp_path)
    document = json.loads(again.stdout)
    assert again.stderr == "" and [len(entry["costs"]) for entry in document["settings"]] == [1, 1]
    changed = carom("tradeoff", "figure-eight", "--set", "time.duration=0.5", *QUICK[2:], cwd=tmp_path)
    assert changed.returncode == 2 and "a study of another scene" in changed.stderr and "--force" in changed.stderr


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("figure-eigth",), 'did you mean the bundled scene "figure-eight"?'),
        (("figure-eight", "--vary", "step"), "expected key=a,b,c"),
        (
            ("figure-eight", "--vary", "time.integrator=rk4"),
            "must be 'auto', 'euler', 'leapfrog', 'leapfrog-dkd', 'yoshida4', 'gauss-radau15' or 'wisdom-holman'",
        ),
        (("figure-eight", "--repeats", "0"), "--repeats"),
    ],
)
def test_a_mistake_is_one_message_and_nothing_is_run(arguments: tuple[str, ...], said: str, tmp_path: Path) -> None:
    done = carom("tradeoff", *arguments, cwd=tmp_path)
    assert done.returncode == 2 and said in done.stderr and "Traceback" not in done.stderr
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_the_interrupt_key_keeps_what_is_done_and_the_command_goes_on_with_it(tmp_path: Path) -> None:
    short = ("--set", "time.duration=1.0")
    arguments = ("tradeoff", "figure-eight", *short, "--vary", "step=4,2,1,0.5", "-o", "study", "--repeats")
    command = [sys.executable, "-m", "carom", *arguments, "1000"]
    process = subprocess.Popen(command, cwd=tmp_path, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert process.stderr
    for line in process.stderr:
        if "cost, 1 of 1000" in line and line.startswith("2/4"):
            process.send_signal(signal.SIGINT)
            break
    out, err = process.communicate(timeout=120)
    assert process.returncode == 1 and "Traceback" not in err
    assert "the measurements are kept" in err and "steps 4 times as long" in out
    kept = json.loads((tmp_path / "study" / "tradeoff.json").read_text(encoding="utf-8"))
    assert len(kept["settings"][0]["costs"]) == 1
    again = carom(*arguments, "1", cwd=tmp_path)
    assert again.returncode == 0 and "errors" not in again.stderr
