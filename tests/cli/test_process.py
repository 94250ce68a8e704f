"""The command as a process: signals close a run, and what cannot be printed does not end one."""

from __future__ import annotations

import contextlib
import os
import pty
import re
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

import dense_heap
from carom.cli.main import COMMANDS
from carom.recording.read.recording import Recording
from carom_command import carom, carom_process

LONG = ["run", "elastic-gas", "--set", "time.duration=1e5", "-o", "x.rrd"]
SHORT = ["run", "two-spheres", "--set", "time.duration=1", "-o", "x.rrd", "--force"]


def command(*arguments: str) -> list[str]:
    return [sys.executable, "-m", "carom", *arguments]


def start(folder: Path, *arguments: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        command(*arguments),
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def wait_for_frames(path: Path, process: subprocess.Popen[str]) -> None:
    deadline = time.monotonic() + 120
    while not (path.exists() and path.stat().st_size > 100_000):
        assert process.poll() is None and time.monotonic() < deadline
        time.sleep(0.05)


def exit_code(child: int) -> int:
    """Return the exit status of a process; kill it after a minute."""
    deadline = time.monotonic() + 60
    while time.monotonic() < deadline:
        ended, status = os.waitpid(child, os.WNOHANG)
        if ended:
            return os.waitstatus_to_exitcode(status)
        time.sleep(0.05)
    os.kill(child, signal.SIGKILL)
    _, status = os.waitpid(child, 0)
    return os.waitstatus_to_exitcode(status)


def assert_silent(stderr: str) -> None:
    assert "Traceback" not in stderr and "Exception ignored" not in stderr, stderr


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_signal_that_ends_processes_closes_the_recording(number: signal.Signals, tmp_path: Path) -> None:
    run = start(tmp_path, *LONG)
    wait_for_frames(tmp_path / "x.rrd", run)
    run.send_signal(number)
    run.send_signal(number)  # schedulers and terminals send it to the process and to its group
    _, stderr = run.communicate(timeout=60)
    assert run.returncode == 1 and f"interrupted: stopped by {number.name}" in stderr
    assert_silent(stderr)
    recording = Recording.open(tmp_path / "x.rrd")
    assert recording.finished and recording.outcome.startswith(f"interrupted: stopped by {number.name}")


@pytest.mark.slow
@pytest.mark.parametrize("apart", [0.02, 0.4])
@pytest.mark.parametrize("numbers", [(signal.SIGTERM, signal.SIGTERM), (signal.SIGHUP, signal.SIGINT)])
def test_two_signals_of_which_one_is_no_key_close_the_recording(
    numbers: tuple[signal.Signals, signal.Signals], apart: float, tmp_path: Path
) -> None:
    run = start(tmp_path, *LONG)
    wait_for_frames(tmp_path / "x.rrd", run)
    run.send_signal(numbers[0])
    time.sleep(apart)
    run.send_signal(numbers[1])
    _, stderr = run.communicate(timeout=60)
    assert_silent(stderr)
    assert Recording.open(tmp_path / "x.rrd").finished
    # a press of the key while the summary is printed ends the command at once
    assert run.returncode in ((1, 128 + numbers[1]) if numbers[1] == signal.SIGINT else (1,))


@pytest.mark.slow
@pytest.mark.parametrize("after", [0.5, 1.5])  # on a busy machine 0.1 s is before carom's first line
def test_an_interrupt_while_the_command_starts_is_one_line(after: float, tmp_path: Path) -> None:
    run = start(tmp_path, *LONG)
    time.sleep(after)
    run.send_signal(signal.SIGINT)
    _, stderr = run.communicate(timeout=60)
    assert_silent(stderr)
    assert run.returncode == (1 if (tmp_path / "x.rrd").exists() else 130)
    assert "interrupted" in stderr.splitlines()[-1]


@pytest.mark.slow
def test_a_second_interrupt_ends_at_once_and_says_what_becomes_of_the_file(tmp_path: Path) -> None:
    run = start(tmp_path, *LONG)
    wait_for_frames(tmp_path / "x.rrd", run)
    run.send_signal(signal.SIGINT)
    time.sleep(0.35)  # long enough to count as a second press, and usually too short for the file to be closed
    run.send_signal(signal.SIGINT)
    _, stderr = run.communicate(timeout=60)
    assert_silent(stderr)
    assert run.returncode in (1, 130, -signal.SIGINT)
    said = "carom: x.rrd may lack its footer; `carom repair x.rrd` writes it\ncarom: interrupted\n" in stderr
    assert said or Recording.open(tmp_path / "x.rrd").finished


@pytest.mark.slow
@pytest.mark.parametrize("closed", [False, True])
def test_the_interrupt_key_and_a_closed_terminal_close_the_recording(closed: bool, tmp_path: Path) -> None:
    child, terminal = pty.fork()
    if child == 0:
        os.chdir(tmp_path)
        os.execv(sys.executable, command(*LONG))
    path, deadline = tmp_path / "x.rrd", time.monotonic() + 120
    while not (path.exists() and path.stat().st_size > 100_000):
        assert time.monotonic() < deadline
        os.read(terminal, 1000)
    if closed:
        os.close(terminal)
    else:
        os.write(terminal, b"\x03")
        while "interrupted: stopped by the user" not in os.read(terminal, 10_000).decode(errors="replace"):
            pass
    assert exit_code(child) == 1
    who = "SIGHUP" if closed else "the user"
    assert Recording.open(path).outcome.startswith(f"interrupted: stopped by {who}")


@pytest.mark.slow
def test_a_run_on_a_terminal_shows_its_progress_and_then_how_it_ended(tmp_path: Path) -> None:
    scene = ["elastic-gas", "--set", "time.duration=40", "--set", "record.every=0.01"]  # some seconds of work
    child, terminal = pty.fork()
    if child == 0:
        os.chdir(tmp_path)
        os.environ |= {"TERM": "xterm", "COLUMNS": "200", "PYTHONIOENCODING": "utf-8"}
        os.execv(sys.executable, command("run", *scene, "-o", "x.rrd"))
    written = b""
    with contextlib.suppress(OSError):  # EIO: the command has closed its end
        while part := os.read(terminal, 10_000):
            written += part
    code = exit_code(child)
    os.close(terminal)
    screen = written.decode()
    assert code == 0, screen
    assert_silent(screen)
    progress = re.findall(r"([━╌]{24}) +\d+%  t = [\d.e-]+ s  step (\d+) .*? contacts  energy error [\d.e+-]+", screen)
    steps = [int(step) for _, step in progress]
    assert len(set(steps)) > 3 and steps == sorted(steps)
    recording = Recording.open(tmp_path / "x.rrd")
    assert recording.outcome == "completed"
    summary = screen.rpartition(progress[-1][0])[2]
    assert re.search(r"outcome +\S*completed", summary)
    assert f"{recording.summary()['steps']} steps, 40 s simulated" in summary
    assert f"{recording.frames} frames" in summary


@pytest.mark.slow
def test_a_run_goes_on_when_nobody_reads_its_progress(tmp_path: Path) -> None:
    read, write = os.pipe()
    os.close(read)
    for stderr in (write, os.open("/dev/full", os.O_WRONLY)):
        done = subprocess.run(command(*SHORT), cwd=tmp_path, stderr=stderr, stdout=subprocess.PIPE, check=False)
        os.close(stderr)
        assert done.returncode == 0 and b"completed" in done.stdout
        assert Recording.open(tmp_path / "x.rrd").outcome == "completed"


@pytest.mark.slow
def test_standard_output_that_is_full_is_one_sentence_and_the_recording_is_whole(tmp_path: Path) -> None:
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            command(*SHORT), cwd=tmp_path, stdout=full, stderr=subprocess.PIPE, text=True, check=False
        )
    assert done.returncode == 1
    assert done.stderr.splitlines()[-1] == "carom: cannot write to standard output: No space left on device"
    assert_silent(done.stderr)
    assert Recording.open(tmp_path / "x.rrd").outcome == "completed"


@pytest.mark.slow
def test_a_run_without_standard_streams_keeps_them_out_of_its_recording(tmp_path: Path) -> None:
    script = 'exec "$@" 0<&- 1>&- 2>&-'
    done = subprocess.run(["sh", "-c", script, "sh", *command(*SHORT)], cwd=tmp_path, check=False)
    assert done.returncode == 0
    assert Recording.open(tmp_path / "x.rrd").outcome == "completed"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("encoding", "arguments"),
    [
        ("ascii", ["explain", "two-spheres"]),
        ("latin-1", ["sweep", "--help"]),
    ],
)
def test_other_encodings_than_utf_8_are_printed_without_what_they_lack(
    encoding: str, arguments: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PYTHONIOENCODING", encoding)
    done = subprocess.run(command(*arguments), cwd=tmp_path, capture_output=True, check=False)
    assert done.returncode == 0 and done.stdout, done.stderr
    assert_silent(done.stderr.decode(encoding))
    done.stdout.decode(encoding)


def test_a_system_that_is_not_posix_is_refused_in_one_sentence(tmp_path: Path) -> None:
    script = "import os; os.name = 'nt'; from carom.__main__ import main; main()"
    started = [sys.executable, "-c", script, "scenes"]
    done = subprocess.run(started, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr == "carom: runs on Linux, macOS and other POSIX systems only; on Windows, use WSL\n"


def test_an_address_space_that_is_too_small_is_refused_before_a_library_aborts(tmp_path: Path) -> None:
    script = f"ulimit -v 900000; {sys.executable} -m carom run two-spheres"
    done = subprocess.run(["sh", "-c", script], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith("carom: address space is limited to 0.922 GB, and its libraries need 1.2 GB or more")
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_a_run_fits_into_an_address_space_that_allocators_would_reserve(tmp_path: Path) -> None:
    # 2 GB: Rerun and Arrow reserved a GiB each, and OpenBLAS or Arrow aborted for want of a few kB.
    script = f'ulimit -v 1950000; exec "{sys.executable}" -m carom run two-spheres -o x.rrd'
    done = subprocess.run(["sh", "-c", script], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert Recording.open(tmp_path / "x.rrd").outcome == "completed"


@pytest.mark.slow
def test_a_scene_that_does_not_fit_into_the_address_space_is_refused_in_one_sentence(tmp_path: Path) -> None:
    big = "elastic-gas --set group.0.count=400000 -o x.rrd"
    script = f'ulimit -v 1950000; exec "{sys.executable}" -m carom run {big}'
    done = subprocess.run(["sh", "-c", script], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.strip().splitlines() == [
        "carom: 4e+05 bodies need about 2.7 GB of address space, but `ulimit -v` allows 2 GB; "
        "raise the limit or lower the count"
    ]
    assert not (tmp_path / "x.rrd").exists()


@pytest.mark.slow
@pytest.mark.parametrize("limit", [1_200_000, 1_550_000])
def test_a_dense_heap_that_uses_up_the_address_space_ends_with_a_sentence_and_a_readable_file(
    limit: int, tmp_path: Path
) -> None:
    # 12 000 bodies are admitted from 1.15 GB on; their 67 000 contacts need 1.6 GB
    program = f'"{sys.executable}" "{dense_heap.__file__}" 12000 x.rrd'
    script = f"ulimit -v {limit}; exec {program}"
    done = subprocess.run(["sh", "-c", script], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode in (0, 1) and "Traceback" not in done.stderr and "panicked" not in done.stderr, done.stderr
    recording = Recording.open(tmp_path / "x.rrd")
    assert recording.finished
    assert recording.summary()["frames"] == recording.frames
    if done.returncode:
        assert "ulimit -v" in done.stderr
    else:
        assert recording.outcome == "completed"


def test_a_reader_that_leaves_early_is_no_error(tmp_path: Path) -> None:
    script = f"{sys.executable} -m carom scenes | head -1"
    done = subprocess.run(["bash", "-o", "pipefail", "-c", script], cwd=tmp_path, capture_output=True, check=False)
    assert done.returncode == 0 and not done.stderr


def test_a_mistake_keeps_its_exit_code(tmp_path: Path) -> None:
    assert carom_process("run", "nothing.toml", cwd=tmp_path).returncode == 2
    assert carom_process("run", cwd=tmp_path).returncode == 2


NAMES = [name for commands in COMMANDS.values() for name in commands]


def with_open_files(name: str, soft: int, hard: int) -> subprocess.CompletedProcess[str]:
    """Run a command with a soft and a hard limit of open files."""
    return subprocess.run(
        command(name, "--help"),
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard)),
    )


@pytest.mark.parametrize("name", NAMES)
def test_with_few_file_descriptors_every_command_ends_with_one_sentence(name: str) -> None:
    for limit in {6 + NAMES.index(name) % 9, 14}:  # 6 to 14: with fewer Python does not start
        done = with_open_files(name, limit, limit)
        assert done.returncode == 2
        assert (
            done.stderr.startswith(f"carom: only {limit - 3} more files can be opened") and "ulimit -n" in done.stderr
        )
        assert len(done.stderr.splitlines()) == 1 and not done.stdout


def test_a_low_limit_of_open_files_is_raised_where_the_user_may() -> None:
    done = with_open_files("run", 6, resource.getrlimit(resource.RLIMIT_NOFILE)[1])
    assert done.returncode == 0 and not done.stderr


def test_a_command_that_runs_out_of_file_descriptors_ends_with_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise RuntimeError("Failed to create file: Too many open files (os error 24), path: /dev/fd/13")

    monkeypatch.setattr("carom.scene.scene_file.bundled_scenes", fail)
    done = carom("scenes", cwd=Path())
    assert done.returncode == 1 and done.stderr == "carom: too many files are open; raise the limit (`ulimit -n`)\n"
