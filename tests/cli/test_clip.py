import json
from pathlib import Path

import pytest

from carom.recording.read.recording import Recording
from carom_command import carom


def test_clip_says_what_it_cut_out_and_the_clip_inspects(run_file: Path, tmp_path: Path) -> None:
    done = carom("clip", "run.rrd", "--around", "2.5", "--window", "0.4", "--bodies", "3,17", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    bodies = 'body 3 "body-3" and body 17 "body-17"'
    assert f"run-clip.rrd written: 9 frames, steps 46 to 54, 2.3 to 2.7 s, {bodies}, " in done.stdout
    shown = carom("inspect", "run-clip.rrd", cwd=tmp_path).stdout
    for part in (
        "clip of",
        'run.rrd, 2.3 to 2.7 s, body 3 "body-3" and body 17 "body-17"',
        "the whole run",
        "9 frames, steps 46 to 54",
    ):
        assert part in shown


def test_clip_prints_json_that_a_script_can_use(run_file: Path, tmp_path: Path) -> None:
    done = carom("clip", "run.rrd", "--from", "4", "-o", "x.rrd", "--json", cwd=tmp_path)
    made = json.loads(done.stdout)
    assert (made["path"], made["frames"], made["first_step"], made["bodies"]) == ("x.rrd", 20, 80, None)
    assert made["size"] == (tmp_path / "x.rrd").stat().st_size
    assert Recording.open(tmp_path / "x.rrd").frames == 20


def test_a_clip_of_one_frame_is_told_as_one_moment(run_file: Path, tmp_path: Path) -> None:
    done = carom("clip", "run.rrd", "--around", "2.5", "--window", "0", cwd=tmp_path)
    assert "run-clip.rrd written: 1 frame, step 50, at 2.5 s, " in done.stdout


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--around", "1"], "--around T --window W"),
        (["--around", "1", "--window", "1", "--from", "0"], "--around T --window W"),
        (["--around", "1", "--window", "-1"], "must not be negative"),
        (["--from", "2", "--to", "1"], "the end is before the start"),
        (["--from", "9"], "no frame from 9 s on; it covers 0 to 4.95 s"),
        (["--to", "-1"], "no frame up to -1 s; it covers 0 to 4.95 s"),
        (["--bodies", "3,x"], 'has no body "x"'),
        (["--bodies", "3,99"], 'has no body "99"'),
        (["-o", "run.rrd"], "is the recording itself"),
        (["-o", "taken.rrd"], "exists; give --force"),
        (["-o", "no/such.rrd"], "there is no folder"),
    ],
)
def test_a_mistake_is_one_message_and_nothing_is_written(
    arguments: list[str], said: str, run_file: Path, tmp_path: Path
) -> None:
    (tmp_path / "taken.rrd").touch()
    done = carom("clip", "run.rrd", *arguments, cwd=tmp_path)
    assert done.returncode == 2, done.stderr
    assert said in done.stderr and "Traceback" not in done.stderr
    assert {path.name for path in tmp_path.iterdir()} == {"run.rrd", "taken.rrd"}
