"""Events: lines in the log of a run."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Event:
    """An event with its time, level, text and kind. Code recognises events by their kind, never by their text."""

    step: int
    time: float  # s
    level: str  # "INFO" or "WARN"
    text: str
    kind: str = ""  # see docs/recording.md
