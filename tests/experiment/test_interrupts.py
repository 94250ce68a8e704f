"""Requests to end a run."""

from __future__ import annotations

import signal
import subprocess
import sys

import pytest

from carom.experiment import interrupts
from carom.experiment.interrupts import Interrupts


def test_an_interrupt_that_an_imported_library_caught_ends_the_run_before_it_begins(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(interrupts, "_received", [signal.SIGINT])
    with pytest.raises(KeyboardInterrupt), Interrupts():
        pytest.fail("the run began")
    monkeypatch.setattr(interrupts, "_received", [])
    with Interrupts() as seen:
        assert seen.count == 0


CALLBACK = """
import ctypes, signal, time
from carom.experiment.interrupts import raise_signals

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
