"""Something worth a line in the log."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Event:
    """When it happened, how grave it is, and what it was. What looks for an event goes by its kind, not by its text."""

    step: int
    time: float  # s
    level: str  # "INFO" or "WARN"
    text: str
    kind: str = ""  # see docs/recording.md; empty in recordings of before there were kinds
