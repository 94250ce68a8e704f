"""How a run ended, in words."""

from __future__ import annotations

_DISK = "disk"
_FAILED = "recording failed"


def in_words(outcome: str) -> str:
    """Say a status, or a status with its reason, for people: ``disk`` is a recording that could not be written."""
    return _FAILED + outcome.removeprefix(_DISK) if outcome == _DISK or outcome.startswith(f"{_DISK}:") else outcome
