import json
import os
from pathlib import Path

import pytest

from carom.recording.read.recording import Recording
from carom.recording.write.whole_file import Claim
from carom_command import carom, carom_process


def tear(path: Path) -> bytes:
    os.truncate(path, path.stat().st_size // 2)
    return path.read_bytes()


def test_a_whole_file_is_left_alone(run_file: Path, tmp_path: Path) -> None:
    done = carom("repair", "run.rrd", cwd=tmp_path)
    assert (done.returncode, done.stdout) == (0, "run.rrd: nothing to repair.\n")
    assert list(tmp_path.iterdir()) == [run_file]


def test_the_command_that_a_damaged_file_names_repairs_it(run_file: Path, tmp_path: Path) -> None:
    tear(run_file)
    refused = carom("inspect", "run.rrd", cwd=tmp_path)
    assert refused.returncode == 2 and "`carom repair run.rrd`" in refused.stderr
    done = carom("repair", "run.rrd", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "run-repaired.rrd written: " in done.stdout and "s; new: footer, layout." in done.stdout
    assert "lost: the last" in done.stdout and "ends inside a message" in done.stdout
    shown = carom("inspect", "run-repaired.rrd", cwd=tmp_path).stdout
    assert "repaired, to t = " in " ".join(shown.split())


def test_in_place_keeps_the_torn_file_beside_it(run_file: Path, tmp_path: Path) -> None:
    torn = tear(run_file)
    done = carom("repair", "run.rrd", "--in-place", "--json", cwd=tmp_path)
    assert json.loads(done.stdout)["path"] == "run.rrd"
    assert (tmp_path / "run.rrd.torn").read_bytes() == torn
    assert Recording.open(run_file).finished
    assert {path.name for path in tmp_path.iterdir()} == {"run.rrd", "run.rrd.torn"}


def test_in_place_leaves_an_earlier_repair_alone_and_replaces_an_earlier_torn_file_by_force_only(
    run_file: Path, tmp_path: Path
) -> None:
    torn = tear(run_file)
    (tmp_path / "run-repaired.rrd").write_bytes(b"an earlier repair")
    (tmp_path / "run.rrd.torn").write_bytes(b"an earlier torn file")
    done = carom("repair", "run.rrd", "--in-place", cwd=tmp_path)
    assert done.returncode == 2 and "move it away, or give --force to replace it" in " ".join(done.stderr.split())
    assert run_file.read_bytes() == torn
    assert carom("repair", "run.rrd", "--in-place", "--force", cwd=tmp_path).returncode == 0
    assert Recording.open(run_file).finished and (tmp_path / "run.rrd.torn").read_bytes() == torn
    assert (tmp_path / "run-repaired.rrd").read_bytes() == b"an earlier repair"
    assert len(list(tmp_path.iterdir())) == 3


@pytest.mark.slow
def test_a_recording_under_way_is_not_repaired_in_place(run_file: Path, tmp_path: Path) -> None:
    before = tear(run_file)
    with Claim(run_file):
        done = carom_process("repair", "run.rrd", "--in-place", cwd=tmp_path)
    assert done.returncode == 2 and "another carom process is writing it" in done.stderr
    assert run_file.read_bytes() == before and [path.name for path in tmp_path.iterdir()] == ["run.rrd"]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["nothing.rrd"], "no recording at nothing.rrd"),
        (["run.rrd", "-o", "run.rrd", "--force"], "is the damaged recording itself"),
        (["run.rrd", "-o", "taken.rrd"], "exists; give --force"),
        (["run.rrd", "--in-place", "-o", "x.rrd"], "give --in-place or -o, not both"),
        (["taken.rrd"], "nothing of taken.rrd can be read"),
    ],
)
def test_a_mistake_is_one_message_and_the_file_stays(
    arguments: list[str], said: str, run_file: Path, tmp_path: Path
) -> None:
    (tmp_path / "taken.rrd").touch()
    before = tear(run_file)
    done = carom("repair", *arguments, cwd=tmp_path)
    assert done.returncode == 2, done.stderr
    assert said in done.stderr and "Traceback" not in done.stderr
    assert run_file.read_bytes() == before
