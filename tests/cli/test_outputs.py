"""Outputs that cannot be written: one sentence each, and no existing file is lost."""

from __future__ import annotations

import ctypes
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from carom.cli.main import run_command
from carom.errors import PhysicsError
from carom.recording.read.recording import Recording
from carom_command import carom

QUICK = ("run", "two-spheres", "--set", "time.duration=0.5")


@pytest.mark.parametrize("kind", ["file", "dangling link"])
def test_something_in_the_way_of_the_folder_of_recordings_is_one_sentence(kind: str, tmp_path: Path) -> None:
    if kind == "file":
        (tmp_path / "recordings").write_text("mine", encoding="utf-8")
    else:
        (tmp_path / "recordings").symlink_to("nowhere")
    done = carom(*QUICK, cwd=tmp_path)
    assert done.returncode == 2
    assert done.stderr == "carom: recordings: is not a folder, but carom needs a folder of that name; move it\n"
    assert [path.name for path in tmp_path.iterdir()] == ["recordings"]


def without_rights_of_root() -> None:
    """Drop CAP_DAC_OVERRIDE, so that the mode of a folder restricts root, too."""
    if os.getuid() == 0:
        ctypes.CDLL(None).prctl(24, 1)  # PR_CAPBSET_DROP


@pytest.mark.parametrize(
    ("folder", "arguments"),
    [
        ("removed", []),
        ("read-only", ["-o", "x.rrd"]),
        pytest.param("removed", ["-o", "x.rrd"], marks=pytest.mark.slow),
        pytest.param("read-only", [], marks=pytest.mark.slow),
    ],
)
def test_a_working_folder_that_cannot_be_written_is_one_sentence(
    folder: str, arguments: list[str], tmp_path: Path
) -> None:
    (tmp_path / "place").mkdir(mode=0o755 if folder == "removed" else 0o555)
    enter = "cd place && rmdir ../place" if folder == "removed" else "cd place"
    done = subprocess.run(
        ["sh", "-c", f'{enter}; exec "$@"', "sh", sys.executable, "-m", "carom", *QUICK, *arguments],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
        preexec_fn=without_rights_of_root,
    )
    assert done.returncode == 2 and len(done.stderr.splitlines()) == 1, done.stderr
    assert done.stderr.startswith("carom: ") and ("x.rrd" in done.stderr or "recordings" in done.stderr)


def test_a_pipe_as_output_is_refused_at_once(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.rrd")
    for force in ([], ["--force"]):
        done = carom(*QUICK, "-o", "pipe.rrd", *force, cwd=tmp_path)
        assert done.returncode == 2 and "pipe.rrd: a device or a pipe" in done.stderr


@pytest.mark.parametrize("name", ["run.txt", "run", "run.rrd.part"])
@pytest.mark.parametrize("command", [QUICK, ("clip", "x.rrd"), ("repair", "x.rrd"), ("why", "x.rrd", "--body", "0")])
def test_a_name_that_the_viewer_would_not_take_for_a_recording_is_refused(
    command: tuple[str, ...], name: str, tmp_path: Path
) -> None:
    done = carom(*command, "-o", name, cwd=tmp_path)
    assert (done.returncode, done.stderr) == (2, f"carom: cannot write {name}: a recording is an .rrd file\n")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("command", [["run"], ["run", "two-spheres", "-o"], ["inspect"], ["replay"], ["repair"]])
def test_a_name_of_300_characters_is_one_sentence(command: list[str], tmp_path: Path) -> None:
    done = carom(*command, f"{300 * 'n'}.rrd", cwd=tmp_path)
    assert done.returncode in (1, 2) and len(done.stderr.splitlines()) == 1
    assert "File name too long" in done.stderr and "Traceback" not in done.stderr


@pytest.mark.slow
def test_a_recording_that_is_removed_under_way_ends_its_run_and_says_so(tmp_path: Path) -> None:
    path = tmp_path / "x.rrd"
    run = subprocess.Popen(
        [sys.executable, "-m", "carom", "run", "elastic-gas", "--set", "time.duration=1e5", "-o", "x.rrd"],
        cwd=tmp_path,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )
    deadline = time.monotonic() + 120
    while not (path.exists() and path.stat().st_size > 100_000):
        assert run.poll() is None and time.monotonic() < deadline
        time.sleep(0.05)
    path.rename(tmp_path / "moved.rrd")
    _, stderr = run.communicate(timeout=60)
    assert run.returncode == 1 and "x.rrd was removed or renamed while it was written" in stderr
    moved = Recording.open(tmp_path / "moved.rrd")
    assert moved.finished and moved.frames > 0 and not path.exists()


def test_a_seed_that_no_recording_can_hold_is_refused_before_the_run(tmp_path: Path) -> None:
    done = carom(*QUICK, "--set", f"seed={2**63}", "-o", "x.rrd", cwd=tmp_path)
    assert done.returncode == 2 and f"seed = {2**63}: must be less than {2**63}" in done.stderr
    done = carom(*QUICK, "--set", f"seed={2**63 - 1}", "-o", "x.rrd", cwd=tmp_path)
    assert done.returncode == 0 and Recording.open(tmp_path / "x.rrd").info["seed"] == 2**63 - 1


def test_a_run_without_a_screen_is_recorded_and_says_that_nothing_can_be_shown(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET"):
        monkeypatch.delenv(name, raising=False)
    if sys.platform != "linux":
        pytest.skip("a screen cannot be taken away here")
    done = carom(*QUICK, "--live", "-o", "x.rrd", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "carom: the run is being recorded, but cannot be shown live: there is no screen" in done.stderr
    assert Recording.open(tmp_path / "x.rrd").outcome == "completed"


def test_a_recorded_command_names_no_folders(tmp_path: Path) -> None:
    scene = tmp_path / "my scene.toml"
    scene.write_text("[time]\nduration = 0.1\n[[body]]\n", encoding="utf-8")
    assert carom("run", str(scene), f"--output={tmp_path / 'x.rrd'}", cwd=tmp_path).returncode == 0
    command = Recording.open(tmp_path / "x.rrd").properties["command"]
    assert command == "carom run 'my scene.toml' --output=x.rrd"


def test_a_space_that_cannot_be_built_is_one_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def space(*_: object, **__: object) -> None:
        raise PhysicsError("the state is not finite at its start")

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("carom.runs.run.Space", space)
    monkeypatch.setattr("sys.argv", ["carom", *QUICK, "-o", "x.rrd"])
    with pytest.raises(SystemExit) as ended:
        run_command()
    assert ended.value.code == 2
    assert capsys.readouterr().err == "carom: the state is not finite at its start\n"
    assert list(tmp_path.iterdir()) == []
