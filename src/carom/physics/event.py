"""Something worth a line in the log."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Event:
    """When it happened, how grave it is, and what it was."""

    step: int
    time: float  # s
    level: str  # "INFO" or "WARN"
    text: str
