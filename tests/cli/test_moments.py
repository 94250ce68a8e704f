"""A moment that is asked for must be in the recording."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from typer.main import get_command

import carom as library
from carom.cli.main import app
from carom.errors import RecordingError
from carom.recording.read.recording import Recording
from carom.scene.units.dimension import TIME
from carom.terminal.given_moment import GivenMoment
from carom.terminal.options import seconds
from carom_command import carom
from small_scenes import pair


@pytest.mark.parametrize("command", ["picture", "view", "report"])
def test_a_moment_outside_the_recording_is_refused_with_what_it_covers(
    run_file: Path, tmp_path: Path, command: str
) -> None:
    done = carom(command, "run.rrd", "--at", "5.2", cwd=tmp_path)
    assert done.returncode == 2 and done.stderr == "carom: run.rrd covers 0 to 4.95 s; 5.2 s is outside\n"
    assert list(tmp_path.iterdir()) == [run_file]


@pytest.mark.parametrize(
    "arguments",
    [
        ["picture", "--at", "nan"],
        ["report", "--at", "soon"],
        ["clip", "--around", "nan", "--window", "1"],
        ["replay", "--from", "nan"],
        ["resume", "--until", "nan"],
    ],
)
def test_an_argument_that_is_not_a_time_is_refused(run_file: Path, tmp_path: Path, arguments: list[str]) -> None:
    command, *options = arguments
    done = carom(command, "run.rrd", *options, cwd=tmp_path)
    assert done.returncode == 2 and "expected a time" in " ".join(done.stderr.split())
    assert list(tmp_path.iterdir()) == [run_file]


MOMENTS = ("contacts", "export", "picture", "view", "why", "report", "fork", "diff")


@pytest.mark.parametrize("command", MOMENTS)
def test_every_command_that_takes_a_moment_takes_a_time_a_step_or_an_event(command: str) -> None:
    group: Any = get_command(app)
    names = {parameter.name for parameter in group.commands[command].params}
    assert {"at", "step", "event"} <= names


@pytest.mark.parametrize("command", MOMENTS)
def test_two_moments_are_refused(run_file: Path, tmp_path: Path, command: str) -> None:
    files = ["run.rrd", "run.rrd"] if command == "diff" else ["run.rrd"]
    output = ["-o", "out.csv"] if command == "export" else []
    done = carom(command, *files, *output, "--step", "3", "--event", "impact", cwd=tmp_path)
    assert done.returncode == 2 and done.stderr == "carom: give --step or --event, not both\n"
    assert list(tmp_path.iterdir()) == [run_file]


@pytest.fixture(scope="module")
def uneven(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    """Two spheres that collide, in steps whose ends have many digits."""
    scene = pair(time={"duration": 1.5, "fixed_dt": 3.1234567891e-4}, record={"every": "step"})
    path = tmp_path_factory.mktemp("uneven") / "run.rrd"
    library.run(scene, path)
    return Recording.open(path)


def moment(at: str | None = None, step: int | None = None, event: str | None = None) -> GivenMoment:
    """Read the options of a command."""
    return GivenMoment(None if at is None else seconds(at), step, event)


@pytest.mark.parametrize("form", [".6g", ".9g", ".17g"])  # the forms in which carom prints times
def test_a_printed_time_finds_the_step_that_it_names(uneven: Recording, form: str) -> None:
    for time in uneven.fingerprints()["time"].to_pylist()[::97]:
        assert moment(uneven.units.text(time, TIME, form)).time(uneven) == time
        assert moment(f"{time:{form}}").time(uneven) == time


def test_a_clip_between_printed_times_begins_and_ends_with_their_frames(uneven: Recording, tmp_path: Path) -> None:
    """Rounded down or up, the typed times alone would exclude the last frame or the first."""
    times = uneven.fingerprints()["time"].to_pylist()
    for first, last in ((1000, 1003), (1001, 1004), (1002, 1007)):
        span = (f"{times[step]:.6g}" for step in (first, last))
        asked = [word for pair in zip(("--from", "--to"), span, strict=True) for word in pair]
        done = carom("clip", str(uneven.path), *asked, "-o", f"{first}.rrd", "--json", cwd=tmp_path)
        made = json.loads(done.stdout)
        assert (made["first_step"], made["last_step"]) == (first, last)


def test_a_time_within_a_step_stays_that_time(uneven: Recording) -> None:
    first, second = uneven.fingerprints()["time"].to_pylist()[1000:1002]
    within = f"{(first + second) / 2:.9g}"
    assert moment(within).time(uneven) == float(within)


def test_a_step_and_an_event_name_the_end_of_a_step(uneven: Recording) -> None:
    times = uneven.fingerprints()["time"].to_pylist()
    assert moment(step=1234).end(uneven) == times[1234]
    (impact,) = uneven.impacts().to_pylist()
    assert moment(event="impact:1").end(uneven) == times[impact["step"]] == moment(event="impact").end(uneven)


def test_a_step_without_a_frame_is_found_by_a_rerun(uneven: Recording, tmp_path: Path) -> None:
    scene = pair(time={"duration": 1.5, "fixed_dt": 3.1234567891e-4}, record={"every": 0.4})
    library.run(scene, tmp_path / "sparse.rrd")
    sparse = Recording.open(tmp_path / "sparse.rrd")
    assert 1234 not in sparse.fingerprints()["step"].to_pylist()
    assert moment(step=1234).time(sparse) == uneven.fingerprints()["time"][1234].as_py()


def test_a_step_or_an_event_that_a_recording_lacks_is_refused_with_what_it_has(uneven: Recording) -> None:
    with pytest.raises(RecordingError, match=r"covers steps 0 to 4803; step 9999 is outside"):
        moment(step=9999).time(uneven)
    with pytest.raises(RecordingError, match=r'no event "imapct"; did you mean "impact"\? There are .*contacts'):
        moment(event="imapct").end(uneven)


def test_an_unknown_ending_of_a_file_is_answered_with_the_nearest_one(run_file: Path, tmp_path: Path) -> None:
    done = carom("export", "run.rrd", "-o", "bodies.parqet", cwd=tmp_path)
    assert done.returncode == 2 and 'did you mean ".parquet"? There are .parquet, .csv' in done.stderr


ROLLING = """
[time]
duration = 0.2
fixed_dt = 0.01
[gravity]
constant = 0
uniform = [0, 0, -9.81]
[[plane]]
[[body]]
position = [0, 0, 1]
velocity = [1, 0, 0]
"""
TOUCHING = """
[time]
duration = 0.5
[gravity]
constant = 0
[[body]]
radius = 0.05
position = [0.2, 0, 0]
[[body]]
radius = 0.05
position = [0.3, 0, 0]
"""
APART = """
[time]
duration = 0.5
[contact]
enabled = false
[[body]]
[[body]]
position = [9, 0, 0]
"""


@pytest.mark.parametrize(
    ("scene", "absent", "present"),
    [
        (ROLLING, ["ardest impact"], ["ost contacts"]),
        (TOUCHING, ["eepest overlap", "integration error, ", "0.00e+00"], ["integration error at most 0 of"]),
        (APART, ["contact"], ["momentum"]),
    ],
    ids=["rolling", "touching", "apart"],
)
def test_nothing_is_called_the_largest_that_is_no_more_than_rounding_or_rest(
    scene: str, absent: list[str], present: list[str], tmp_path: Path
) -> None:
    (tmp_path / "scene.toml").write_text(scene, encoding="utf-8")
    said = carom("run", "scene.toml", "-o", "run.rrd", cwd=tmp_path).stdout
    shown = carom("inspect", "run.rrd", cwd=tmp_path).stdout
    assert all(each in shown for each in present)
    assert not [each for each in absent if each in shown.partition("time of the steps")[0] or each in said]
    texts = " ".join(Recording.open(tmp_path / "run.rrd").events()["text"].to_pylist())
    assert not [each for each in absent if each in texts]
