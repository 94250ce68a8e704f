"""Temporary files: in one folder of the process, which other users cannot enter, and which ends with the process."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from carom import private_folder

NOBODY = 65534
MAKE = """
import sys
from carom.private_folder import private_folder, temporary_folder
with temporary_folder() as inner:
    (inner / "file").write_text("text")
    print(private_folder(), flush=True)
    if sys.argv[1:]:
        sys.stdin.read()
"""


@pytest.fixture
def temporary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A temporary folder of the system, as processes that a test starts have it: open to all, sticky."""
    folder = tmp_path / "temporary"
    folder.mkdir()
    folder.chmod(0o1777)
    monkeypatch.setenv("TMPDIR", str(folder))
    return folder


def start() -> subprocess.Popen[str]:
    """Start a process that has a private folder and waits."""
    return subprocess.Popen(
        [sys.executable, "-c", MAKE, "wait"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )


def made_by(process: subprocess.Popen[str]) -> Path:
    assert process.stdout is not None
    return Path(process.stdout.readline().strip())


def test_the_folder_is_closed_to_others_and_ends_with_its_process(temporary: Path) -> None:
    with start() as process:
        folder = made_by(process)
        assert folder.parent == temporary and folder.stat().st_mode & 0o777 == 0o700
        assert process.stdin is not None
        process.stdin.close()
    assert process.returncode == 0 and not any(temporary.iterdir())


def test_what_a_killed_process_left_is_removed_by_the_next_and_nothing_else_is(temporary: Path) -> None:
    kept = temporary / f"{private_folder.PREFIX}experiments"
    kept.mkdir(mode=0o700)
    with start() as killed, start() as alive:
        left, living = made_by(killed), made_by(alive)
        killed.send_signal(signal.SIGKILL)
        killed.wait()
        assert left.is_dir()
        subprocess.run([sys.executable, "-c", MAKE], check=True, stdout=subprocess.DEVNULL)
        assert {*temporary.iterdir()} == {kept, living}
        alive.kill()


def test_a_fork_makes_a_folder_of_its_own(temporary: Path) -> None:
    program = (
        "import os\nfrom carom.private_folder import private_folder\nfolder = private_folder()\nchild = os.fork()\n"
        "assert (private_folder() == folder) is (child > 0)\n"
        "if child:\n    os.waitpid(child, 0)\n    assert folder.is_dir()\n"
    )
    subprocess.run([sys.executable, "-c", program], check=True)
    assert not any(temporary.iterdir())


def test_a_temporary_folder_in_which_others_can_exchange_files_is_not_used(temporary: Path) -> None:
    temporary.chmod(0o777)
    with start() as process:
        folder = made_by(process)
        process.kill()
    assert folder.parent != temporary and not any(temporary.iterdir())


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can become another user")
def test_another_user_cannot_enter_the_folder_or_plant_one(temporary: Path) -> None:
    with start() as process:
        folder = made_by(process)
        enter = f"import os\nos.setuid({NOBODY})\nos.listdir({str(folder)!r})"
        refused = subprocess.run([sys.executable, "-c", enter], check=False, capture_output=True, text=True)
        process.kill()
    assert "PermissionError" in refused.stderr
    planted = temporary / f"{private_folder.PREFIX}planted"
    planted.mkdir()
    (planted / private_folder.MARK).touch()
    os.chown(planted, NOBODY, NOBODY)
    subprocess.run([sys.executable, "-c", MAKE], check=True, stdout=subprocess.DEVNULL)
    assert (planted / private_folder.MARK).exists()
