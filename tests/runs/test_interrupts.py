"""Requests to end a run."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import pytest

from carom.held_signals import signals_held
from carom.recording.read.recording import Recording
from carom.runs import environment
from carom.runs.environment import Interrupts
from interrupted_programs import fault_of


def test_an_interrupt_that_an_imported_library_caught_ends_the_run_before_it_begins(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(environment, "_received", [signal.SIGINT])
    with pytest.raises(KeyboardInterrupt), Interrupts():
        pytest.fail("the run began")
    monkeypatch.setattr(environment, "_received", [])
    with Interrupts() as seen:
        assert seen.count == 0


def test_a_program_that_caught_a_second_interrupt_can_run_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(environment, "SAME_PRESS", 0.0)
    with pytest.raises(KeyboardInterrupt), Interrupts():
        signal.raise_signal(signal.SIGINT)
        signal.raise_signal(signal.SIGINT)
    with Interrupts() as later:
        assert later.count == 0


LOOP = """
import sys
from pathlib import Path
import carom

scene = carom.Scene.load("two-spheres", ["time.duration=1e7", "record.every=1e3"])
for k in range(3):
    carom.run(scene, Path(sys.argv[1]) / f"{k}.rrd", watch=lambda status: print("step", flush=True))
"""


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_a_script_of_several_runs_and_leaves_a_complete_recording(number: int, tmp_path: Path) -> None:
    command = [sys.executable, "-c", LOOP, str(tmp_path)]
    script = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert script.stdout is not None
    script.stdout.readline()
    script.send_signal(number)
    _, said = script.communicate(timeout=60)
    assert script.returncode != 0 and said.rstrip().splitlines()[-1].startswith("KeyboardInterrupt: stopped by ")
    assert [path.name for path in sorted(tmp_path.iterdir())] == ["0.rrd"]
    assert Recording.open(tmp_path / "0.rrd").outcome.startswith("interrupted")


CALLBACK = """
import ctypes, signal, time
from carom.runs.environment import raise_signals

raise_signals()
try:
    ctypes.CFUNCTYPE(None)(lambda: signal.raise_signal(signal.SIGINT))()
    print("the callback is over")
    time.sleep(30)
except KeyboardInterrupt:
    print("interrupted")
"""


def test_an_interrupt_within_a_callback_from_c_is_raised_after_it_without_a_traceback() -> None:
    done = subprocess.run([sys.executable, "-c", CALLBACK], capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout == "the callback is over\ninterrupted\n"
    assert done.stderr == ""


SEVERAL = """
import signal, sys, time
from carom.runs import environment
from carom.runs.environment import Interrupts, raise_signals

raise_signals()
try:
    signal.raise_signal(signal.SIGTERM)
except KeyboardInterrupt:
    signal.raise_signal(signal.SIGTERM)  # its sender repeats it
    signal.raise_signal(signal.SIGINT)
    print("cleaned up")
time.sleep(1.2 * environment.SAME_PRESS)
signal.raise_signal(signal.SIGINT)
print("never")
"""


def test_a_second_signal_neither_breaks_the_end_of_a_command_nor_changes_its_exit_code() -> None:
    done = subprocess.run([sys.executable, "-c", SEVERAL], capture_output=True, text=True, timeout=60, check=False)
    assert done.stdout == "cleaned up\n" and done.stderr == "carom: interrupted\n"
    assert done.returncode == 128 + signal.SIGTERM


CLOSED = """
import signal, time
from carom.runs import environment
from carom.runs.environment import Interrupts, raise_signals

raise_signals()
with Interrupts() as seen:
    signal.raise_signal(signal.SIGHUP)
    signal.raise_signal(signal.SIGINT)  # the first press of the key
print(seen.count, seen.sender)
for _ in range(2):
    signal.raise_signal(signal.SIGTERM)
    time.sleep(1.2 * environment.SAME_PRESS)
print("summary")
"""


def test_a_closed_terminal_and_then_the_key_close_the_file_and_later_signals_do_not_disturb_the_summary() -> None:
    done = subprocess.run([sys.executable, "-c", CLOSED], capture_output=True, text=True, timeout=60, check=False)
    assert (done.stdout, done.stderr, done.returncode) == ("2 SIGHUP\nsummary\n", "", 0)


AT_AN_IMPORT = """
import builtins, signal, sys
from carom.__main__ import main

left, number, load = [int(sys.argv.pop(1))], int(sys.argv.pop(1)), builtins.__import__

def counted(*arguments, **keywords):
    left[0] -= 1
    if left[0] == 0:
        signal.raise_signal(number)
    return load(*arguments, **keywords)

builtins.__import__ = counted
main()
"""


@pytest.mark.parametrize("place", [1, 300])
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_while_the_command_is_imported_is_one_line(place: int, number: int) -> None:
    script = [sys.executable, "-c", AT_AN_IMPORT, str(place), str(number), "--version"]
    done = subprocess.run(script, capture_output=True, text=True, timeout=60, check=False)
    assert (done.stdout, done.stderr, done.returncode) == ("", "carom: interrupted\n", 128 + number)


IMPORTED = """
import signal, sys, time
from carom.runs.environment import raise_signals

raise_signals()
sys.path.insert(0, sys.argv[1])
try:
    import interrupted_module
    time.sleep(30)
except KeyboardInterrupt:
    print(sys.modules["interrupted_module"].whole)
"""


def test_an_interrupt_within_an_import_waits_until_the_module_is_whole(tmp_path: Path) -> None:
    text = "import signal\nsignal.raise_signal(signal.SIGINT)\nimport json\nwhole = True\n"
    (tmp_path / "interrupted_module.py").write_text(text, encoding="utf-8")
    script = [sys.executable, "-c", IMPORTED, str(tmp_path)]
    done = subprocess.run(script, capture_output=True, text=True, timeout=60, check=False)
    assert (done.stdout, done.stderr, done.returncode) == ("True\n", "", 0)


@pytest.mark.slow
def test_a_program_that_goes_on_after_interrupts_at_any_moment_runs_its_scene_again_with_the_same_bits(
    tmp_path: Path,
) -> None:
    whole, ended = 1.0, 0.3  # s, before which the first attempt imports, and later ones load kernels or run
    waits = [0.4 * whole, 0.8 * whole, *(0.2 * ended * k for k in range(5))]
    stopped, fault = fault_of("two-spheres", [], waits, tmp_path)
    assert "interrupted" in stopped and fault == ""


def test_signals_that_are_held_are_delivered_afterwards_once_and_in_their_order() -> None:
    seen = list[int]()
    before = signal.signal(signal.SIGTERM, lambda number, _: seen.append(number))
    try:
        with pytest.raises(KeyboardInterrupt), signals_held(), signals_held():
            for number in (signal.SIGTERM, signal.SIGINT, signal.SIGTERM, signal.SIGINT):
                signal.raise_signal(number)
            seen.append(0)
        assert seen == [0, signal.SIGTERM]
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    finally:
        signal.signal(signal.SIGTERM, before)
