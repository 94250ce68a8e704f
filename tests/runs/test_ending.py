"""The description of the end of a run."""

import pytest

from carom.runs.outcome import in_words


@pytest.mark.parametrize(
    ("outcome", "said"),
    [
        ("disk", "recording failed"),
        ("disk: no space left at t = 2 s", "recording failed: no space left at t = 2 s"),
        ("completed", "completed"),
        ("failed: disk", "failed: disk"),
    ],
)
def test_a_recording_that_could_not_be_written_is_called_so(outcome: str, said: str) -> None:
    assert in_words(outcome) == said
