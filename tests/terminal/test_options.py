"""Values of options that several commands have."""

from __future__ import annotations

import pytest
import typer

from carom.terminal.options import work_time


@pytest.mark.parametrize(("text", "seconds"), [("60s", 60.0), ("90", 90.0), ("10min", 600.0), ("1.5 h", 5400.0)])
def test_a_limit_of_computing_time_is_in_seconds_minutes_or_hours(text: str, seconds: float) -> None:
    assert work_time(text) == seconds


@pytest.mark.parametrize("text", ["", "0s", "-1s", "3 days", "soon"])
def test_a_limit_of_computing_time_that_is_none_is_refused(text: str) -> None:
    with pytest.raises(typer.BadParameter, match="expected a time such as 60s, 10min or 2h"):
        work_time(text)
