"""Requests to end a run."""

from __future__ import annotations

import signal

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
