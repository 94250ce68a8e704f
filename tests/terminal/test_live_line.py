"""The progress lines of long work."""

from __future__ import annotations

import io
import time
from typing import Any

import pytest

from carom.terminal import console as carom_terminal
from carom.terminal.console import LiveLine, Patience, Terminal

TEXT = "looking ahead for the step that keeps 1e-06 …"


@pytest.mark.parametrize(
    ("on_terminal", "quiet", "everywhere", "seconds", "expected"),
    [
        (True, False, False, 0.5, True),
        (True, False, False, 0.0, False),
        (False, False, False, 0.5, False),
        (True, True, False, 0.5, False),
        (False, False, True, 0.5, True),
        (False, True, True, 0.5, False),
    ],
)
def test_work_that_takes_long_is_named_on_a_terminal_or_where_it_is_asked_for(
    on_terminal: bool, quiet: bool, everywhere: bool, seconds: float, expected: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = io.StringIO()

    def terminal(**options: Any) -> Terminal:
        return Terminal(file=out, force_terminal=on_terminal, width=80, quiet=options["quiet"])

    monkeypatch.setattr(carom_terminal, "Terminal", terminal)
    monkeypatch.setattr(carom_terminal, "PATIENCE", 0.1)
    with Patience(TEXT, LiveLine(quiet), everywhere=everywhere):
        time.sleep(seconds)
    assert (TEXT in out.getvalue()) == expected
