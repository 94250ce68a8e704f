"""How many of the impacts of a run are in its recording."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class RecordedImpacts:
    """How many impacts are recorded, and how many are not."""

    recorded: int = 0
    left_out: int = 0

    @property
    def count(self) -> int:
        """All impacts."""
        return self.recorded + self.left_out

    def __str__(self) -> str:
        if not self.left_out:
            return {0: "none", 1: "the only one is recorded"}.get(self.recorded, f"all {self.recorded} recorded")
        return f"{self.recorded} recorded, the largest between frames; {self.left_out} left out"
