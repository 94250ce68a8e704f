"""The end of a run in words."""

from __future__ import annotations

_DISK = "disk"
_FAILED = "recording failed"


def in_words(outcome: str) -> str:
    """Describe a status, with its reason if there is one; ``disk`` means that the recording could not be written."""
    return _FAILED + outcome.removeprefix(_DISK) if outcome == _DISK or outcome.startswith(f"{_DISK}:") else outcome
